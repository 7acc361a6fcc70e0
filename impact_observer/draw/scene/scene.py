# SPDX-License-Identifier: Apache-2.0
"""Places of bodies, springs and stops of a system in a drawing: boxes on one line, at true scale.

A coordinate is a box, home at its place in the row and displaced by ``q``. A contact of one
coordinate is a wall, which the face of the box reaches exactly when ``g = 0``. A contact of two
neighbours is a bumper, which fills the room between their faces exactly when ``g = 0``. Any other
contact is a bar with a pin, whose distance from the plate is ``g``. Lengths along the line are in
metres (rad for an angle), across the line in heights of a body.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike

from impact_observer.draw.scene.arrangement import Arrangement, Bumper, Wall, arranged, body_order
from impact_observer.errors import UsageError
from impact_observer.model import System
from impact_observer.model.system import Guide
from impact_observer.states import Matrix, Vector, frozen

MOST_BODIES = 24
"""Most bodies in a drawing: more bodies could not be distinguished."""
MOST_LANES = 3
"""Most couplings above each other over the bodies."""
_GROUND = 0.6
"""Distance from a body between others to its ground, over the pitch."""
_ZERO = 1e-9
"""Entries of a matrix below this, relative to the largest, count as rounding."""


class SceneJoint(Enum):
    """Kind of a coupling between two bodies, or between a body and the ground."""

    SPRING = "spring"
    """Stiffness, with damping or without."""
    DAMPER = "damper"
    """Damping alone."""
    LINK = "link"
    """Stiffness or damping of the sign that no spring or damper between two bodies has."""
    GUIDE = "guide"
    """Dry friction, always above the bodies: a spring often joins the same bodies."""


@dataclass(frozen=True, slots=True)
class Bar:
    """A contact that is neither wall nor bumper: a pin that moves towards a plate.

    Attributes:
        contact: index of the contact.
        plate: position of the plate, m.
        span: largest distance of the pin from the plate, m.
        lane: number of the bar below the bodies, from 0.
    """

    contact: int
    plate: float
    span: float
    lane: int


@dataclass(frozen=True, slots=True)
class Coupling:
    """A spring, a damper, a link or a guide, drawn from its left to its right end.

    Attributes:
        joint: kind of the coupling.
        left: place of the body at the left end; None for the ground.
        right: place of the body at the right end; None for the ground.
        ground: position of the ground, m; 0 between two bodies.
        lane: 0 between the faces of neighbours or of a body and a wall; above the bodies from 1.
    """

    joint: SceneJoint
    left: int | None
    right: int | None
    ground: float
    lane: int


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """Positions of all moving parts, m along the line.

    Attributes:
        bodies: middles of the boxes, shape (bodies,).
        couplings: left and right ends, shape (couplings, 2).
        bumpers: beginning and end of each rod, shape (bumpers, 2).
        pins: of the bars, shape (bars,).
        gaps: ``g`` of all contacts of the system, shape (m,).
        walls: left ends of the walls' faces, shape (walls,).
    """

    bodies: Vector
    couplings: Matrix
    bumpers: Matrix
    pins: Vector
    gaps: Vector
    walls: Vector


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Positions of all parts of a system; made by ``Scene.of_system``.

    Attributes:
        system: whose parts are drawn.
        order: coordinate of each body in the row, from the left.
        homes: middles of the boxes at ``q = 0``, m, shape (bodies,).
        half: half the width of a box, m.
        thickness: of walls and plates, m.
        walls: stops of single bodies.
        bumpers: stops between neighbours.
        bars: other contacts.
        couplings: springs, dampers, links, guides.
        extent: left and right end of the picture, m.
        omitted: a line for each kind of parts that are not drawn.
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
    def of_system(
        cls, system: System, positions: ArrayLike = (), amplitude: float = 0.0
    ) -> "Scene":
        """The scene of a system, with room for given states.

        No two boxes or walls overlap in any of these states, unless the states violate the stops.

        Args:
            system: whose parts are drawn.
            positions: coordinates, shape (samples, n), m; with fewer than two samples, coordinates
                are assumed to move somewhat farther than the stops.
            amplitude: largest displacement of each coordinate instead, m; 0 to use ``positions``.

        Raises:
            UsageError: positions of another shape, or not finite.
        """
        states = np.asarray(positions, dtype=np.float64)
        states = states.reshape(-1, system.n) if states.size == 0 else states
        if states.ndim != 2 or states.shape[1] != system.n or not np.isfinite(states).all():
            raise UsageError(
                f"positions: shape {states.shape}; expected (samples, {system.n}), all finite"
            )
        shown = min(system.n, MOST_BODIES)
        order = body_order(system, shown)
        row = arranged(system, order, states, amplitude)
        homes = frozen(np.arange(shown) * row.pitch)
        couplings, left_out = _couplings(system, order, homes, row)
        extent = _extent(homes, row, couplings)
        bars = tuple(_bars(system, homes, order, row, extent[1]))
        drawn = len(row.walls) + len(row.bumpers) + len(bars)
        return cls(
            system=system,
            order=order,
            homes=homes,
            half=row.half,
            thickness=row.thickness,
            walls=row.walls,
            bumpers=row.bumpers,
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
    def up(self) -> int:
        """Sign of the upward direction of a single coordinate that falls; 0 for other systems."""
        system = self.system
        falls = system.n == 1 and not system.K.any()
        return -int(np.sign(system.forcing.constant[0])) if falls else 0

    @property
    def lanes(self) -> int:
        """Number of lanes of couplings above the bodies."""
        return max((each.lane for each in self.couplings), default=0)

    @property
    def bar_lanes(self) -> int:
        """Number of lanes of bars below the bodies."""
        return max((each.lane + 1 for each in self.bars), default=0)

    def face(self, wall: Wall) -> float:
        """The position of a wall's face, m, which the body's face reaches at ``g = 0``."""
        return float(self.homes[wall.slot]) + wall.side * self.half + wall.travel

    def rod(self, bumper: Bumper) -> float:
        """The length of a bumper's rod, m, which reaches the right body's face at ``g = 0``."""
        left, right = self.homes[bumper.slot : bumper.slot + 2]
        return float(right - left) - 2 * self.half - bumper.travel

    def frame(self, q: Vector, moved: Vector | None = None) -> Frame:
        """Positions at coordinates ``q``, shape (n,), m.

        ``moved`` is the addition of moving grounds to the gaps, shape (m,), m; None for none.
        """
        bodies = self.homes + np.asarray(q, dtype=np.float64)[list(self.order)]
        moved = np.zeros(self.system.m) if moved is None else moved
        gaps = self.system.gap(q) + moved
        walls = [self.face(each) + each.side * self._yields(each, moved) for each in self.walls]
        pins = [
            each.plate + min(max(float(gaps[each.contact]), -each.span), each.span)
            for each in self.bars
        ]
        ends = [self._ends(each, bodies) for each in self.couplings]
        faces = [
            (bodies[each.slot] + self.half, self.rod(each) - self._yields(each, moved))
            for each in self.bumpers
        ]
        rods = [(face, face + length) for face, length in faces]
        return Frame(
            bodies=frozen(bodies),
            couplings=frozen(np.reshape(ends, (-1, 2))),
            bumpers=frozen(np.reshape(rods, (-1, 2))),
            pins=frozen(pins),
            gaps=frozen(gaps),
            walls=frozen(walls),
        )

    def _yields(self, stop: Wall | Bumper, moved: Vector) -> float:
        """Distance by which a moving ground takes a stop away from its body, m."""
        size = float(np.max(np.abs(self.system.W[:, stop.contact])))
        return float(moved[stop.contact]) / size

    def _ends(self, coupling: Coupling, bodies: Vector) -> tuple[float, float]:
        """The ends of a coupling: at faces, or above the bodies' middles."""
        inset = 0.0 if coupling.lane else self.half
        left, right = (
            coupling.ground if slot is None else float(bodies[slot]) - side * inset
            for slot, side in ((coupling.left, -1), (coupling.right, 1))
        )
        return left, right


def _extent(homes: Vector, row: Arrangement, couplings: Sequence[Coupling]) -> tuple[float, float]:
    """Left and right end of the picture, with room for springs to a wall only where needed."""
    outer = [each for each in couplings if not each.lane]
    left = 0.0 if any(each.left is None for each in outer) else row.spring
    right = 0.0 if any(each.right is None for each in outer) else row.spring
    return row.start + left, float(homes[-1]) + row.end - right


def _bars(
    system: System, homes: Vector, order: Sequence[int], row: Arrangement, end: float
) -> Iterable[Bar]:
    """Bars below the bodies with the largest factors, in several lanes if bars would overlap."""
    ends: list[float] = []
    span = row.pitch - 2 * row.thickness
    for contact in row.others:
        weights = np.abs(system.contacts[contact].direction[list(order)])
        if not weights.any():
            continue
        beneath = float(homes[int(np.argmax(weights))]) - row.half
        # The pin, as wide as a plate, must be within the picture at its farthest, too.
        plate = min(beneath, end - span - row.thickness)
        lane = next((k for k, taken in enumerate(ends) if taken <= plate), len(ends))
        ends[lane : lane + 1] = [plate + row.pitch * (1 - _ZERO)]
        yield Bar(contact, plate, span, lane)


def _couplings(
    system: System, order: Sequence[int], homes: Vector, row: Arrangement
) -> tuple[tuple[Coupling, ...], int]:
    """The couplings with a lane, and the number of couplings without one.

    Couplings of neighbours, and of the outer bodies to the ground, lie between faces. Others take
    the lowest free lane above the bodies, short and strong ones first.
    """
    last = len(order) - 1
    # The length of a coupling to the ground is the drawn length.
    shortest_first = sorted(
        _joined(system, order),
        key=lambda each: (_GROUND if each[1] < 0 else each[2] - each[1], -each[3]),
    )
    lanes: list[list[tuple[float, float]]] = [[] for _ in range(MOST_LANES)]
    drawn, left_out = [], sum(_rubbing(guide, order) is None for guide in system.guides)
    for joint, first, second, _ in shortest_first:
        above = joint is SceneJoint.GUIDE
        if first < 0 and second == 0 and not above:
            drawn.append(Coupling(joint, None, 0, row.start + row.thickness, 0))
        elif first < 0 and second == last and not above:
            ground = float(homes[-1]) + row.end - row.thickness
            drawn.append(Coupling(joint, last, None, ground, 0))
        elif 0 <= first == second - 1 and not above:
            drawn.append(Coupling(joint, first, second, 0.0, 0))
        else:
            grounded = first < 0
            begin = second - _GROUND if grounded else float(first)
            free = (
                k
                for k, taken in enumerate(lanes)
                if all(second <= start or end <= begin for start, end in taken)
            )
            if (lane := next(free, None)) is None:
                left_out += 1
                continue
            lanes[lane].append((begin, second))
            ground = float(homes[second]) - _GROUND * row.pitch if grounded else 0.0
            left = None if grounded else first
            drawn.append(Coupling(joint, left, second, ground, lane + 1))
    return tuple(drawn), left_out


def _joined(system: System, order: Sequence[int]) -> list[tuple[SceneJoint, int, int, float]]:
    """All couplings: joint, the two places in the row (-1 for the ground), strength."""
    slots = list(order)
    stiffness, damping = (
        _parts(matrix, slots) for matrix in (system.K, (system.C + system.C.T) / 2)
    )
    joined = []
    for second in range(len(slots)):
        for first in range(-1, second):
            k, c = stiffness[first, second], damping[first, second]
            if k > 0:
                joined.append((SceneJoint.SPRING, first, second, float(k)))
            elif k == 0 and c > 0:
                joined.append((SceneJoint.DAMPER, first, second, float(c)))
            elif k < 0 or c < 0:
                joined.append((SceneJoint.LINK, first, second, float(abs(k) + abs(c))))
    rubbed = [(_rubbing(guide, order), guide.force) for guide in system.guides]
    return [*joined, *((SceneJoint.GUIDE, *ends, force) for ends, force in rubbed if ends)]


def _rubbing(guide: Guide, order: Sequence[int]) -> tuple[int, int] | None:
    """The two places in the row between which a guide rubs, in order, -1 for the ground.

    Returns None for a guide that joins neither two bodies nor a body and the ground.
    """
    ends = np.flatnonzero(guide.direction[list(order)])
    weights = guide.direction[list(order)][ends]
    if np.count_nonzero(guide.direction) != ends.size or ends.size not in (1, 2):
        return None
    if ends.size == 1:
        return -1, int(ends[0])
    return (int(ends[0]), int(ends[1])) if weights.sum() == 0 else None


def _parts(matrix: Matrix, slots: Sequence[int]) -> Matrix:
    """Stiffness or damping between bodies, and in the last row (index -1) to the ground.

    The shape is (bodies + 1, bodies); rounding is set to zero.
    """
    between = -matrix[np.ix_(slots, slots)]
    ground = matrix.sum(axis=1)[slots]
    scale = np.abs(matrix).sum(axis=1)[slots]
    between[np.abs(between) <= _ZERO * np.max(np.abs(matrix), initial=0.0)] = 0.0
    ground[np.abs(ground) <= _ZERO * scale] = 0.0
    return np.vstack([between, ground])


def _omitted(system: System, bodies: int, contacts: int, couplings: int) -> Iterable[str]:
    """Lines on the parts that are not drawn.

    ``bodies`` and ``contacts`` are numbers of drawn parts, ``couplings`` of parts not drawn.
    """
    if bodies < system.n:
        yield f"the first {bodies} of {system.n} bodies"
    if contacts < system.m:
        yield f"without {system.m - contacts} of {system.m} contacts"
    if couplings:
        yield f"without {couplings} couplings"
