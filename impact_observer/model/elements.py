# SPDX-License-Identifier: Apache-2.0
"""The element form of a model: bodies, springs, forces and stops along one line.

Bodies and moving grounds are the axes of one space, in which each spring and each stop is a row.
The elements are assembled to the matrices of the matrix form.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from msgspec import UnsetType

from impact_observer.errors import ModelError
from impact_observer.model.document import check_names
from impact_observer.model.forcing import Forcing
from impact_observer.model.ground_keys import live_names, read_grounds
from impact_observer.model.rebounds import read_rebound
from impact_observer.model.sampled_files import read_samples
from impact_observer.model.schema import ElementModel, Force, StopKeys
from impact_observer.model.square_waves import SquareWaves
from impact_observer.model.system import Contact, System, moving_system
from impact_observer.states import Matrix, Vector

GROUND = "ground"
KINDS = ("mass", "stiffness", "damping")


@dataclass(frozen=True, slots=True, eq=False)
class Element:
    """A mass, a spring or a damper.

    Attributes:
        kind: ``mass``, ``stiffness`` or ``damping``.
        label: the body, or the two ends of a spring, such as ``ground-x1``; a second spring
            between the same ends is ``ground-x1#2``.
        value: kg, N/m or Ns/m.
        matrix: shape (n, n); ``value`` times ``matrix`` is added to the system's matrix.
    """

    kind: str
    label: str
    value: float
    matrix: Matrix


class _Line:
    """The axes of n named bodies and k moving grounds; ``ground`` is at rest and has none."""

    def __init__(self, bodies: Sequence[str], grounds: Sequence[str]) -> None:
        self.n, names = len(bodies), (*bodies, *grounds)
        self.bodies, self.grounds = bodies, (GROUND, *grounds)
        self._axes = dict(zip(names, np.eye(len(names)), strict=True))
        self._axes[GROUND] = np.zeros(len(names))

    def axis(self, key: str, name: str) -> Vector:
        """The axis of a body or a ground, shape (n + k,)."""
        if name not in self._axes:
            wanted = ", ".join((*self.bodies, *self.grounds))
            raise ModelError(key, f"{name!r} is not a body; expected one of {wanted}")
        return self._axes[name]

    def body(self, key: str, name: str) -> Vector:
        """The axis of a body among bodies alone, shape (n,)."""
        axis = self.axis(key, name)[: self.n]
        if name in self.grounds:
            raise ModelError(key, "is the ground, which does not move; expected a body")
        return axis

    def across(self, key: str, ends: Sequence[str]) -> Vector:
        """``q_b - q_a`` of two ends [a, b] as a row, shape (n + k,)."""
        if ends[0] == ends[1]:
            raise ModelError(key, f"{list(ends)} found; expected two different bodies [a, b]")
        return self.axis(f"{key}[1]", ends[1]) - self.axis(f"{key}[0]", ends[0])


def assembled_system(
    model: ElementModel, folder: Path | None
) -> tuple[System, tuple[Element, ...]]:
    """The system that a model file assembles, and its elements.

    ``folder`` is where the CSV files lie.

    Raises:
        ModelError: naming the element's key.
    """
    names = [body.name for body in model.bodies]
    check_names("bodies", names, member=".name", taken=(GROUND,))
    motions = read_grounds(model.grounds, (*names, GROUND), folder)
    line, n = _Line(names, motions.names), len(names)
    ends = [line.across(f"springs[{i}].between", s.between) for i, s in enumerate(model.springs)]
    elements = [
        Element("mass", body.name, body.mass, np.outer(axis, axis))
        for body, axis in zip(model.bodies, np.eye(n), strict=True)
    ]
    pushed = {kind: np.zeros((n, len(motions.names))) for kind in KINDS}
    names_of_springs = labels(spring.between for spring in model.springs)
    for label, spring, d in zip(names_of_springs, model.springs, ends, strict=True):
        for kind, value in (("stiffness", spring.stiffness), ("damping", spring.damping)):
            if not isinstance(value, UnsetType):
                elements.append(Element(kind, label, value, np.outer(d[:n], d[:n])))
                pushed[kind] -= value * np.outer(d[:n], d[n:])
    matrices = {kind: np.zeros((n, n)) for kind in KINDS}
    for each in elements:
        matrices[each.kind] += each.value * each.matrix
    forcing, inputs = _sum(line, model.forces)
    if not isinstance(model.forcing, UnsetType):
        if isinstance(model.forcing.sampled, UnsetType):
            raise ModelError("forcing.sampled", "is missing")
        forcing = replace(forcing, sampled=read_samples(model.forcing, names, folder))
    stops = [_stop(line, f"stops[{i}]", stop) for i, stop in enumerate(model.stops)]
    contacts = tuple(contact for contact, _ in stops)
    M, K, C = (matrices[kind] for kind in KINDS)
    try:
        system = System(model.name, tuple(names), M, C, K, forcing, contacts)
        if motions.names:
            factors = np.reshape([factor for _, factor in stops], (-1, len(motions.names)))
            grounds = motions.grounds(pushed["stiffness"], pushed["damping"], factors)
            system = moving_system(system, grounds)
        system = replace(system, live=live_names(inputs, n))
    except ModelError as error:
        raise ModelError(error.key.replace("contacts[", "stops["), error.problem) from None
    return system, tuple(each for each in elements if each.value)


def labels(pairs: Iterable[Sequence[str]]) -> Iterator[str]:
    """Names of springs by their two ends; a second spring between the same ends ends in ``#2``."""
    counts = dict[str, int]()
    for pair in pairs:
        label = "-".join(pair)
        counts[label] = counts.get(label, 0) + 1
        yield label if counts[label] == 1 else f"{label}#{counts[label]}"


def _sum(line: _Line, forces: Sequence[Force]) -> tuple[Forcing, list[tuple[str, Vector]]]:
    """The sum of known forces, and names and directions of live forces."""
    constant = np.zeros(line.n)
    waves, inputs = list[tuple[float, Vector, Vector]](), list[tuple[str, Vector]]()
    squares = list[tuple[float, float, Vector]]()
    for i, force in enumerate(forces):
        key = f"forces[{i}]"
        e = line.body(f"{key}.body", force.body)
        phase = 0.0 if isinstance(force.phase, UnsetType) else force.phase
        if not isinstance(force.input, UnsetType):
            _check_alone(key, force, "input")
            inputs.append((force.input, e))
        elif not isinstance(force.constant, UnsetType):
            _check_alone(key, force, "constant")
            constant += force.constant * e
        elif isinstance(force.amplitude, UnsetType):
            raise ModelError(f"{key}.amplitude", "is missing; expected it, constant or input")
        elif force.shape == "square":
            squares.append((force.omega(key), phase, force.amplitude * e))
        else:
            cosine = force.amplitude * np.cos(phase) * e
            waves.append((force.omega(key), cosine, -force.amplitude * np.sin(phase) * e))
    forcing = Forcing(
        constant,
        np.array([each[0] for each in waves]),
        np.reshape([each[1] for each in waves], (len(waves), line.n)),
        np.reshape([each[2] for each in waves], (len(waves), line.n)),
        squares=SquareWaves.of_rows(squares) if squares else None,
    )
    return forcing, inputs


def _check_alone(key: str, force: Force, kind: str) -> None:
    """Raise ModelError if other keys of a force stand beside the one of its ``kind``."""
    for name in force.__struct_fields__:
        if name not in ("body", kind) and not isinstance(getattr(force, name), UnsetType):
            raise ModelError(f"{key}.{name}", f"stands beside {kind}; write two forces instead")


def _stop(line: _Line, key: str, stop: StopKeys) -> tuple[Contact, Vector]:
    """A stop, and the factors of ground displacements in the gap, shape (k,)."""
    is_between = not isinstance(stop.between, UnsetType)
    wanted = ("between", "gap") if is_between else ("body", "limit", "side")
    for name in ("body", "limit", "side", "ground", "gap"):
        is_given = not isinstance(getattr(stop, name), UnsetType)
        if name in wanted and not is_given:
            raise ModelError(f"{key}.{name}", "is missing")
        if is_given and name not in wanted and not (name == "ground" and not is_between):
            raise ModelError(f"{key}.{name}", f"does not go with {wanted[0]}")
    if not isinstance(stop.between, UnsetType):
        row, gap = line.across(f"{key}.between", stop.between), stop.gap
    else:
        sign = -1.0 if stop.side == "above" else 1.0
        axis = np.zeros_like(line.axis("", GROUND))
        axis[: line.n] = line.body(f"{key}.body", str(stop.body))
        if not isinstance(stop.ground, UnsetType):
            if stop.ground not in line.grounds:
                wanted_grounds = ", ".join(line.grounds)
                problem = f"{stop.ground!r} is not a ground; expected one of {wanted_grounds}"
                raise ModelError(f"{key}.ground", problem)
            axis = axis - line.axis("", stop.ground)
        assert not isinstance(stop.limit, UnsetType), "checked"
        row, gap = sign * axis, -sign * stop.limit
    assert not isinstance(gap, UnsetType), "checked"
    law = read_rebound(f"{key}.restitution", stop.restitution)
    return Contact(stop.name, row[: line.n], gap, law.nominal, law), row[line.n :]
