"""What of a model file changes where its parameters have other values."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TypeAlias

import numpy as np

from impact_observer.model.elements import labels
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.states import Vector

Place: TypeAlias = tuple[str | int, ...]
"""Where a value stands in a model file."""
Change: TypeAlias = tuple[Place, object]
_MATRICES = {"mass": "M", "damping": "C", "stiffness": "K"}


def changes(
    document: Mapping[str, object], family: ParametricFamily, values: Vector
) -> dict[Place, object]:
    """New values by where they stand; a matrix of a file of its own comes into the model.

    Args:
        document: the model file that ``family`` was made of.
        family: the given system and its free parameters.
        values: theirs, shape (p,).
    """
    told = dict(zip(family.names, values.tolist(), strict=True))
    told.pop("clock-offset", None)  # it is the sensor's
    if "bodies" in document:
        return dict(_of_elements(document, told))
    return dict(_of_matrices(family, values, told))


def _of_matrices(
    family: ParametricFamily, values: Vector, told: Mapping[str, float]
) -> Iterator[Change]:
    system = family.system_at(values)
    for name, part in _MATRICES.items():
        if f"{name}-scale" in told:
            yield (name,), getattr(system, part).tolist()
    for i, contact in enumerate(system.contacts):
        for name in ("gap", "restitution"):
            if f"{name}.{contact.name}" in told:
                yield ("contacts", i, name), told[f"{name}.{contact.name}"]
    for k in range(system.forcing.frequency.size):
        if _turns(told, k):
            for name in ("cosine", "sine"):
                part = getattr(system.forcing, name)[k]
                yield ("forcing", "harmonics", k, name), part.tolist()


def _turns(told: Mapping[str, float], k: int) -> bool:
    return any(f"forcing-{name}.{k + 1}" in told for name in ("amplitude", "phase"))


def _of_elements(document: Mapping[str, object], told: Mapping[str, float]) -> Iterator[Change]:
    for i, body in enumerate(_list(document, "bodies")):
        yield from _of_element(("bodies", i), body, "mass", str(body["name"]), told)
    springs = _list(document, "springs")
    names = labels(spring["between"] for spring in springs)
    for i, (label, spring) in enumerate(zip(names, springs, strict=True)):
        for kind in ("stiffness", "damping"):
            if kind in spring:
                yield from _of_element(("springs", i), spring, kind, label, told)
    for i, stop in enumerate(_list(document, "stops")):
        yield from _of_stop(i, stop, told)
    harmonics = [
        (i, each) for i, each in enumerate(_list(document, "forces")) if "constant" not in each
    ]
    for k, (i, force) in enumerate(harmonics):
        if (ratio := told.get(f"forcing-amplitude.{k + 1}")) is not None:
            yield ("forces", i, "amplitude"), _float(force["amplitude"]) * ratio
        if (ahead := told.get(f"forcing-phase.{k + 1}")) is not None:
            phase = _float(force.get("phase", 0.0)) + ahead
            yield ("forces", i, "phase"), float(np.remainder(phase + np.pi, 2 * np.pi) - np.pi)


def _of_element(
    place: Place, element: Mapping[str, object], kind: str, label: str, told: Mapping[str, float]
) -> Iterator[Change]:
    """A mass, stiffness or damping: by itself, or scaled with all."""
    if f"{kind}.{label}" in told:
        yield (*place, kind), told[f"{kind}.{label}"]
    elif f"{kind}-scale" in told:
        yield (*place, kind), _float(element[kind]) * told[f"{kind}-scale"]


def _of_stop(i: int, stop: Mapping[str, object], told: Mapping[str, float]) -> Iterator[Change]:
    name = str(stop["name"])
    if (restitution := told.get(f"restitution.{name}")) is not None:
        yield ("stops", i, "restitution"), restitution
    if (gap := told.get(f"gap.{name}")) is None:
        return
    if "between" in stop:
        yield ("stops", i, "gap"), gap
    else:
        yield ("stops", i, "limit"), gap if stop["side"] == "above" else -gap


def _list(document: Mapping[str, object], key: str) -> Sequence[Mapping[str, object]]:
    found = document.get(key, [])
    assert isinstance(found, list), "a model that was read has a list there"
    return found


def _float(value: object) -> float:
    assert isinstance(value, (int, float)), "a model that was read has a number there"
    return float(value)
