# SPDX-License-Identifier: Apache-2.0
"""Before or after an impact: near an instant that is uncertain a velocity has two values.

The published state is on one side of the impact. The covariance is that of both: the difference
of the two velocities is an error with the probability that the plant is on the other side.
"""

import math

import numpy as np
from scipy import special

from impact_observer.dynamics import Mechanism
from impact_observer.events import Contacts
from impact_observer.model import System
from impact_observer.observer.belief import Belief
from impact_observer.observer.laws.law import Law
from impact_observer.states import Matrix, Vector

REACH = 5.0
"""Deviations of an instant beyond which the side is certain."""
EXACT = 2e-9
"""Deviation of a stamp, s, below which only rounding is uncertain: an event tells the side."""
_TINY = 1e-150
"""Standard deviation instead of zero."""


class ImpactSides:
    """The errors of states that may be on the other side of an impact."""

    def __init__(self, law: Law, mechanism: Mechanism) -> None:
        """Of the estimates of a ``law`` with a covariance, by the ``mechanism`` of its system."""
        self._mechanism, self._missed = mechanism, law.uncertainty.missed

    def errors(
        self, event: Belief, t: float, x: Vector, root: Matrix, s: float, *, closed: Contacts
    ) -> list[Vector]:
        """Errors of ``x``, shape (2n,) each, at ``t``, ``s`` seconds after the belief of an event.

        ``root`` is one of the covariance of ``x`` on its side; contacts are ``closed``.
        """
        system, n = self._mechanism.near(x, np.zeros(0)), self._mechanism.system.n
        found = list[Vector]()
        clock = event.clock_deviation if event.clock_deviation > EXACT else 0.0
        gaps, speeds = system.gap(x[:n]).tolist(), system.contact_speed(x[n:]).tolist()
        for i, (gap, speed) in enumerate(zip(gaps, speeds, strict=True)):
            if speed >= 0 or i in closed:
                continue
            deviation = _gap_deviation(system, i, root)
            if gap < REACH * (deviation - speed * clock):
                share = self._hit_before(-gap / speed, -deviation / speed, clock)
                lost = speed + float(system.rebounds[i].rebound(np.array(speed)))
                kick = -lost * self._mechanism.stops(x, (i,))[:, 0]
                error = side_error(share, kick)
                found.append(self._flown(t, x, error, max(gap / speed, 0.0), closed))
        onset = event.onset
        if onset is None or not clock or s > REACH * clock:
            return found
        i, hit = onset.hit[0], list(onset.hit)
        away, ago = s / clock, 0.0
        if i in closed:
            ago = -clock  # a motion that is stopped does not tell when
        elif speeds[i] > 0:
            away = gaps[i] / max(_gap_deviation(system, i, root), _TINY)
            ago = min(gaps[i] / speeds[i], 0.0)
        jump = system.W[:, hit].T.dot(onset.x[n:] - event.x[n:])
        kick = self._mechanism.stops(x, onset.hit).dot(jump)
        error = side_error(float(special.ndtr(-away)), kick)
        free = tuple(j for j in closed if j not in hit)
        return [*found, self._flown(t, x, error, ago, free)]

    def _flown(self, t: float, x: Vector, error: Vector, s: float, closed: Contacts) -> Vector:
        """An ``error`` of ``x``, at ``t``, after ``s`` seconds of either sign."""
        if not s:
            return error
        flown = self._mechanism.flown([t], x[None], np.array([s]), closed)
        return np.asarray(flown.Phi[0].dot(error))

    def _hit_before(self, later: float, deviation: float, clock: float) -> float:
        """The probability that an impact has been and was not reported yet.

        Its instant is ``later`` than now with this ``deviation``, s, its stamp than that with the
        deviation ``clock``. The stamp, too, is later than now, or never comes.
        """
        deviation = max(deviation, _TINY)
        stamped = -later / math.hypot(deviation, clock)
        been, seen = special.ndtr([-later / deviation, stamped]).tolist()
        # Of two normal numbers whose correlation is the ratio of their deviations (Owen, 1956).
        waits = (been - seen) / 2 + float(special.owens_t(stamped, clock / deviation))
        waits = (1 - self._missed) * max(waits, 0.0) + self._missed * been
        return float(waits / max(waits + 1 - been, _TINY))


def _gap_deviation(near: System, contact: int, root: Matrix) -> float:
    """The standard deviation of a gap, m, by a ``root`` of the covariance, shape (2n, any)."""
    seen = near.W[:, contact].dot(root[: near.n])
    return math.sqrt(seen.dot(seen))


def side_error(share: float, kick: Vector) -> Vector:
    """An error of (q, u) by a ``kick`` of the velocities that has the probability ``share``."""
    return np.concatenate([np.zeros_like(kick), math.sqrt(share) * kick])
