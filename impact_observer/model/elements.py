# SPDX-License-Identifier: Apache-2.0
"""The element form of a model: bodies, springs, forces and stops along one line.

The elements are assembled to the matrices of the matrix form.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from impact_observer.errors import ModelError
from impact_observer.model import sampled_files
from impact_observer.model.document import Section, Value
from impact_observer.model.forcing import Forcing
from impact_observer.model.ground_keys import (
    GroundMotions,
    live_names,
    read_grounds,
)
from impact_observer.model.grounds import LiveNames
from impact_observer.model.rebounds import REBOUND_KEYS, read_rebound
from impact_observer.model.square_waves import SquareWaves
from impact_observer.model.system import Contact, System, moving_system
from impact_observer.states import Matrix, Vector

GROUND = "ground"
SQUARE = "square"
"""The shape of a force that is not harmonic."""
KEYS = ("bodies", "grounds", "springs", "forces", "forcing", "stops")
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
    """The named bodies on the line; grounds have no coordinate, and ``ground`` is at rest."""

    def __init__(self, names: list[str], motions: GroundMotions) -> None:
        self.names = names
        self.motions = motions
        self.n = len(names)

    def unit(self, key: str, body: Value) -> Vector:
        """The unit vector of ``body``, zero for a ground."""
        e = np.zeros(self.n)
        if body == GROUND or body in self.motions.names:
            return e
        if not isinstance(body, str) or body not in self.names:
            expected = ", ".join((*self.names, GROUND, *self.motions.names))
            raise ModelError(key, f"{body!r} is not a body; expected one of {expected}")
        e[self.names.index(body)] = 1.0
        return e

    def body(self, section: Section) -> Vector:
        """The unit vector of a section's ``body``, which may not be the ground."""
        e = self.unit(section.key("body"), section.value("body"))
        if not e.any():
            raise ModelError(section.key("body"), "is the ground, which does not move")
        return e

    def ground(self, section: Section) -> Vector:
        """The unit vector of a section's ``ground``, shape (grounds,); zero for ``ground``."""
        name = section.value("ground") if "ground" in section else GROUND
        if name != GROUND and name not in self.motions.names:
            expected = ", ".join((GROUND, *self.motions.names))
            raise ModelError(
                section.key("ground"), f"{name!r} is not a ground; expected one of {expected}"
            )
        return self.motions.unit(name)

    def relative(self, section: Section) -> Vector:
        """``q_b - q_a`` as a row, for a section's ``between: [a, b]``."""
        key, pair = section.key("between"), section.value("between")
        if not isinstance(pair, list) or len(pair) != 2 or pair[0] == pair[1]:
            raise ModelError(key, f"{pair!r} found; expected two different bodies [a, b]")
        return self.unit(f"{key}[1]", pair[1]) - self.unit(f"{key}[0]", pair[0])

    def moving(self, pair: Value) -> Vector:
        """Factors of ground displacements in ``q_b - q_a`` of two ends, shape (grounds,)."""
        assert isinstance(pair, list), "relative() has checked the pair"
        return self.motions.unit(pair[1]) - self.motions.unit(pair[0])


def assembled_system(
    name: str, document: Section, folder: Path | None
) -> tuple[System, tuple[Element, ...]]:
    """The system called ``name`` that a model file assembles, and its elements.

    ``folder`` is where the CSV file of a sampled forcing lies.

    Raises:
        ModelError: naming the element's key.
    """
    bodies = [Section(k, v, ("name", "mass")) for k, v in document.items("bodies")]
    if not bodies:
        raise ModelError("bodies", "is missing or empty; a system needs at least one body")
    names = [body.text("name") for body in bodies]
    line = _Line(names, read_grounds(document, (*names, GROUND), folder))
    for i, (section, body) in enumerate(zip(bodies, line.names, strict=True)):
        if body == GROUND:
            raise ModelError(section.key("name"), f"{GROUND!r} is reserved; choose another name")
        if body in line.names[:i]:
            raise ModelError(section.key("name"), f"{body!r} is taken already; names must differ")
    elements = [
        Element("mass", body, section.positive("mass"), np.outer(axis, axis))
        for section, body, axis in zip(bodies, line.names, np.eye(line.n), strict=True)
    ]
    springs = [Section(*item, ("between", *KINDS[1:])) for item in document.items("springs")]
    elements += _springs(line, springs)
    matrices = {kind: np.zeros((line.n, line.n)) for kind in KINDS}
    for each in elements:
        matrices[each.kind] += each.value * each.matrix
    forcing, live = _forcing(line, document, folder)
    stops = [_stop(line, key, value) for key, value in document.items("stops")]
    M, C, K = matrices["mass"], matrices["damping"], matrices["stiffness"]
    contacts = tuple(contact for contact, _ in stops)
    try:
        system = System(name, tuple(line.names), M, C, K, forcing, contacts)
        if grounds := line.motions.names:
            factors = np.reshape([factor for _, factor in stops], (-1, len(grounds)))
            pushed = [_pushed(line, springs, kind) for kind in KINDS[1:]]
            system = moving_system(system, line.motions.grounds(pushed[0], pushed[1], factors))
        system = replace(system, live=live)
    except ModelError as error:
        raise ModelError(error.key.replace("contacts[", "stops["), error.problem) from None
    return system, tuple(each for each in elements if each.value)


def _springs(line: _Line, springs: list[Section]) -> Iterator[Element]:
    directions = [line.relative(spring) for spring in springs]
    names = labels([spring.value("between") for spring in springs])
    for spring, direction, name in zip(springs, directions, names, strict=True):
        dyad = np.outer(direction, direction)
        yield Element("stiffness", name, spring.positive("stiffness", or_zero=True), dyad)
        if "damping" in spring:
            yield Element("damping", name, spring.positive("damping", or_zero=True), dyad)


def _pushed(line: _Line, springs: list[Section], kind: str) -> Matrix:
    """Forces by unit displacements, or speeds, of the grounds, shape (n, grounds)."""
    forces = np.zeros((line.n, len(line.motions.names)))
    for spring in springs:
        moving = line.moving(spring.value("between"))
        forces -= spring.number(kind, 0.0) * np.outer(line.relative(spring), moving)
    return forces


def labels(pairs: Iterable[Value]) -> list[str]:
    """Names of springs by their two ends; a second spring between the same ends ends in ``#2``."""
    plain: list[str] = []
    for pair in pairs:
        assert isinstance(pair, list), "a spring that was read has two ends"
        plain.append("-".join(map(str, pair)))
    counts = [plain[: i + 1].count(label) for i, label in enumerate(plain)]
    return [
        label if count == 1 else f"{label}#{count}"
        for label, count in zip(plain, counts, strict=True)
    ]


def _forcing(
    line: _Line, document: Section, folder: Path | None
) -> tuple[Forcing, LiveNames | None]:
    """``f(t)``, and the names of live forces and grounds; None where the model has none."""
    forcing, inputs = _sum(line, document.items("forces"))
    live = live_names(inputs, line.n)
    if "forcing" not in document:
        return forcing, live
    section = Section("forcing", document.value("forcing"), sampled_files.KEYS)
    section.value("sampled")
    return replace(forcing, sampled=sampled_files.read_samples(section, line.names, folder)), live


def _sum(line: _Line, forces: list[tuple[str, Value]]) -> tuple[Forcing, list[tuple[str, Vector]]]:
    """The sum of known forces, and names and directions of live forces."""
    constant = np.zeros(line.n)
    frequency, cosine, sine, inputs = list[float](), [], [], list[tuple[str, Vector]]()
    squares = list[tuple[float, float, Vector]]()
    for key, value in forces:
        kinds = ("constant", "amplitude", "frequency", "phase", "shape", "input")
        force = Section(key, value, ("body", *kinds))
        e = line.body(force)
        if "input" in force:
            for name in kinds[:-1]:
                if name in force:
                    raise ModelError(
                        force.key(name), "stands beside input; write two forces instead"
                    )
            inputs.append((force.text("input"), e))
            continue
        if "constant" in force:
            for name in kinds[1:-1]:
                if name in force:
                    raise ModelError(
                        force.key(name), "stands beside constant; write two forces instead"
                    )
            constant += force.number("constant") * e
            continue
        amplitude, phase = force.number("amplitude"), force.number("phase", 0.0)
        if "shape" in force:
            if (shape := force.text("shape")) != SQUARE:
                raise ModelError(force.key("shape"), f"{shape!r} found; expected {SQUARE}")
            squares.append((force.positive("frequency"), phase, amplitude * e))
            continue
        frequency.append(force.positive("frequency"))
        cosine.append(amplitude * np.cos(phase) * e)
        sine.append(-amplitude * np.sin(phase) * e)
    h = len(frequency)
    forcing = Forcing(
        constant,
        np.array(frequency),
        np.reshape(cosine, (h, line.n)),
        np.reshape(sine, (h, line.n)),
        squares=SquareWaves.of_rows(squares) if squares else None,
    )
    return forcing, inputs


def _stop(line: _Line, key: str, value: Value) -> tuple[Contact, Vector]:
    """A stop, and the factors of ground displacements in the gap, shape (grounds,)."""
    keys = ("body", "limit", "side", "ground", "between", "gap")
    stop = Section(key, value, ("name", *REBOUND_KEYS, *keys))
    if "between" in stop:
        for name in ("body", "limit", "side", "ground"):
            if name in stop:
                raise ModelError(stop.key(name), "does not go with between; expected gap")
        direction, gap = line.relative(stop), stop.number("gap")
        moving = line.moving(stop.value("between"))
    else:
        if "gap" in stop:
            raise ModelError(stop.key("gap"), "does not go with body; expected limit and side")
        side = stop.value("side")
        if side not in ("above", "below"):
            raise ModelError(stop.key("side"), f"{side!r} found; expected above or below")
        sign = -1.0 if side == "above" else 1.0
        direction, gap = sign * line.body(stop), -sign * stop.number("limit")
        moving = -sign * line.ground(stop)
    law = read_rebound(stop)
    return Contact(stop.text("name"), direction, gap, law.nominal, law), moving
