# SPDX-License-Identifier: Apache-2.0
"""Deviations that stand beside the numbers of a model file: ``{value: 0.7, deviation: 0.01}``."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy import linalg

from impact_observer.errors import ModelError, UsageError
from impact_observer.model.document import NotNegative, Value, converted
from impact_observer.model.elements import Element
from impact_observer.model.free_parameters import OFFSET, parametric_family
from impact_observer.model.parameter_places import Place, key_of, parameter_places
from impact_observer.model.parameter_uncertainty import KEY, ParameterUncertainty
from impact_observer.model.robot_description import (
    DAMPING,
    RESTITUTION,
    ROTOR_INERTIA,
    RobotDescription,
)
from impact_observer.model.system import System
from impact_observer.states import Matrix

_DEVIATION = "deviation"
_BESIDE = ("provenance", KEY)
"""Keys of a model file that hold no numbers of the physics."""
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


class NamedDeviation(NamedTuple):
    """A deviation beside a number: ``slope`` is the number's unit over that of the parameter."""

    name: str
    key: str
    deviation: float
    slope: float = 1.0


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
    rest = {
        key: _plain(each, (*path, key), deviations)
        for key, each in value.items()
        if key != _DEVIATION
    }
    if _DEVIATION not in value:
        return rest
    if "value" not in rest:
        raise ModelError(f"{key_of(path)}.value", f"is missing beside {_DEVIATION}")
    is_alone, key = len(rest) == 1, f"{key_of(path)}.{_DEVIATION}"
    deviation = converted(value[_DEVIATION], NotNegative, key)
    deviations[path if is_alone else (*path, "value")] = deviation
    return rest["value"] if is_alone else rest


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
    beside = [*_of_linear(plain, system)]
    keys, covariance = _joined(known, beside)
    if not keys:
        return None
    if OFFSET in keys:
        raise ModelError(f"{KEY}.names", f"{OFFSET} found; expected parameters of the model")
    try:
        parameters = parametric_family(system, [*keys], elements).parameters
    except UsageError as error:
        key = next((each.key for each in beside if repr(each.name) in str(error)), f"{KEY}.names")
        raise ModelError(key, str(error)) from None
    if kinds := keys.keys() - {each.name for each in parameters}:
        wanted = ", ".join(each.name for each in parameters)
        problem = f"{kinds.pop()} found, a kind; expected single parameters: {wanted}"
        raise ModelError(f"{KEY}.names", problem)
    slopes = {each.name: abs(each.slope) for each in beside}
    used = []
    for each, deviation in zip(parameters, np.sqrt(np.diag(covariance)).tolist(), strict=True):
        least, most = each.deviation_range
        if deviation > most:
            slope, key = slopes.get(each.name, 1.0), keys[each.name]
            raise ModelError(
                key if key.startswith(KEY) else f"{key}.{_DEVIATION}",
                f"{deviation * slope:g} found; expected at most {most * slope:g}: find the value"
                " with identify",
            )
        used.append(deviation >= least)
    covariance = covariance * np.outer(used, used)
    return ParameterUncertainty((*keys,), covariance, known.fitted_to if known else None)


def _joined(
    known: ParameterUncertainty | None, beside: Iterable[NamedDeviation]
) -> tuple[dict[str, str], Matrix]:
    """The key of each parameter's deviation by its name, and the covariance, shape (p, p).

    Raises:
        ModelError: a parameter has two deviations.
    """
    names = known.names if known else ()
    keys = {name: f"{KEY}.covariance[{i}][{i}]" for i, name in enumerate(names)}
    variances = list[float]()
    for each in beside:
        if each.name in keys:
            problem = f"has a deviation, and {each.name} has one at {keys[each.name]}"
            raise ModelError(each.key, f"{problem}; expected one of the two")
        keys[each.name] = each.key
        variances.append((each.deviation / each.slope) ** 2)
    covariance = known.covariance if known else np.empty((0, 0))
    return keys, linalg.block_diag(covariance, np.diag(variances))


def _of_linear(plain: PlainDocument, system: System) -> Iterator[NamedDeviation]:
    """What the numbers of a linear system that have a deviation are parameters of."""
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
            raise ModelError(key, "is 0 with a deviation; expected another value, or a plain 0")
        yield NamedDeviation(places[path].name, key, deviation, places[path].slope)


def _instead(path: Place) -> str:
    """Where a deviation belongs that cannot stand at ``path``."""
    if path[0] in ("mass", "stiffness", "damping"):
        return f"a plain number in a matrix, and {path[0]}-scale in {KEY}"
    if path[:2] == ("forcing", "harmonics") and path[-2:-1] in (("cosine",), ("sine",)):
        k = int(path[2]) + 1
        return f"a plain number, and forcing-amplitude.{k} or forcing-phase.{k} in {KEY}"
    return f"a plain number, as this is no parameter of the model: {KEY} takes those of identify"


def with_robot_deviations(
    known: ParameterUncertainty | None, plain: PlainDocument, robot: RobotDescription
) -> ParameterUncertainty | None:
    """The same for a ``robot``.

    Parameters have names such as ``damping.elbow``, ``rotor-inertia.elbow``, ``restitution.wall``.

    Raises:
        ModelError: a value is wrong; the error names the key and the expected value.
    """
    for i, name in enumerate(known.names if known else ()):
        if name not in robot.parameters:
            wanted = ", ".join(robot.parameters)
            problem = f"{name!r} is no parameter; expected some of {wanted}"
            raise ModelError(f"{KEY}.names[{i}]", problem)
    keys, covariance = _joined(known, _of_robot(plain, robot))
    if not keys:
        return None
    return ParameterUncertainty((*keys,), covariance, known.fitted_to if known else None)


def _of_robot(plain: PlainDocument, robot: RobotDescription) -> Iterator[NamedDeviation]:
    """What the numbers of a robot that have a deviation are parameters of."""
    kinds = {"damping": DAMPING, "rotor_inertia": ROTOR_INERTIA}
    for path, deviation in plain.deviations.items():
        name = f"{kinds.get(str(path[0]))}.{path[-1]}"
        if path[0] == "contacts" and path[2:] in ((RESTITUTION,), (RESTITUTION, "value")):
            name = f"{RESTITUTION}.{robot.contact_names[int(path[1])]}"
        if name not in robot.parameters:
            raise ModelError(
                key_of(path),
                "has a deviation; expected a plain number: of a robot, damping, rotor_inertia and"
                " restitution may have one",
            )
        yield NamedDeviation(name, key_of(path), deviation)
