"""What a motion runs into when nothing is heard: gaps and loads that fall below zero.

A plant's gaps and the loads of its closed contacts never do. So an estimate that falls deeper than
it can be wrong tells of an impact, or of a release, that nobody heard.
"""

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy import optimize, special

from impact_observer.estimation.gaussian_state import GaussianState
from impact_observer.estimation.linear import Linear
from impact_observer.estimation.members import Member, Members
from impact_observer.estimation.saltation import Measured
from impact_observer.events import Contacts, Kind
from impact_observer.states import Matrix, Vector

FINE = 6.0
"""Samples in the inverse of the fastest rate: 38 a period."""
_FINER = 8.0 ** np.arange(-8, 0)
"""Where the first interval is divided: just after an impact a flight may be short."""
_MOST = 4096
"""Samples that are looked at together; over a longer silence they lie farther apart."""
_KEPT = 8
"""Flights of which the samples are kept: hypotheses share them."""
_ROUNDED = 64 * float(np.finfo(np.float64).eps)
"""What is watched is rounded by, relative to the terms that it is the sum of."""
_ROOT = 4 * float(np.finfo(np.float64).eps)
_LEAST = 1e-15


class Dip(NamedTuple):
    """A stretch over which something is below zero.

    Attributes:
        contact: of which.
        kind: ``IMPACT`` for a gap, ``OPEN`` for a load.
        which: number of the function that is watched.
        above: where it was still above zero, seconds after the start; 0 if it never was.
        below: where it was below zero first, s.
        deepest: where it is deepest, s.
        depth: there, in standard deviations.
        over: whether it has come up again.
    """

    contact: int
    kind: Kind
    which: int
    above: float
    below: float
    deepest: float
    depth: float
    over: bool

    @property
    def unlikely(self) -> float:
        """Logarithm of the probability that an error of the estimate is so large."""
        return float(special.log_ndtr(-self.depth))


class _Samples(NamedTuple):
    """Functions ``rows x + constant`` of the state at the start, one for each instant.

    Attributes:
        s: instants, seconds after the start, shape (samples,).
        rows: shape (samples, watched, 2n).
        constant: shape (samples, watched).
    """

    s: Vector
    rows: Matrix
    constant: Matrix

    def values(self, x: Vector) -> Matrix:
        """Of a motion that starts at ``x``, shape (samples, watched)."""
        return np.asarray(self.rows.dot(x) + self.constant)


class Flight:
    """What must stay above zero from an instant on, while the same contacts are closed.

    It depends linearly on the state at the start, so that hypotheses of one system share it.

    Attributes:
        contacts: of which something is watched: open ones' gaps, then held ones' loads.
        gaps: how many of those are gaps.
        c: what is watched is ``c x`` and an offset, shape (watched, 2n).
    """

    def __init__(self, member: Member, t: float, closed: Contacts) -> None:
        """Look on from ``t``, s since the epoch, with ``closed`` contacts."""
        self._system = member.system
        self._t = t
        self._phase = member.moving.phase(closed)
        self._scales = member.moving.phases.scales
        self._step = self._scales.timescale / FINE
        open_ = tuple(i for i in range(self._system.m) if i not in closed)
        self.gaps, self.contacts = len(open_), (*open_, *self._phase.held)
        self.c = Measured.gaps(self._system, open_).c
        self._distance = self._system.q_r[list(open_)]
        if self._phase.held:
            loads = Measured.loads(self._phase, self._phase.held)
            self.c = np.vstack([self.c, loads.c])
        self._rest = self._phase.start(t, np.zeros(2 * self._system.n))
        self.over = lru_cache(_KEPT)(self._over)

    def _over(self, duration: float) -> _Samples:
        """Samples of the next ``duration`` seconds."""
        count = min(max(math.ceil(duration / self._step), 4), _MOST)
        s = np.linspace(0.0, duration, count + 1)
        s = np.concatenate([s[:1], s[1] * _FINER, s[1:]])
        start = np.eye(2 * self._system.n)
        forced = self._rest.states(s)
        moved = [self._phase.start(self._t, x).states(s) - forced for x in start]
        return _Samples(s, self.c @ np.stack(moved, axis=2), forced @ self.c.T + self.offset(s))

    def size(self, j: int, s: float, x: Vector) -> float:
        """What function ``j`` is rounded against after ``s`` seconds, at the state ``x``."""
        sizes = self._scales.sizes(x) if j < self.gaps else np.abs(x)
        return abs(self.rest(j, s)) + float(np.abs(self.c[j]).dot(sizes))

    def rest(self, j: int, s: float) -> float:
        """``offset`` of function ``j`` alone, ``s`` seconds after the start."""
        return float(self._distance[j] if j < self.gaps else self.offset(np.array([s]))[0, j])

    def offset(self, s: Vector) -> Matrix:
        """What is watched besides ``c x``, ``s`` seconds after the start, (samples, watched)."""
        offset = np.empty((s.size, len(self.c)))
        offset[:, : self.gaps] = self._distance
        if self._phase.held:
            forces = self._system.forcing.derivatives(self._t + s, 0)[0]
            offset[:, self.gaps :] = -forces @ self._phase.loads.T
        return offset


class Forecast:
    """What one knowledge comes to, as long as no event is heard.

    Attributes:
        course: how it goes on.
    """

    def __init__(
        self, flight: Flight, course: Linear, known: GaussianState, members: Members, t: float
    ) -> None:
        """Look along ``flight`` from ``known``, which goes on as ``course`` from ``t`` on."""
        self.course = course
        self._flight = flight
        self._known = known
        self._members = members
        self._t = t

    def dips(self, duration: float) -> list[Dip]:
        """All of them within ``duration`` seconds, in the order in which they begin."""
        if not (self._flight.contacts and duration > 0):
            return []
        samples = self._flight.over(duration)
        values = samples.values(self._known.x)
        found = [dip for j in range(values.shape[1]) for dip in self._of(j, samples, values[:, j])]
        return sorted(found, key=lambda dip: dip.below)

    def _of(self, j: int, samples: _Samples, values: Vector) -> Iterator[Dip]:
        """The dips of one function."""
        s, values = self._with_minima(j, samples.s, values)
        below = np.flatnonzero(values < 0)
        if not below.size:
            return
        for run in np.split(below, np.flatnonzero(np.diff(below) > 1) + 1):
            first, last = int(run[0]), int(run[-1])
            deepest = int(run[np.argmin(values[run])])
            at, x = float(s[deepest]), self._known.x
            if first == 0 and values[0] - values[deepest] <= _ROUNDED * self._flight.size(j, 0, x):
                continue  # it comes up: the jump at the start was a little early
            yield Dip(
                self._flight.contacts[j],
                Kind.IMPACT if j < self._flight.gaps else Kind.OPEN,
                j,
                float(s[max(first - 1, 0)]),
                float(s[first]),
                at,
                -float(values[deepest]) / self._deviation(j, at),
                last < len(values) - 1,
            )

    def _with_minima(self, j: int, s: Vector, values: Vector) -> tuple[Vector, Vector]:
        """Samples, and the minima between them that are, or may be, below zero."""
        h, change = np.diff(s), np.diff(values)
        slope = change / h
        bend = np.maximum((slope[1:] - slope[:-1]) / (h[1:] + h[:-1]), _LEAST)
        slope = slope[:-1] + bend * h[:-1]  # of a parabola through three samples, at the middle
        mid = values[1:-1]
        lowest = (change[:-1] <= 0) & (change[1:] >= 0)
        lowest &= mid - slope**2 / (4 * bend) <= mid / 2
        if not lowest.any():
            return s, values
        at = s[1:-1][lowest] - (slope / (2 * bend))[lowest]
        where = np.searchsorted(s, at)
        return np.insert(s, where, at), np.insert(values, where, self._values(j, at))

    def _values(self, j: int, s: Vector) -> Vector:
        """Function ``j`` after ``s`` seconds, shape (samples,)."""
        x = self.course.motion.states(s)
        return np.asarray(x @ self._flight.c[j] + self._flight.offset(s)[:, j])

    def _value(self, j: int, s: float) -> float:
        x = self.course.state(s)
        return float(self._flight.c[j].dot(x)) + self._flight.rest(j, s)

    def _deviation(self, j: int, s: float) -> float:
        """Standard deviation of function ``j`` after ``s`` seconds, rounding included."""
        if self._known.parameters:
            row = self._row(j, s)
            spread = row.dot(self.course.whole(s)[: row.size])
        else:
            spread = self._flight.c[j].dot(self.course.root(s))
        rounded = _ROUNDED * self._flight.size(j, s, self.course.state(s))
        return math.hypot(*spread.tolist(), rounded)

    def _row(self, j: int, s: float) -> Vector:
        """How function ``j`` changes with state and parameters after ``s`` seconds, (2n + p,)."""
        which, member = (self._flight.contacts[j],), self._members.at(self._known.theta)
        if j < self._flight.gaps:
            turn = self._members.gap_rows(which)
        else:
            x, closed = self.course.state(s), self._known.closed
            turn = self._members.load_rows(member, closed, which, x, self._t + s)
        return np.append(self._flight.c[j], turn)

    def root(self, dip: Dip) -> float:
        """Where what dips falls through zero, s."""
        above, below = dip.above, dip.below
        if below == 0 or not self._value(dip.which, above) > 0 > self._value(dip.which, below):
            return below  # it was below at the start, or is rounded otherwise when alone
        found = optimize.brentq(
            lambda at: self._value(dip.which, at), above, below, xtol=_LEAST, rtol=_ROOT
        )
        return float(found)

    def sure(self, dip: Dip, enough: float) -> float:
        """From when on a dip is deeper than ``enough`` deviations, s."""

        def beyond(at: float) -> float:
            return self._value(dip.which, at) + enough * self._deviation(dip.which, at)

        if not beyond(dip.above) > 0 > beyond(dip.deepest):
            return dip.deepest
        return float(optimize.brentq(beyond, dip.above, dip.deepest, xtol=_LEAST, rtol=_ROOT))
