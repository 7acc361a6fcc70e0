# SPDX-License-Identifier: Apache-2.0
"""The entries of a model file that change with the values of its parameters."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

from impact_observer.model import System
from impact_observer.model.contact_sensors import KEY as SENSORS
from impact_observer.model.free_parameters import LATENCY
from impact_observer.model.parameters_in_file import ParameterPlace, Place
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.states import Vector

Change: TypeAlias = tuple[Place, object]


def changes(
    document: Mapping[str, Any],
    places: Sequence[ParameterPlace],
    family: ParametricFamily,
    values: Vector,
) -> dict[Place, object]:
    """New values by their path; a matrix from a file of its own comes into the model.

    Args:
        document: the model file from which ``family`` was made, without deviations.
        places: of the parameters in this file.
        family: the given system and its free parameters.
        values: of the parameters, shape (p,).
    """
    by_name = dict(zip(family.names, values.tolist(), strict=True))
    entries = dict[Place, object]()
    for place in places:
        if place.name in by_name and not place.name.startswith(LATENCY):
            number = place.number(by_name.pop(place.name))
            is_phase = place.path[-1] == "phase"
            entries[place.path] = _turn(number) if is_phase else number
    entries |= dict(_of_sensors(document, by_name))
    if "bodies" in document:
        return entries | dict(_of_elements(document, places, by_name))
    return entries | dict(_of_matrices(document, family.system_at(values), by_name))


def _of_sensors(document: Mapping[str, Any], by_name: Mapping[str, float]) -> Iterator[Change]:
    """The sensors of all contacts, where latencies change."""
    given = dict(document.get(SENSORS, {}))
    late = {name.partition(".")[2]: v for name, v in by_name.items() if name.startswith(LATENCY)}
    if late:
        for contact, value in late.items():
            own = dict(given.get(contact, {}))
            given[contact] = {**own, "latency": own.get("latency", 0.0) + value}
        yield (SENSORS,), given


def _turn(phase: float) -> float:
    """The same phase in [-pi, pi), rad."""
    return float(np.remainder(phase + np.pi, 2 * np.pi) - np.pi)


def _of_matrices(
    document: Mapping[str, Any], system: System, by_name: Mapping[str, float]
) -> Iterator[Change]:
    """Matrices, harmonics, and constant forces where the file has none."""
    for name, part in {"mass": "M", "damping": "C", "stiffness": "K"}.items():
        if f"{name}-scale" in by_name:
            yield (name,), getattr(system, part).tolist()
    own = system.own_forcing
    for k in range(own.frequency.size):
        if {f"forcing-amplitude.{k + 1}", f"forcing-phase.{k + 1}"} & by_name.keys():
            for name in ("cosine", "sine"):
                part = getattr(own, name)[k]
                yield ("forcing", "harmonics", k, name), part.tolist()
    if any(name.startswith("constant-force.") for name in by_name):
        constant = {"constant": own.constant.tolist()}
        if "forcing" in document:
            yield ("forcing", "constant"), constant["constant"]
        else:
            yield ("forcing",), constant


def _of_elements(
    document: Mapping[str, Any],
    places: Sequence[ParameterPlace],
    by_name: Mapping[str, float],
) -> Iterator[Change]:
    """Scaled elements, and constant forces where the file has none."""
    for place in places:
        kind = place.name.partition(".")[0]
        if (scale := by_name.get(f"{kind}-scale")) is not None:
            element = document[str(place.path[0])][place.path[1]]
            yield place.path, element[kind] * scale
    kind = "constant-force."
    forces: list[object] = [
        {"body": name.removeprefix(kind), "constant": value}
        for name, value in by_name.items()
        if name.startswith(kind)
    ]
    if "forces" not in document and forces:
        yield ("forces",), forces
        return
    for i, force in enumerate(forces, start=len(document.get("forces", []))):
        yield ("forces", i), force
