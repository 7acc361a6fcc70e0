# SPDX-License-Identifier: Apache-2.0
"""The entries of a model file that change with the values of its parameters."""

from collections.abc import Iterator, Mapping
from typing import Any, TypeAlias

import numpy as np

from impact_observer.model import System
from impact_observer.model.elements import labels
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.model.rebounds import ReboundLaw
from impact_observer.states import Vector

Place: TypeAlias = tuple[str | int, ...]
"""Path of a value in a model file."""
Change: TypeAlias = tuple[Place, object]


def changes(
    document: Mapping[str, Any], family: ParametricFamily, values: Vector
) -> dict[Place, object]:
    """New values by their path; a matrix from a file of its own comes into the model.

    Args:
        document: the model file from which ``family`` was made.
        family: the given system and its free parameters.
        values: of the parameters, shape (p,).
    """
    by_name = dict(zip(family.names, values.tolist(), strict=True))
    by_name.pop("clock-offset", None)  # belongs to the sensor
    entries = dict(_of_grounds(document, by_name))
    for i, guide in enumerate(document.get("friction", [])):
        if (force := by_name.get(f"friction.{guide['name']}")) is not None:
            entries["friction", i, "force"] = force
    if "bodies" in document:
        return {**entries, **dict(_of_elements(document, family.system, by_name))}
    return {**entries, **dict(_of_matrices(family, values, by_name))}


def _of_grounds(document: Mapping[str, Any], by_name: Mapping[str, float]) -> Iterator[Change]:
    for i, ground in enumerate(document.get("grounds", [])):
        for k, each in enumerate(ground["motion"].get("harmonics", [])):
            place: Place = ("grounds", i, "motion", "harmonics", k)
            yield from _of_harmonic(place, each, "ground", f"{ground['name']}.{k + 1}", by_name)


def _of_harmonic(
    place: Place, harmonic: Mapping[str, Any], kind: str, label: str, by_name: Mapping[str, float]
) -> Iterator[Change]:
    """Amplitude and phase of a harmonic by its own names."""
    if (ratio := by_name.get(f"{kind}-amplitude.{label}")) is not None:
        yield (*place, "amplitude"), harmonic["amplitude"] * ratio
    if (ahead := by_name.get(f"{kind}-phase.{label}")) is not None:
        phase = harmonic.get("phase", 0.0) + ahead
        yield (*place, "phase"), float(np.remainder(phase + np.pi, 2 * np.pi) - np.pi)


def _of_matrices(
    family: ParametricFamily, values: Vector, by_name: Mapping[str, float]
) -> Iterator[Change]:
    system = family.system_at(values)
    for name, part in {"mass": "M", "damping": "C", "stiffness": "K"}.items():
        if f"{name}-scale" in by_name:
            yield (name,), getattr(system, part).tolist()
    for i, contact in enumerate(system.contacts):
        if f"gap.{contact.name}" in by_name:
            yield ("contacts", i, "gap"), by_name[f"gap.{contact.name}"]
        yield from _of_impacts(("contacts", i), contact.name, system.rebounds[i], by_name)
    own = system.own_forcing
    for k in range(own.frequency.size):
        if {f"forcing-amplitude.{k + 1}", f"forcing-phase.{k + 1}"} & by_name.keys():
            for name in ("cosine", "sine"):
                part = getattr(own, name)[k]
                yield ("forcing", "harmonics", k, name), part.tolist()


def _of_elements(
    document: Mapping[str, Any], system: System, by_name: Mapping[str, float]
) -> Iterator[Change]:
    for i, body in enumerate(document.get("bodies", [])):
        yield from _of_element(("bodies", i), body, "mass", str(body["name"]), by_name)
    springs = document.get("springs", [])
    names = labels(spring["between"] for spring in springs)
    for i, (label, spring) in enumerate(zip(names, springs, strict=True)):
        for kind in ("stiffness", "damping"):
            if kind in spring:
                yield from _of_element(("springs", i), spring, kind, label, by_name)
    for i, stop in enumerate(document.get("stops", [])):
        yield from _of_impacts(("stops", i), str(stop["name"]), system.rebounds[i], by_name)
        yield from _of_stop(i, stop, by_name)
    harmonics = [
        (i, each) for i, each in enumerate(document.get("forces", [])) if "constant" not in each
    ]
    for k, (i, force) in enumerate(harmonics):
        yield from _of_harmonic(("forces", i), force, "forcing", str(k + 1), by_name)


def _of_element(
    place: Place,
    element: Mapping[str, Any],
    kind: str,
    label: str,
    by_name: Mapping[str, float],
) -> Iterator[Change]:
    """A mass, stiffness or damping: a parameter of its own, or scaled with all others."""
    if f"{kind}.{label}" in by_name:
        yield (*place, kind), by_name[f"{kind}.{label}"]
    elif f"{kind}-scale" in by_name:
        yield (*place, kind), element[kind] * by_name[f"{kind}-scale"]


def _of_stop(i: int, stop: Mapping[str, Any], by_name: Mapping[str, float]) -> Iterator[Change]:
    if (gap := by_name.get(f"gap.{stop['name']}")) is None:
        return
    if "between" in stop:
        yield ("stops", i, "gap"), gap
    else:
        yield ("stops", i, "limit"), gap if stop["side"] == "above" else -gap


def _of_impacts(
    place: Place, name: str, law: ReboundLaw, by_name: Mapping[str, float]
) -> Iterator[Change]:
    """How a contact rebounds, and how long an impact lasts."""
    for each in law.parameters:
        if (value := by_name.get(f"{each.kind}.{name}")) is not None:
            yield (*place, *each.place), value
    if (lasts := by_name.get(f"contact-time.{name}")) is not None:
        yield (*place, "contact_time"), lasts
