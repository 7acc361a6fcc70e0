# SPDX-License-Identifier: Apache-2.0
"""The distances between the bodies of a scene: nothing overlaps, and motion is visible."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from impact_observer.model import System
from impact_observer.states import Matrix, Vector

_EQUAL = 1e-9
"""Largest relative difference of two equal factors of a direction, by rounding."""
_BODY, _THICKNESS, _SPRING = 0.45, 0.3, 1.1
"""Half a body's width over the typical motion; thickness of a plate and least length of a spring,
both over half a body's width."""
_LEAST = 0.08
"""Least half width of a body, over the range of all motion."""
_BEYOND = 1.2
"""Assumed motion of bodies, over the distance of the farthest stop."""
_FAR = 8.0
"""Largest distance of a stop that is drawn at its place, over the range of all motion."""


class Wall(NamedTuple):
    """A stop that one body hits.

    Attributes:
        contact: index of the contact.
        slot: the body's place in the row.
        side: +1 for a stop on the right of the body, -1 on the left.
        travel: displacement of the body at which ``g = 0``, m.
    """

    contact: int
    slot: int
    side: int
    travel: float


class Bumper(NamedTuple):
    """A stop between two neighbours: a rod on the left one's right face.

    Attributes:
        contact: index of the contact.
        slot: the left body's place in the row.
        travel: displacement of left minus right at which ``g = 0``, m.
    """

    contact: int
    slot: int
    travel: float


class Arrangement(NamedTuple):
    """Lengths of a scene, m, and how each contact is drawn.

    Attributes:
        half: half the width of a body.
        thickness: of walls and plates.
        spring: least length of a spring.
        pitch: from one home to the next.
        start: left end of the picture, from the first home.
        end: right end of the picture, from the last home.
        walls: stops of single bodies.
        bumpers: stops between neighbours.
        others: indices of all other contacts.
    """

    half: float
    thickness: float
    spring: float
    pitch: float
    start: float
    end: float
    walls: tuple[Wall, ...]
    bumpers: tuple[Bumper, ...]
    others: tuple[int, ...]


def body_order(system: System, shown: int) -> tuple[int, ...]:
    """The coordinates from the left to the right, the first ``shown`` of them.

    The order is the model's, but of two bodies that a contact keeps apart the left one stands on
    the left. Contacts that contradict each other are ignored.
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


def arranged(
    system: System, order: Sequence[int], positions: Matrix, amplitude: float = 0.0
) -> Arrangement:
    """Lengths at which no bodies or walls overlap in the given states.

    Args:
        system: whose bodies and contacts are arranged.
        order: coordinates from the left.
        positions: coordinates, shape (samples, n), m; with fewer than two different samples,
            bodies are assumed to move somewhat farther than the stops.
        amplitude: largest displacement of each body instead, m; 0 to use ``positions``.
    """
    walls, bumpers = _contacts(system, order)
    states = positions[:, list(order)]
    if amplitude > 0:
        states = _opposed(amplitude, len(order))
    elif len(states) < 2 or not np.any(np.ptp(states, axis=0)):
        stops = [*(each.travel for each in walls), *(each.travel for each in bumpers)]
        farthest = float(max(map(abs, [*stops, *states.flat]), default=0.0))
        states = _opposed(_BEYOND * farthest or 1.0, len(order))
    low, high = states.min(axis=0, initial=0.0), states.max(axis=0, initial=0.0)
    # The rms amplitude: after a large transient, small motion is still visible.
    typical = 2 * float(np.sqrt(np.var(states, axis=0).max()))
    far = _FAR * float(np.max(high - low))
    walls = tuple(each for each in walls if abs(each.travel) <= far)
    bumpers = tuple(each for each in bumpers if abs(each.travel) <= far)
    half = max(_BODY * typical, _LEAST * float(np.max(high - low)))
    thickness, spring = _THICKNESS * half, _SPRING * half
    right, left = _plates(walls, len(order), thickness)
    gaps = np.max(
        [
            np.max(states[:, :-1] - states[:, 1:], axis=0, initial=0.0),
            right[:-1] - low[1:],
            high[:-1] - left[1:],
            right[:-1] - left[1:],
        ],
        axis=0,
    )
    drawn = {*(each.contact for each in walls), *(each.contact for each in bumpers)}
    return Arrangement(
        half=half,
        thickness=thickness,
        spring=spring,
        pitch=2 * half + spring + max([*gaps, *(each.travel for each in bumpers)], default=0.0),
        start=float(min(low[0], left[0])) - half - spring - thickness,
        end=float(max(high[-1], right[-1])) + half + spring + thickness,
        walls=walls,
        bumpers=bumpers,
        others=tuple(i for i in range(system.m) if i not in drawn),
    )


def _opposed(amplitude: float, bodies: int) -> Matrix:
    """Two states in which neighbours are displaced by ``amplitude`` in opposite directions, m."""
    return amplitude * np.array([[1.0], [-1.0]]) * (-1.0) ** np.arange(bodies)


def _contacts(system: System, order: Sequence[int]) -> tuple[tuple[Wall, ...], tuple[Bumper, ...]]:
    """Contacts of single bodies and of neighbours among the bodies that are drawn."""
    slots = {coordinate: slot for slot, coordinate in enumerate(order)}
    walls, bumpers = [], []
    for i, contact in enumerate(system.contacts):
        moved = np.flatnonzero(contact.direction).tolist()
        pair = _pair(contact.direction)
        if len(moved) == 1 and moved[0] in slots:
            factor = float(contact.direction[moved[0]])
            side = 1 if factor < 0 else -1
            walls.append(Wall(i, slots[moved[0]], side, -contact.gap / factor))
        elif pair is not None and set(pair) <= set(slots):
            left, right = slots[pair[0]], slots[pair[1]]
            if right == left + 1:
                factor = float(contact.direction[pair[1]])
                bumpers.append(Bumper(i, left, contact.gap / factor))
    return tuple(walls), tuple(bumpers)


def _pair(direction: Vector) -> tuple[int, int] | None:
    """The left and the right coordinate of a stop between two; None for another contact."""
    moved = np.flatnonzero(direction).tolist()
    if len(moved) != 2 or abs(direction.sum()) > _EQUAL * np.abs(direction).max():
        return None
    left, right = sorted(moved, key=lambda i: float(direction[i]))
    return left, right


def _plates(walls: Sequence[Wall], bodies: int, thickness: float) -> tuple[Vector, Vector]:
    """Outer edges of the walls beside each body, from the body's face at ``q = 0``.

    Returns:
        Right and left edges, each of shape (bodies,), m; without a wall -inf and inf.
    """
    right, left = np.full(bodies, -np.inf), np.full(bodies, np.inf)
    for each in walls:
        if each.side > 0:
            right[each.slot] = max(right[each.slot], each.travel + thickness)
        else:
            left[each.slot] = min(left[each.slot], each.travel - thickness)
    return right, left
