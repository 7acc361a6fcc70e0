# SPDX-License-Identifier: Apache-2.0
"""Where the parameters of a model stand in its file."""

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple, TypeAlias

from impact_observer.model.elements import labels
from impact_observer.model.system import System

Place: TypeAlias = tuple[str | int, ...]
"""Path of a value in a model file."""


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


def parameter_places(document: Mapping[str, Any], system: System) -> Iterator[ParameterPlace]:
    """The places of all parameters of a ``system`` that are single numbers in its file.

    Args:
        document: the file, which is valid, without deviations.
        system: as the file has it.
    """
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
        yield from _of_contact((contacts, i), contact, system, i)
    yield from _of_elements(document, system) if is_of_elements else _of_matrices(document, system)


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


def _of_contact(
    place: Place, contact: Mapping[str, Any], system: System, i: int
) -> Iterator[ParameterPlace]:
    """How a contact rebounds, and where it is."""
    name = contact["name"]
    for each in system.rebounds[i].parameters:
        yield ParameterPlace(f"{each.kind}.{name}", (*place, *each.place))
    key, sign = (
        "gap" if "gap" in contact else "limit",
        -1.0 if contact.get("side") == "below" else 1.0,
    )
    yield ParameterPlace(f"gap.{name}", (*place, key), sign)


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


def key_of(path: Iterable[str | int]) -> str:
    """The key of a value in errors, such as ``stops[0].limit``."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path)
    return text.removeprefix(".")
