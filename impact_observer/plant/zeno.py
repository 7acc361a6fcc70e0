# SPDX-License-Identifier: Apache-2.0
"""Rest after an accumulation of impacts: a contact is closed just before the impacts accumulate.

``docs/theory/method.md`` says when, and how large the error is until that point.
"""

import math
from collections import deque
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from impact_observer.dynamics import DEPTH
from impact_observer.dynamics.contact.complementarity import complementary
from impact_observer.dynamics.mechanism import Pressing
from impact_observer.dynamics.phase import independent
from impact_observer.events import Contacts
from impact_observer.stamps import Instant
from impact_observer.states import Vector

SHORT = 1e-8
"""Longest flight that counts as zero, relative to the model's time scale."""
LOW = 4 * DEPTH
"""Largest height of a flight that counts as zero, relative to the terms of the gap."""
OFTEN = 32
"""Impacts of one contact within ``SHORT`` that count as accumulation."""
NEGLIGIBLE = 1e-14
"""Kinetic energy that a plastic impact may remove, relative to the largest of the run."""
SHRINKS = 0.5
"""Largest ratio of two intervals between impacts, in bodies that collapse without a load."""
COLLAPSED = 1e-8
"""The same energy, where impacts of several contacts have run into one."""
_COMPARED = 5
"""Impacts of a contact whose intervals are compared."""


def resting(
    here: Pressing, gamma: Vector, still: Vector, contacts: Contacts, shortest: float
) -> Contacts:
    """The contacts that rest on their stops after an impact, as indices.

    Args:
        here: how contacts are pressed after the impact.
        gamma: contact speeds after the impact, shape (m,), m/s.
        still: contact speeds that are rounding, by the velocities before, shape (m,), m/s.
        contacts: that took part.
        shortest: longest flight that counts as zero, s.
    """

    def flight(i: int, fall: float) -> float:
        """Next flight, relative to the longest that counts as none.

        ``fall`` is the acceleration back, m/s2, zero for a contact that does not return.
        """
        speed, lowest = float(gamma[i]), LOW * float(here.reach[i])
        if speed <= still[i]:
            return 0.0
        if fall <= 0:
            return math.inf
        return min(2 * speed / fall / shortest, speed * speed / (2 * fall) / lowest)

    # A contact that still closes hits again at once: Newton's law allows it after separating.
    # No contact comes back faster than with the whole acceleration, which mostly decides.
    size = math.sqrt(here.free.dot(here.free))
    most = [float(here.length[i]) * size + abs(float(here.bias[i])) for i in contacts]
    left = [
        i
        for i, fall in zip(contacts, most, strict=True)
        if gamma[i] >= -still[i] and flight(i, fall) <= 1.0
    ]
    while left:
        flights = list(map(flight, left, _falls(here, left)))
        if max(flights) <= 1.0:
            break
        # Remove one at a time: without its load the others may rest or separate.
        left.pop(flights.index(max(flights)))
    # A contact that depends on the others rests with them, even without load.
    if not left or len(left) == len(contacts):
        return tuple(left)
    return tuple(
        i for i in contacts if i in left or not independent(here.B, here.length, (i,), tuple(left))
    )


def is_pressed(here: Pressing, still: Vector, contacts: Contacts, shortest: float) -> bool:
    """Whether accelerations change speeds of ``contacts`` within the shortest flight."""
    change = np.abs(here.rising(contacts)) * shortest
    return bool(np.any(change > still[list(contacts)]))


def _falls(here: Pressing, contacts: Sequence[int]) -> list[float]:
    """Acceleration with which each contact would come back if the others were held, m/s2.

    Zero where a contact is not pressed on its stop.
    """
    rising, B = here.rising(contacts), here.B[:, list(contacts)]
    if len(contacts) == 1:
        return [max(-float(rising[0]), 0.0)]
    falls, loads = np.zeros(len(contacts)), complementary(B, rising)
    if loads is not None and (pressed := np.flatnonzero(loads > 0)).size:
        inverse = np.linalg.pinv(B[:, pressed].T @ B[:, pressed], hermitian=True)
        falls[pressed] = loads[pressed] / np.diag(inverse)
    return [float(each) for each in falls]


class AccumulationDetector:
    """Detects contacts that are hit again and again within the shortest flight."""

    def __init__(self, shortest: float) -> None:
        """Count within ``shortest`` seconds."""
        self._shortest = shortest
        self._largest = 0.0
        self._hits: dict[int, deque[Instant]] = {}

    def record(self, instant: Instant, contacts: tuple[int, ...], energy: float) -> None:
        """Record that ``contacts`` are hit at ``instant`` with the kinetic ``energy``, J."""
        self._largest = max(self._largest, energy)
        for i in contacts:
            self._hits.setdefault(i, deque(maxlen=OFTEN + 1)).append(instant)

    def accumulating(self, instant: Instant) -> tuple[int, ...]:
        """All contacts hit within the shortest flight up to ``instant``.

        None unless one of them was hit more than ``OFTEN`` times in it.
        """
        recent = {i: hits for i, hits in self._hits.items() if self._since(hits[-1], instant)}
        if any(len(h) > OFTEN and self._since(h[0], instant) for h in recent.values()):
            return tuple(sorted(recent))
        return ()

    def collapses(self, contacts: tuple[int, ...]) -> bool:
        """Whether ``contacts`` that are hit together were hit at shrinking intervals before.

        Free bodies between others may collapse without a load: their contacts are hit in turns, at
        intervals that shrink by a constant ratio, until rounding lets them be hit together.
        Contacts that are pressed rest by ``resting`` instead.
        """
        return len(contacts) > 1 and all(_shrink(self._hits[i]) for i in contacts)

    def negligible(self, lost: float, share: float) -> bool:
        """Whether an impact that loses the energy ``lost``, J, may end an accumulation.

        Bodies can also hit each other often without losing energy, such as a light one that a
        heavy one drives towards a wall. So only a small ``share`` of the energy may be removed.
        """
        return lost <= share * self._largest

    def _since(self, earlier: Instant, now: Instant) -> bool:
        return now.until(earlier.stamp) + earlier.remainder >= -self._shortest


def _shrink(hits: deque[Instant]) -> bool:
    """Whether the last intervals between hits became shorter and shorter."""
    last = [*hits][-_COMPARED:]
    gaps = [one.until(other.stamp) + other.remainder for one, other in pairwise(last)]
    return len(last) == _COMPARED and all(b <= SHRINKS * a for a, b in pairwise(gaps))
