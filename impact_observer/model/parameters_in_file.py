# SPDX-License-Identifier: Apache-2.0
"""The parameters of a model in its file: where they stand, and deviations beside their numbers."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from scipy import linalg

from impact_observer.errors import ModelError, UsageError
from impact_observer.model.document import NotNegative, Value, converted
from impact_observer.model.free_parameters import OFFSET, parametric_family
from impact_observer.model.linear_model import labels
from impact_observer.model.parameter_uncertainty import KEY, ParameterUncertainty
from impact_observer.model.parametric_family import ModelParameter
from impact_observer.model.robot_description import (
    DAMPING,
    RESTITUTION,
    ROTOR_INERTIA,
    RobotDescription,
)
from impact_observer.model.system import Element, System
from impact_observer.states import Matrix

Place: TypeAlias = tuple[str | int, ...]
"""Path of a value in a model file."""
_DEVIATION = "deviation"
_BESIDE = ("provenance", KEY)
"""Keys of a model file that hold no numbers of the physics."""
_NOTHING_AT_ZERO = ("amplitude", "stiffness", "damping")
"""Last keys of numbers that are no parameters where they are 0."""


class ParameterPlace(NamedTuple):
    """A number of a model file that one parameter sets: ``slope`` times its value, + ``offset``.

    Attributes:
        name: of the parameter, such as ``gap.stop``.
        path: of the number, such as ``("stops", 0, "limit")``.
        slope: unit of the number over that of the parameter.
        offset: of the number.
    """

    name: str
    path: Place
    slope: float = 1.0
    offset: float = 0.0

    def number(self, value: float) -> float:
        """The number in the file for a ``value`` of the parameter."""
        return self.slope * value + self.offset


def parameter_places(
    document: Mapping[str, Any], subject: System | RobotDescription
) -> Iterator[ParameterPlace]:
    """The places of all parameters of a model that are single numbers in its file.

    Args:
        document: the file, which is valid, without deviations.
        subject: the system or the robot that the file has.
    """
    if isinstance(subject, RobotDescription):
        yield from _of_robot(document)
        return
    for i, ground in enumerate(document.get("grounds", [])):
        for k, each in enumerate(ground["motion"].get("harmonics", [])):
            place: Place = ("grounds", i, "motion", "harmonics", k)
            yield from _of_harmonic(place, each, "ground", f"{ground['name']}.{k + 1}")
    for name, sensor in document.get("sensors", {}).items():
        if isinstance(sensor, Mapping) and "latency" in sensor:
            place = ("sensors", name, "latency")
            yield ParameterPlace(f"latency.{name}", place, 1.0, sensor["latency"])
    is_of_elements = "bodies" in document
    contacts = "stops" if is_of_elements else "contacts"
    for i, contact in enumerate(document.get(contacts, [])):
        name, place = contact["name"], (contacts, i)
        for number in subject.rebounds[i].parameters:
            yield ParameterPlace(f"{number.kind}.{name}", (*place, *number.place))
        key = "gap" if "gap" in contact else "limit"
        sign = -1.0 if contact.get("side") == "below" else 1.0
        yield ParameterPlace(f"gap.{name}", (*place, key), sign)
    yield from (_of_elements if is_of_elements else _of_matrices)(document, subject)


def _of_harmonic(
    place: Place, harmonic: Mapping[str, Any], kind: str, label: str
) -> Iterator[ParameterPlace]:
    """Amplitude, phase and frequency of a harmonic by its own names."""
    amplitude, phase = harmonic["amplitude"], harmonic.get("phase", 0.0)
    yield ParameterPlace(f"{kind}-amplitude.{label}", (*place, "amplitude"), amplitude)
    yield ParameterPlace(f"{kind}-phase.{label}", (*place, "phase"), 1.0, phase)
    yield _of_frequency(place, harmonic, f"{kind}-frequency.{label}")


def _of_frequency(place: Place, harmonic: Mapping[str, Any], name: str) -> ParameterPlace:
    """A frequency in rad/s, which may stand there in Hz."""
    if "hertz" in harmonic:
        return ParameterPlace(name, (*place, "hertz"), 1.0 / math.tau)
    return ParameterPlace(name, (*place, "frequency"))


def _of_matrices(document: Mapping[str, Any], system: System) -> Iterator[ParameterPlace]:
    forcing = document.get("forcing", {})
    if "constant" in forcing:
        for i, name in enumerate(system.coordinates):
            yield ParameterPlace(f"constant-force.{name}", ("forcing", "constant", i))
    for k, each in enumerate(forcing.get("harmonics", [])):
        yield _of_frequency(("forcing", "harmonics", k), each, f"forcing-frequency.{k + 1}")


def _of_elements(document: Mapping[str, Any], system: System) -> Iterator[ParameterPlace]:
    for i, body in enumerate(document["bodies"]):
        yield ParameterPlace(f"mass.{body['name']}", ("bodies", i, "mass"))
    springs = document.get("springs", [])
    names = labels(spring["between"] for spring in springs)
    for i, (label, spring) in enumerate(zip(names, springs, strict=True)):
        for kind in ("stiffness", "damping"):
            if kind in spring:
                yield ParameterPlace(f"{kind}.{label}", ("springs", i, kind))
    nominal = dict(zip(system.coordinates, system.own_forcing.constant.tolist(), strict=True))
    harmonics = 0
    for i, force in enumerate(document.get("forces", [])):
        if "constant" in force:  # the others on the same body stay
            name, constant = force["body"], force["constant"]
            path, others = ("forces", i, "constant"), constant - nominal[name]
            yield ParameterPlace(f"constant-force.{name}", path, 1.0, others)
        if "amplitude" in force and "shape" not in force:
            harmonics += 1
            yield from _of_harmonic(("forces", i), force, "forcing", str(harmonics))


def _of_robot(document: Mapping[str, Any]) -> Iterator[ParameterPlace]:
    for key, kind in {"damping": DAMPING, "rotor_inertia": ROTOR_INERTIA}.items():
        for joint in document.get(key, {}):
            yield ParameterPlace(f"{kind}.{joint}", (key, joint))
    for i, contact in enumerate(document.get("contacts", [])):
        place: Place = ("contacts", i, RESTITUTION)
        value = ("value",) if isinstance(contact[RESTITUTION], Mapping) else ()
        yield ParameterPlace(f"{RESTITUTION}.{contact['name']}", (*place, *value))


def key_of(path: Iterable[str | int]) -> str:
    """The key of a value in errors, such as ``stops[0].limit``."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path)
    return text.removeprefix(".")


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
    subject: System | RobotDescription,
    elements: Sequence[Element],
) -> ParameterUncertainty | None:
    """What the key ``uncertainty`` has, ``known``, and the deviations beside numbers.

    Of a linear system a deviation that is smaller than the rounding of computed motions becomes 0.

    Raises:
        ModelError: a deviation of what is no parameter, or of one that has a deviation already,
            or one so large that the value is of no use.
    """
    keys = {name: f"{KEY}.names[{i}]" for i, name in enumerate(known.names if known else ())}
    slopes, variances = dict.fromkeys(keys, 1.0), list[float]()
    for place, deviation in _declared(plain, subject):
        if place.name in keys:
            problem = f"has a deviation, and {place.name} has one at {keys[place.name]}"
            raise ModelError(key_of(place.path), f"{problem}; expected one of the two")
        keys[place.name], slopes[place.name] = key_of(place.path), abs(place.slope)
        variances.append((deviation / place.slope) ** 2)
    if not keys:
        return None
    given = known.covariance if known else np.empty((0, 0))
    covariance: Matrix = linalg.block_diag(given, np.diag(variances))
    if isinstance(subject, RobotDescription):
        for name in keys.keys() - subject.parameters.keys():
            wanted = ", ".join(subject.parameters)
            raise ModelError(keys[name], f"{name!r} is no parameter; expected some of {wanted}")
    else:
        parameters = _parameters(subject, keys, elements)
        for i, each in enumerate(parameters):
            deviation, (_, most) = math.sqrt(covariance[i, i]), each.deviation_range
            if deviation > most:
                is_beside, slope = not keys[each.name].startswith(KEY), slopes[each.name]
                raise ModelError(
                    f"{keys[each.name]}.deviation" if is_beside else f"{KEY}.covariance[{i}][{i}]",
                    f"{deviation * slope:g} found; expected at most {most * slope:g}: find the"
                    " value with identify",
                )
        least = [each.deviation_range[0] for each in parameters]
        used = np.sqrt(np.diag(covariance)) >= least
        covariance = covariance * np.outer(used, used)
    return ParameterUncertainty((*keys,), covariance, known.fitted_to if known else None)


def _declared(
    plain: PlainDocument, subject: System | RobotDescription
) -> Iterator[tuple[ParameterPlace, float]]:
    """The parameters that have a deviation beside their number, with it, in the number's unit."""
    if not plain.deviations:
        return
    places = {each.path: each for each in parameter_places(plain.document, subject)}
    for path, deviation in plain.deviations.items():
        if path not in places:
            wanted = _instead(path, subject)
            raise ModelError(key_of(path), f"has a deviation; expected a plain number{wanted}")
        found: Any = plain.document
        for part in path:
            found = found[part]
        if not found and path[-1] in _NOTHING_AT_ZERO:
            problem = "is 0 with a deviation; expected another value, or a plain 0"
            raise ModelError(key_of(path), problem)
        yield places[path], deviation


def _instead(path: Place, subject: System | RobotDescription) -> str:
    """Where a deviation belongs that cannot stand at ``path``."""
    if isinstance(subject, RobotDescription):
        return ": of a robot, damping, rotor_inertia and restitution may have one"
    if path[0] in ("mass", "stiffness", "damping"):
        return f" in a matrix, and {path[0]}-scale in {KEY}"
    if path[:2] == ("forcing", "harmonics") and path[-2:-1] in (("cosine",), ("sine",)):
        k = int(path[2]) + 1
        return f", and forcing-amplitude.{k} or forcing-phase.{k} in {KEY}"
    return f", as this is no parameter of the model: {KEY} takes those of identify"


def _parameters(
    system: System, keys: Mapping[str, str], elements: Sequence[Element]
) -> Sequence[ModelParameter]:
    """The parameters whose names are in ``keys``, each with its key in the file.

    Raises:
        ModelError: a name is none of a parameter of the model.
    """
    if OFFSET in keys:
        raise ModelError(keys[OFFSET], f"{OFFSET} found; expected parameters of the model")
    try:
        found = parametric_family(system, [*keys], elements).parameters
    except UsageError as error:
        key = next((key for name, key in keys.items() if repr(name) in str(error)), KEY)
        raise ModelError(key, str(error)) from None
    for kind in keys.keys() - {each.name for each in found}:
        wanted = ", ".join(each.name for each in found)
        problem = f"{kind} found, a kind; expected single parameters: {wanted}"
        raise ModelError(keys[kind], problem)
    return found
