# SPDX-License-Identifier: Apache-2.0
"""Deviations that stand beside the numbers of a model file: ``{value: 0.7, deviation: 0.01}``."""

from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from typing import Any, NamedTuple

import numpy as np

from impact_observer.errors import ModelError, UsageError
from impact_observer.model.document import Section, Value, number
from impact_observer.model.elements import Element
from impact_observer.model.free_parameters import parametric_family
from impact_observer.model.parameter_places import (
    ParameterPlace,
    Place,
    key_of,
    parameter_places,
)
from impact_observer.model.parameter_uncertainty import (
    KEY,
    ParameterUncertainty,
    declared_uncertainty,
    named_section,
    with_beside,
)
from impact_observer.model.parametric_family import ModelParameter
from impact_observer.model.robot_description import (
    DAMPING,
    RESTITUTION,
    ROTOR_INERTIA,
    RobotDescription,
)
from impact_observer.model.system import System

_DEVIATION = "deviation"
_BESIDE = ("provenance", KEY)
"""Keys of a model file that hold no numbers of the physics."""
_NEARLY = 0.75
"""Likeness to a key from which on another key is a misspelling of it."""
_NOTHING_AT_ZERO = ("amplitude", "stiffness", "damping")
"""Keys of numbers that are no parameters where they are 0."""


class PlainDocument(NamedTuple):
    """A model file without the deviations beside its numbers.

    Attributes:
        document: the file with plain numbers.
        deviations: standard deviations by the path of their number, in its unit.
    """

    document: Mapping[str, Any]
    deviations: dict[Place, float]


def without_deviations(document: Mapping[str, Value]) -> PlainDocument:
    """The ``document`` of a model file with each ``{value, deviation}`` replaced by its value.

    Raises:
        ModelError: a deviation without a value, or one that is no number >= 0.
    """
    deviations: dict[Place, float] = {}
    plain = {
        key: value if key in _BESIDE else _plain(value, (key,), deviations)
        for key, value in document.items()
    }
    return PlainDocument(plain, deviations)


def _plain(value: Value, path: Place, deviations: dict[Place, float]) -> Value:
    if isinstance(value, list):
        return [_plain(each, (*path, i), deviations) for i, each in enumerate(value)]
    if not isinstance(value, Mapping):
        return value
    if _DEVIATION not in value:
        _check_spelling(value, path)
        return {key: _plain(each, (*path, key), deviations) for key, each in value.items()}
    key, rest = key_of(path), {name: each for name, each in value.items() if name != _DEVIATION}
    if "value" not in rest:
        raise ModelError(f"{key}.value", f"is missing beside {_DEVIATION}")
    deviation = number(f"{key}.{_DEVIATION}", value[_DEVIATION])
    if deviation < 0:
        raise ModelError(
            f"{key}.{_DEVIATION}", f"is {deviation:g}; expected a standard deviation, >= 0"
        )
    alone = len(rest) == 1
    deviations[path if alone else (*path, "value")] = deviation
    return rest["value"] if alone else _plain(rest, path, deviations)


def _check_spelling(value: Mapping[str, Value], path: Place) -> None:
    """Raise ModelError if a key beside ``value`` is nearly ``deviation``."""
    if "value" not in value:
        return
    for name in get_close_matches(_DEVIATION, map(str, value), 1, _NEARLY):
        raise ModelError(
            f"{key_of(path)}.{name}", f"is not known here; expected value and {_DEVIATION}"
        )


def with_deviations(
    known: ParameterUncertainty | None,
    plain: PlainDocument,
    system: System,
    elements: tuple[Element, ...],
) -> ParameterUncertainty | None:
    """What the key ``uncertainty`` has, ``known``, and the deviations beside numbers.

    A deviation that is smaller than the rounding of computed motions becomes 0.

    Raises:
        ModelError: a deviation of what is no parameter, or of one that has a deviation already,
            or one so large that the value is of no use.
    """
    named = [*_named(plain, system)]
    slopes = {place.name: place.slope for place, _ in named}
    keys, covariance = with_beside(
        known, ((each.name, key_of(each.path), size / each.slope) for each, size in named)
    )
    if not keys:
        return None
    try:
        parameters = parametric_family(system, [*keys], elements).parameters
    except UsageError as error:
        key = next((keys[name] for name in slopes if repr(name) in str(error)), KEY)
        raise ModelError(key, str(error)) from None
    deviations = np.sqrt(np.diag(covariance)).tolist()
    used = [
        _is_used(each, deviation, keys[each.name], abs(slopes.get(each.name, 1.0)))
        for each, deviation in zip(parameters, deviations, strict=True)
    ]
    fitted_to = known.fitted_to if known else None
    return ParameterUncertainty((*keys,), covariance * np.outer(used, used), fitted_to)


def _is_used(parameter: ModelParameter, deviation: float, key: str, slope: float) -> bool:
    """Whether a ``deviation`` is larger than rounding; ``slope`` is that of the number at ``key``.

    Raises:
        ModelError: the deviation is so large that the value is of no use.
    """
    least, most = parameter.deviation_range
    if deviation > most:
        raise ModelError(
            key if key.startswith(KEY) else f"{key}.{_DEVIATION}",
            f"a deviation of {deviation * slope:g} found; expected at most {most * slope:g}: find"
            " the value with identify",
        )
    return deviation >= least


def _named(plain: PlainDocument, system: System) -> Iterator[tuple[ParameterPlace, float]]:
    """The place of each number that has a deviation, and the deviation in the number's unit."""
    if not plain.deviations:
        return
    places = {each.path: each for each in parameter_places(plain.document, system)}
    for path, deviation in plain.deviations.items():
        key = key_of(path)
        if path not in places:
            raise ModelError(key, f"has a deviation; expected {_instead(path)}")
        beside: Any = plain.document
        for part in path[:-1]:
            beside = beside[part]
        if not beside[path[-1]] and path[-1] in _NOTHING_AT_ZERO:
            raise ModelError(
                key,
                "is 0 with a deviation; expected another value, or a plain 0: what is 0 is no"
                " parameter here",
            )
        yield places[path], deviation


def _instead(path: Place) -> str:
    """Where a deviation belongs that cannot stand at ``path``."""
    if path[0] in ("mass", "stiffness", "damping"):
        return f"a plain number in a matrix, and {path[0]}-scale in {KEY}"
    if path[:2] == ("forcing", "harmonics") and path[-2:-1] in (("cosine",), ("sine",)):
        k = int(path[2]) + 1
        return f"a plain number, and forcing-amplitude.{k} or forcing-phase.{k} in {KEY}"
    return f"a plain number, as this is no parameter of the model: {KEY} takes those of identify"


def read_robot_uncertainty(
    section: Section, plain: PlainDocument, robot: RobotDescription
) -> ParameterUncertainty | None:
    """The uncertainty of a model file of a ``robot``; None where the file says nothing.

    Parameters have names such as ``damping.elbow``, ``rotor-inertia.elbow``, ``restitution.wall``.

    Raises:
        ModelError: a value is wrong; the error names the key and the expected value.
    """
    known = None
    if KEY in section:
        names, value = named_section(section)
        for i, name in enumerate(names):
            if name not in robot.parameters:
                wanted = ", ".join(robot.parameters)
                raise ModelError(
                    f"{KEY}.names[{i}]", f"{name!r} is no parameter; expected some of {wanted}"
                )
        known = declared_uncertainty(names, value)
    keys, covariance = with_beside(known, _of_robot(plain, robot))
    if not keys:
        return known
    return ParameterUncertainty((*keys,), covariance, known.fitted_to if known else None)


def _of_robot(plain: PlainDocument, robot: RobotDescription) -> Iterator[tuple[str, str, float]]:
    """Names, keys and deviations of numbers that have a deviation beside them."""
    for place, deviation in plain.deviations.items():
        if (name := _robot_name(place, robot)) not in robot.parameters:
            raise ModelError(
                key_of(place),
                "has a deviation; expected a plain number: of a robot, damping, rotor_inertia and"
                " restitution may have one",
            )
        yield name, key_of(place), deviation


def _robot_name(place: Place, robot: RobotDescription) -> str:
    """The parameter at a place of the model file; empty for no parameter."""
    kinds = {"damping": DAMPING, "rotor_inertia": ROTOR_INERTIA}
    if len(place) == 2 and place[0] in kinds:
        return f"{kinds[str(place[0])]}.{place[1]}"
    in_contact = len(place) > 2 and place[0] == "contacts" and place[2] == RESTITUTION
    if in_contact and place[3:] in {(), ("value",)}:
        return f"{RESTITUTION}.{robot.contact_names[int(place[1])]}"
    return ""
