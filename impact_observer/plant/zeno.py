# SPDX-License-Identifier: Apache-2.0
"""Zeno behaviour: where impacts accumulate the contact is closed before their accumulation point.

``docs/theory/method.md`` says when, and how large the error is until that point.
"""

import math
from collections import deque
from itertools import pairwise

import numpy as np

from impact_observer.dynamics import DEPTH, Phases
from impact_observer.dynamics.contact.complementarity import nonnegative
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
_TINY = np.finfo(np.float64).tiny


class ZenoCutoff:
    """Decides which contacts of one system rest on their stops after an impact.

    Attributes:
        shortest: longest flight that counts as zero, s.
    """

    def __init__(self, phases: Phases) -> None:
        """Prepare the scales for the comparison of flights."""
        self._phases = phases
        self._length = phases.length
        self.shortest = SHORT * phases.scales.timescale
        self._mode_sizes = np.abs(phases.system.W.T @ phases.scales.shapes)

    def resting(
        self, t: float, x: Vector, contacts: tuple[int, ...], before: Vector
    ) -> tuple[int, ...]:
        """The contacts that rest on their stops after an impact, as indices.

        Args:
            t: s since the epoch.
            x: state (q, u+), shape (2n,).
            contacts: indices of the contacts that took part.
            before: velocities u-, shape (n,), the scale of rounding of contact speeds.
        """
        system = self._phases.system
        q, u = x[: system.n], x[system.n :]
        gamma = system.contact_speed(u).tolist()
        rounding = self._phases.speed_tolerance(before).tolist()
        # Gaps are rounded against the sum of all modes' magnitudes.
        moved = self._mode_sizes @ self._phases.scales.reach(q, u)
        lowest = (LOW * (np.abs(system.q_r) + moved + _TINY)).tolist()
        free = self._free(t, x)
        size = math.sqrt(free.dot(free))

        def flight(i: int, fall: float) -> float:
            return 0.0 if gamma[i] <= rounding[i] else self._flight(gamma[i], fall, lowest[i])

        # A contact that still closes hits again at once: Newton's law allows it after separating.
        # No contact comes back faster than with the whole acceleration, which mostly decides.
        resting = [
            i
            for i in contacts
            if gamma[i] >= -rounding[i] and flight(i, float(self._length[i]) * size) <= 1.0
        ]
        while resting:
            flights = list(map(flight, resting, self._fall(free, resting).tolist()))
            if max(flights) <= 1.0:
                break
            # Remove one at a time: without its load the others may rest or separate.
            resting.pop(flights.index(max(flights)))
        # A contact that depends on the others rests with them, even without load.
        if not resting:
            return ()
        independent = self._phases.independent
        return tuple(i for i in contacts if i in resting or not independent((i,), tuple(resting)))

    def is_pressed(self, t: float, x: Vector, contacts: tuple[int, ...]) -> bool:
        """Whether accelerations change contact speeds within the shortest flight.

        ``x`` is the state (q, u), shape (2n,), at ``t``, s since the epoch.
        """
        change = np.abs(self._free(t, x) @ self._phases.B[:, list(contacts)]) * self.shortest
        rounding = self._phases.speed_tolerance(x[self._phases.system.n :])[list(contacts)]
        return bool(np.any(change > rounding))

    def _free(self, t: float, x: Vector) -> Vector:
        """The acceleration without loads, as ``Phases.white`` gives it, shape (n,).

        ``x`` is the state (q, u), shape (2n,), at ``t``, s since the epoch.
        """
        system, law = self._phases.system, self._phases.unloaded()
        q, u = x[: system.n], x[system.n :]
        return self._phases.white(system.forcing(t) - law.damped(u) - law.sprung(q))

    def _flight(self, speed: float, fall: float, lowest: float) -> float:
        """Next flight, relative to the longest that counts as none.

        It begins with ``speed``, m/s, and ``fall`` is the acceleration back, m/s2, zero for a
        contact that does not return. The height ``lowest`` counts as none, m.
        """
        if fall <= 0:
            return math.inf
        return min(2 * speed / fall / self.shortest, speed * speed / (2 * fall) / lowest)

    def _fall(self, free: Vector, contacts: list[int]) -> Vector:
        """Acceleration with which each contact would come back if the others were held, m/s2.

        Zero where a contact is not pressed on its stop. ``free`` is the acceleration without
        loads, as ``Phases.white`` gives it, shape (n,).
        """
        along = self._phases.B[:, contacts]
        if len(contacts) == 1:
            return np.asarray(np.maximum(-free.dot(along), 0.0))
        size = math.sqrt(free.dot(free)) or 1.0
        length = self._length[contacts]
        directions = along / length
        fall = np.zeros(len(contacts))
        loads = nonnegative(directions, -free / size)
        if loads is None:  # directions are almost equal
            return fall
        pushed = size * loads
        pressed = np.flatnonzero(pushed > 0)  # independent of each other
        if pressed.size:
            inverse = np.linalg.inv(directions[:, pressed].T @ directions[:, pressed])
            fall[pressed] = pushed[pressed] / np.diag(inverse) * length[pressed]
        return fall


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
        Contacts that are pressed settle by ``ZenoCutoff`` instead.
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
