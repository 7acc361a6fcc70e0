"""Where bodies, springs and stops of a system are drawn: boxes on one line, in true distances.

A coordinate is a box, home at its place in the row and displaced by ``q``. A contact of one
coordinate is a wall that the box's face touches exactly when ``g = 0``; one that compares two
neighbours is a bumper between them, which spans the room between their faces exactly then. Any
other contact is a bar with a pin: its distance from the plate is ``g``. Along the line everything
is in metres (rad where a coordinate is an angle), across it in heights of a body.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike

from impact_observer.draw.scene.arrangement import Measures, measured, ordered
from impact_observer.errors import UsageError
from impact_observer.model import System
from impact_observer.states import Matrix, Vector, frozen

MOST_BODIES = 24
"""Most bodies that are drawn: more are not told apart."""
MOST_LANES = 3
"""Most couplings above each other over the bodies."""
_GROUND = 0.6
"""How far from a body between others its ground is, over the pitch."""
_ZERO = 1e-9
"""Entries of a matrix below this, relative to the largest, are rounding."""


class SceneJoint(Enum):
    """What joins two bodies, or a body and the ground."""

    SPRING = "spring"
    """Stiffness, with damping or without."""
    DAMPER = "damper"
    """Damping alone."""
    LINK = "link"
    """What no spring or damper between two bodies does: a coupling of the other sign."""


@dataclass(frozen=True, slots=True)
class Wall:
    """A stop that one body meets.

    Attributes:
        contact: its index.
        slot: the body's place in the row.
        side: +1 where the stop is on the body's right, -1 on its left.
        face: where its face is, m.
    """

    contact: int
    slot: int
    side: int
    face: float


@dataclass(frozen=True, slots=True)
class Bumper:
    """A stop between two neighbours: a rod on the left one's right face.

    Attributes:
        contact: its index.
        slot: the left body's place in the row.
        length: of the rod, m; it reaches the right body's face exactly when ``g = 0``.
    """

    contact: int
    slot: int
    length: float


@dataclass(frozen=True, slots=True)
class Bar:
    """Any other contact, as a pin that comes down to a plate.

    Attributes:
        contact: its index.
        plate: where the plate is, m.
        span: the largest gap that is shown, m; the pin stops there.
        lane: which bar below the bodies, from 0.
    """

    contact: int
    plate: float
    span: float
    lane: int


@dataclass(frozen=True, slots=True)
class Coupling:
    """A spring, a damper or a link, drawn from its left to its right end.

    Attributes:
        joint: which of them.
        left: place of the body at its left end; None for the ground.
        right: place of the body at its right end; None for the ground.
        ground: where the ground is, m; 0 where there is none.
        lane: 0 between the faces of neighbours or of a body and a wall; above the bodies from 1.
    """

    joint: SceneJoint
    left: int | None
    right: int | None
    ground: float
    lane: int


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """Where everything that moves is in one state, m along the line.

    Attributes:
        bodies: middles of the boxes, shape (bodies,).
        couplings: left and right ends, shape (couplings, 2).
        bumpers: where each rod begins and ends, shape (bumpers, 2).
        pins: shape (bars,).
        gaps: ``g`` of all contacts of the system, shape (m,).
    """

    bodies: Vector
    couplings: Matrix
    bumpers: Matrix
    pins: Vector
    gaps: Vector


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """What stands where, of a system; make it by ``Scene.of``.

    Attributes:
        system: what is drawn.
        order: coordinate of each body in the row, from the left.
        homes: middles of the boxes at ``q = 0``, m, shape (bodies,).
        half: half the width of a box, m.
        thickness: of walls and plates, m.
        walls: stops of single bodies.
        bumpers: stops between neighbours.
        bars: other contacts.
        couplings: springs, dampers, links.
        extent: left and right end of the picture, m.
        omitted: what is left out, a line each.
    """

    system: System
    order: tuple[int, ...]
    homes: Vector
    half: float
    thickness: float
    walls: tuple[Wall, ...]
    bumpers: tuple[Bumper, ...]
    bars: tuple[Bar, ...]
    couplings: tuple[Coupling, ...]
    extent: tuple[float, float]
    omitted: tuple[str, ...]

    @classmethod
    def of(cls, system: System, positions: ArrayLike = (), reach: float = 0.0) -> "Scene":
        """The scene of a system and of the states that will be seen in it.

        No two boxes or walls overlap in any of these states as long as they obey the stops.

        Args:
            system: what to draw.
            positions: coordinates, shape (samples, n), m; with fewer than two, it is taken to
                move somewhat farther than its stops are.
            reach: how far each coordinate is taken to move instead, m; 0 for as above.

        Raises:
            UsageError: positions of another shape, or not finite.
        """
        known = np.asarray(positions, dtype=np.float64)
        known = known.reshape(-1, system.n) if known.size == 0 else known
        if known.ndim != 2 or known.shape[1] != system.n or not np.isfinite(known).all():
            raise UsageError(
                f"positions: shape {known.shape}; expected (samples, {system.n}), all finite"
            )
        shown = min(system.n, MOST_BODIES)
        order = ordered(system, shown)
        measures = measured(system, order, known, reach)
        homes = frozen(np.arange(shown) * measures.pitch)
        walls = tuple(_walls(measures, homes))
        bumpers = tuple(
            Bumper(each.contact, each.slot, measures.pitch - 2 * measures.half - each.gap)
            for each in measures.pairs
        )
        couplings, left_out = _couplings(system, order, homes, measures)
        extent = _extent(homes, measures, couplings)
        bars = tuple(_bars(system, homes, order, measures, extent[1]))
        drawn = len(walls) + len(bumpers) + len(bars)
        return cls(
            system=system,
            order=order,
            homes=homes,
            half=measures.half,
            thickness=measures.thickness,
            walls=walls,
            bumpers=bumpers,
            bars=bars,
            couplings=couplings,
            extent=extent,
            omitted=tuple(_omitted(system, shown, drawn, left_out)),
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates that are drawn, from the left."""
        return tuple(self.system.coordinates[i] for i in self.order)

    @property
    def lanes(self) -> int:
        """How many lanes of couplings there are above the bodies."""
        return max((each.lane for each in self.couplings), default=0)

    @property
    def bar_lanes(self) -> int:
        """How many lanes of bars there are below the bodies."""
        return max((each.lane + 1 for each in self.bars), default=0)

    def frame(self, q: Vector) -> Frame:
        """Where everything is at ``q``, shape (n,), m."""
        bodies = self.homes + np.asarray(q, dtype=np.float64)[list(self.order)]
        gaps = self.system.gap(q)
        faces = [bodies[each.slot] + self.half for each in self.bumpers]
        pins = [
            each.plate + min(max(float(gaps[each.contact]), -each.span), each.span)
            for each in self.bars
        ]
        ends = [self._ends(each, bodies) for each in self.couplings]
        rods = [(face, face + each.length) for face, each in zip(faces, self.bumpers, strict=True)]
        return Frame(
            bodies=frozen(bodies),
            couplings=frozen(np.reshape(ends, (-1, 2))),
            bumpers=frozen(np.reshape(rods, (-1, 2))),
            pins=frozen(pins),
            gaps=frozen(gaps),
        )

    def _ends(self, coupling: Coupling, bodies: Vector) -> tuple[float, float]:
        """Where a coupling begins and ends: at faces, or on top of the bodies' middles."""
        inset = 0.0 if coupling.lane else self.half
        left, right = (
            coupling.ground if slot is None else float(bodies[slot]) - side * inset
            for slot, side in ((coupling.left, -1), (coupling.right, 1))
        )
        return left, right


def _walls(measures: Measures, homes: Vector) -> Iterable[Wall]:
    """Each at the face of its body when the body touches it."""
    for each in measures.singles:
        face = float(homes[each.slot]) + each.side * measures.half + each.change
        yield Wall(each.contact, each.slot, each.side, face)


def _extent(
    homes: Vector, measures: Measures, couplings: Sequence[Coupling]
) -> tuple[float, float]:
    """Left and right end of the picture: no room for springs to a wall where there is none."""
    outer = [each for each in couplings if not each.lane]
    left = 0.0 if any(each.left is None for each in outer) else measures.spring
    right = 0.0 if any(each.right is None for each in outer) else measures.spring
    return measures.start + left, float(homes[-1]) + measures.end - right


def _bars(
    system: System, homes: Vector, order: Sequence[int], measures: Measures, end: float
) -> Iterable[Bar]:
    """One each, below the body that moves the contact most; lanes where they would overlap."""
    ends: list[float] = []
    span = measures.pitch - 2 * measures.thickness
    for contact in measures.others:
        weights = np.abs(system.contacts[contact].direction[list(order)])
        if not weights.any():
            continue
        beneath = float(homes[int(np.argmax(weights))]) - measures.half
        # The pin, which is as wide as a plate, is to be seen at its farthest too.
        plate = min(beneath, end - span - measures.thickness)
        lane = next((k for k, taken in enumerate(ends) if taken <= plate), len(ends))
        ends[lane : lane + 1] = [plate + measures.pitch * (1 - _ZERO)]
        yield Bar(contact, plate, span, lane)


def _couplings(
    system: System, order: Sequence[int], homes: Vector, measures: Measures
) -> tuple[tuple[Coupling, ...], int]:
    """All that have a lane, and how many have none.

    Neighbours, and the outer bodies and the walls beside them, are coupled between their faces.
    Others take the lowest lane above the bodies that is free, the short and strong ones first.
    """
    last = len(order) - 1
    found = sorted(_joined(system, order), key=_length)
    lanes: list[list[tuple[float, float]]] = [[] for _ in range(MOST_LANES)]
    drawn, left_out = [], 0
    for joint, first, second, _ in found:
        if first < 0 and second == 0:
            drawn.append(Coupling(joint, None, 0, measures.start + measures.thickness, 0))
        elif first < 0 and second == last:
            ground = float(homes[-1]) + measures.end - measures.thickness
            drawn.append(Coupling(joint, last, None, ground, 0))
        elif first == second - 1:
            drawn.append(Coupling(joint, first, second, 0.0, 0))
        else:
            grounded = first < 0
            begin = second - _GROUND if grounded else float(first)
            lane = next((k for k, taken in enumerate(lanes) if _free(taken, begin, second)), None)
            if lane is None:
                left_out += 1
                continue
            lanes[lane].append((begin, second))
            ground = float(homes[second]) - _GROUND * measures.pitch if grounded else 0.0
            left = None if grounded else first
            drawn.append(Coupling(joint, left, second, ground, lane + 1))
    return tuple(drawn), left_out


def _free(taken: Iterable[tuple[float, float]], begin: float, end: float) -> bool:
    """Whether a lane has room from one place in the row to another."""
    return all(end <= start or stop <= begin for start, stop in taken)


def _joined(system: System, order: Sequence[int]) -> list[tuple[SceneJoint, int, int, float]]:
    """What is coupled: joint, places in the row (the ground is -1 where alone), strength."""
    slots = list(order)
    stiffness, damping = (
        _parts(matrix, slots) for matrix in (system.K, (system.C + system.C.T) / 2)
    )
    found = []
    for second in range(len(slots)):
        for first in range(-1, second):
            k, c = stiffness[first, second], damping[first, second]
            if k > 0:
                found.append((SceneJoint.SPRING, first, second, float(k)))
            elif k == 0 and c > 0:
                found.append((SceneJoint.DAMPER, first, second, float(c)))
            elif k < 0 or c < 0:
                found.append((SceneJoint.LINK, first, second, float(abs(k) + abs(c))))
    return found


def _length(joined: tuple[SceneJoint, int, int, float]) -> tuple[float, float]:
    """By what couplings are sorted: the short ones first, of those the strong ones."""
    _, first, second, strength = joined
    return (_GROUND if first < 0 else second - first), -strength


def _parts(matrix: Matrix, slots: Sequence[int]) -> Matrix:
    """Stiffness or damping between bodies, and in the last row (index -1) to the ground.

    Args:
        matrix: shape (n, n), symmetric.
        slots: coordinates of the bodies that are drawn.

    Returns:
        Shape (bodies + 1, bodies); what is rounding is zero.
    """
    between = -matrix[np.ix_(slots, slots)]
    ground = matrix.sum(axis=1)[slots]
    scale = np.abs(matrix).sum(axis=1)[slots]
    between[np.abs(between) <= _ZERO * np.max(np.abs(matrix), initial=0.0)] = 0.0
    ground[np.abs(ground) <= _ZERO * scale] = 0.0
    return np.vstack([between, ground])


def _omitted(system: System, bodies: int, contacts: int, couplings: int) -> Iterable[str]:
    """What is not drawn, in words.

    Args:
        system: what there is to draw.
        bodies: how many of them are drawn.
        contacts: how many of them are drawn.
        couplings: how many between these bodies are not.
    """
    if bodies < system.n:
        yield f"the first {bodies} of {system.n} bodies"
    if contacts < system.m:
        yield f"without {system.m - contacts} of {system.m} contacts"
    if couplings:
        yield f"without {couplings} couplings"
