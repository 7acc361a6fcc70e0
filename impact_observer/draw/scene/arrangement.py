"""How far apart the bodies of a scene stand, so that nothing overlaps and motion is seen."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from impact_observer.model import System
from impact_observer.states import Matrix, Vector

_EQUAL = 1e-9
"""Relative difference of two factors of a direction that is rounding."""
_BODY, _THICKNESS, _SPRING = 0.45, 0.3, 1.1
"""Half a body over the typical motion; a plate's thickness, and the least length of a spring, over
half a body."""
_LEAST = 0.08
"""Least half of a body, over all motion."""
_BEYOND = 1.2
"""How far bodies are taken to move, over the distance of the farthest stop."""
_FAR = 8.0
"""How much farther than all motion a stop may be, over the motion, and still be drawn in place."""


@dataclass(frozen=True, slots=True)
class Single:
    """A contact of one body.

    Attributes:
        contact: its index.
        slot: the body's place in the row.
        side: +1 where the stop is on its right, -1 on its left.
        change: displacement of the body at which ``g = 0``, m.
    """

    contact: int
    slot: int
    side: int
    change: float


@dataclass(frozen=True, slots=True)
class Pair:
    """A contact between neighbours.

    Attributes:
        contact: its index.
        slot: the left body's place in the row.
        gap: displacement of left minus right at which ``g = 0``, m.
    """

    contact: int
    slot: int
    gap: float


@dataclass(frozen=True, slots=True)
class Measures:
    """Lengths of a scene, m, and what kind each contact is.

    Attributes:
        half: half the width of a body.
        thickness: of walls and plates.
        spring: least length of a spring.
        pitch: from one home to the next.
        start: left end of the picture, from the first home.
        end: right end of the picture, from the last home.
        singles: contacts that are walls.
        pairs: contacts that are bumpers.
        others: indices of all other contacts.
    """

    half: float
    thickness: float
    spring: float
    pitch: float
    start: float
    end: float
    singles: tuple[Single, ...]
    pairs: tuple[Pair, ...]
    others: tuple[int, ...]


def ordered(system: System, shown: int) -> tuple[int, ...]:
    """The coordinates from the left to the right, the first ``shown`` of them.

    They keep their order, but where a contact compares two of them the one that it stops from the
    left stands on the left; where contacts contradict each other they have no say.
    """
    before = {j: set[int]() for j in range(shown)}
    for direction in system.W.T:
        pair = _pair(direction)
        if pair is not None and max(pair) < shown:
            before[pair[1]].add(pair[0])
    row: list[int] = []
    while len(row) < shown:
        left = [i for i in range(shown) if i not in row]
        ready = (i for i in left if before[i] <= set(row))
        row.append(next(ready, left[0]))
    return tuple(row)


def measured(
    system: System, order: Sequence[int], positions: Matrix, reach: float = 0.0
) -> Measures:
    """Lengths at which nothing overlaps in the states that are known.

    Args:
        system: what is drawn.
        order: coordinates from the left.
        positions: coordinates, shape (samples, n), m; fewer than two for somewhat farther than
            the stops.
        reach: how far each body may move instead, m; 0 for as above.
    """
    singles, pairs = _contacts(system, order)
    states = positions[:, list(order)]
    if reach > 0:
        states = _imagined(reach, len(order))
    elif len(states) < 2 or not np.any(np.ptp(states, axis=0)):
        stops = [abs(each.change) for each in singles] + [abs(each.gap) for each in pairs]
        farthest = float(max([*stops, *np.abs(states).flat], default=0.0))
        states = _imagined(_BEYOND * farthest or 1.0, len(order))
    low, high = states.min(axis=0, initial=0.0), states.max(axis=0, initial=0.0)
    # Of most of the time: a transient must not make all that follows look like rest.
    typical = 2 * float(np.sqrt(np.var(states, axis=0).max()))
    far = _FAR * float(np.max(high - low))
    near = tuple(each for each in singles if abs(each.change) <= far)
    close = tuple(each for each in pairs if abs(each.gap) <= far)
    half = max(_BODY * typical, _LEAST * float(np.max(high - low)))
    thickness, spring = _THICKNESS * half, _SPRING * half
    right, left = _plates(near, len(order), thickness)
    gaps = np.max(
        [
            np.max(states[:, :-1] - states[:, 1:], axis=0, initial=0.0),
            right[:-1] - low[1:],
            high[:-1] - left[1:],
            right[:-1] - left[1:],
        ],
        axis=0,
    )
    drawn = [each.contact for each in near] + [each.contact for each in close]
    return Measures(
        half=half,
        thickness=thickness,
        spring=spring,
        pitch=2 * half + spring + max([*gaps, *(each.gap for each in close)], default=0.0),
        start=float(min(low[0], left[0])) - half - spring - thickness,
        end=float(max(high[-1], right[-1])) + half + spring + thickness,
        singles=near,
        pairs=close,
        others=tuple(i for i in range(system.m) if i not in drawn),
    )


def _imagined(reach: float, bodies: int) -> Matrix:
    """Neighbours that move apart and together by ``reach``, m."""
    return reach * np.array([[1.0], [-1.0]]) * (-1.0) ** np.arange(bodies)


def _contacts(system: System, order: Sequence[int]) -> tuple[tuple[Single, ...], tuple[Pair, ...]]:
    """Contacts of single bodies and of neighbours among those that are drawn."""
    slots = {coordinate: slot for slot, coordinate in enumerate(order)}
    singles, pairs = [], []
    for i, contact in enumerate(system.contacts):
        moved = np.flatnonzero(contact.direction).tolist()
        pair = _pair(contact.direction)
        if len(moved) == 1 and moved[0] in slots:
            factor = float(contact.direction[moved[0]])
            side = 1 if factor < 0 else -1
            singles.append(Single(i, slots[moved[0]], side, -contact.gap / factor))
        elif pair is not None and set(pair) <= set(slots):
            left, right = slots[pair[0]], slots[pair[1]]
            if right == left + 1:
                factor = float(contact.direction[pair[1]])
                pairs.append(Pair(i, left, contact.gap / factor))
    return tuple(singles), tuple(pairs)


def _pair(direction: Vector) -> tuple[int, int] | None:
    """Coordinates on the left and on the right of a stop between two; None if it is none."""
    moved = np.flatnonzero(direction).tolist()
    if len(moved) != 2 or abs(direction.sum()) > _EQUAL * np.abs(direction).max():
        return None
    left, right = sorted(moved, key=lambda i: float(direction[i]))
    return left, right


def _plates(walls: Sequence[Single], bodies: int, thickness: float) -> tuple[Vector, Vector]:
    """How far walls go on the right of each body and on the left, from where its face is at home.

    Returns:
        Right and left edges, each of shape (bodies,), m; infinitely far inward where is no wall.
    """
    right, left = np.full(bodies, -np.inf), np.full(bodies, np.inf)
    for each in walls:
        if each.side > 0:
            right[each.slot] = max(right[each.slot], each.change + thickness)
        else:
            left[each.slot] = min(left[each.slot], each.change - thickness)
    return right, left
