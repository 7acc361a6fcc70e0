# SPDX-License-Identifier: Apache-2.0
"""Predicted penetration: gaps and loads of the estimate that fall below zero.

Gaps and loads of the plant are never negative. Where those of the estimate fall below zero by
more than its deviation explains, an impact or a release was missed.
"""

import math
from collections.abc import Callable, Sequence
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from impact_observer.dynamics import Phase
from impact_observer.dynamics.flow import Motion
from impact_observer.events import Contacts, Kind
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.impact_filter import ImpactFilter
from impact_observer.filter.linear import LinearPrediction
from impact_observer.filter.moving_system import MovingSystem
from impact_observer.filter.saltation import Measured
from impact_observer.kernel._kernel import FINE, FINER, MOST_SAMPLES, TINY, dips_along, falls_at
from impact_observer.model import System
from impact_observer.states import Matrix, Vector
from impact_observer.turns import give_turn

_FIRST_SAMPLES = 8.0 ** np.arange(-FINER, 0)
"""Samples in the first interval, over its length: a flight after an impact may be short."""
_FIRST_WINDOW = 8.0
"""First window in which a first dip is sought, in the model's time scale."""
_AT_ONCE = 1000.0
"""Flights that the kernel searches without a turn, in the model's time scale."""
_EPS = float(np.finfo(np.float64).eps)
"""Distance of 1 from the next larger number."""
_GUARD_ROUNDING = 64 * _EPS
"""Rounding of a guard function, relative to the terms of its sum."""


class Dip(NamedTuple):
    """An interval in which a guard function, a gap or a load, is negative.

    Attributes:
        contact: index.
        kind: ``IMPACT`` for a gap, ``OPEN`` for a load.
        which: index of the guard function.
        above: the last sample at which it is positive, seconds after the start; 0 if none is.
        below: the first sample at which it is negative, s.
        deepest: where it is deepest, s.
        depth: there, in standard deviations.
        unlikely: logarithm of the probability that an error of the estimate is so large.
        over: whether it becomes positive again.
        began: where it becomes negative, s; the first sample where it is so from the start.
    """

    contact: int
    kind: Kind
    which: int
    above: float
    below: float
    deepest: float
    depth: float
    unlikely: float
    over: bool
    began: float

    @property
    def goes_on(self) -> bool:
        """Whether it had begun before the flight."""
        return self.began == self.below


class Flight:
    """The guard functions of a flight: gaps of open contacts, then loads of held ones.

    Attributes:
        contacts: the contact of each function.
        gaps: how many of them are gaps.
        c: the functions are ``c x`` and an offset, shape (functions, 2n).
    """

    def __init__(self, system: System, moving: MovingSystem, t: float, closed: Contacts) -> None:
        """A flight of ``system`` from ``t``, s since the epoch, with ``closed`` contacts.

        Its motions are those of ``moving``.
        """
        self._system = system
        self._t = t
        self._prepare = partial(moving.phase, closed)
        self._scales = moving.scales
        self._step = self._scales.timescale / FINE
        open_ = tuple(i for i in range(self._system.m) if i not in closed)
        self._pressed = self._phase.held if closed else ()
        self.gaps, self.contacts = len(open_), (*open_, *self._pressed)
        self.c = Measured.gaps(self._system, open_).c
        self._distance = self._system.q_r[list(open_)]
        if self._pressed:
            loads = Measured.loads(self._phase, self._pressed)
            self.c = np.vstack([self.c, loads.c])

    @cached_property
    def _phase(self) -> Phase:
        return self._prepare()

    def instants(self, duration: float) -> Vector:
        """Samples of the next ``duration`` seconds, shape (samples,)."""
        count = min(max(math.ceil(duration / self._step), 4), MOST_SAMPLES)
        s = np.linspace(0.0, duration, count + 1)
        return np.concatenate([s[:1], s[1] * _FIRST_SAMPLES, s[1:]])

    def values(self, motion: Motion, s: Vector) -> Matrix:
        """The functions along a motion, at ``s`` seconds in rising order, (samples, functions)."""
        return np.asarray(motion.states(s) @ self.c.T + self.offset(s))

    def rounding(self, j: int, s: float, x: Vector) -> float:
        """Deviation of the rounding of function ``j`` after ``s`` seconds, at the state ``x``.

        Time since the epoch is rounded too: harmonics are as wrong as they change in that.
        """
        sizes = self._scales.sizes(x) if j < self.gaps else np.abs(x)
        size = abs(self.rest(j, s)) + float(np.abs(self.c[j]).dot(sizes))
        return (_GUARD_ROUNDING + _EPS * (self._t + s) / self._scales.timescale) * size

    def is_clear(self, motion: Motion, duration: float) -> bool:
        """Whether a bound shows that no function falls below zero: none is computed."""
        del motion, duration
        return False

    def value(self, j: int, s: float, x: Vector) -> float:
        """Function ``j`` after ``s`` seconds, at the state ``x``."""
        return float(self.c[j].dot(x)) + self.rest(j, s)

    def gradient(self, j: int, s: float, state: Callable[[float], Vector]) -> Vector:
        """Derivatives of function ``j`` by the ``state`` after ``s`` seconds, shape (2n,)."""
        del s, state
        return np.asarray(self.c[j])

    def rest(self, j: int, s: float) -> float:
        """``offset`` of function ``j`` alone, ``s`` seconds after the start."""
        return float(self._distance[j] if j < self.gaps else self.offset(np.array([s]))[0, j])

    def offset(self, s: Vector) -> Matrix:
        """The functions less ``c x``, ``s`` seconds after the start, (samples, functions)."""
        offset = np.empty((s.size, len(self.c)))
        offset[:, : self.gaps] = self._distance
        if self._pressed:
            forces = self._system.forcing.derivatives(self._t + s, 0)[0]
            offset[:, self.gaps :] = -forces @ self._phase.loads.T
        return offset


def dips_of(
    filter_: ImpactFilter,
    t: Vector,
    duration: Vector,
    states: Sequence[GaussianState],
    levels: Sequence[float],
) -> list[list[Dip]] | None:
    """The dips of states without contact, each from its ``t`` on; see ``Forecast.dips``.

    None where the kernel does not find them.
    """
    longest = float(max(duration, default=0.0))
    gaps = filter_.gaps((), longest)
    if gaps is None:
        return None
    found, noise = [], np.array(levels)
    step = max(int(_AT_ONCE * filter_.scales.timescale / max(longest, TINY)), 1)
    for k in range(0, len(states), step):
        give_turn()
        some = slice(k, k + step)
        found += gaps.dips(t[some], duration[some], states[some], noise[some])
    return [[Dip(dip[0], Kind.IMPACT, *dip) for dip in some] for some in found]


class Forecast:
    """The prediction of one state until the next event, and its penetrations.

    Attributes:
        prediction: of state and covariance.
    """

    def __init__(
        self,
        flight: Callable[[], Flight],
        prediction: LinearPrediction,
        state: GaussianState,
        filter_: ImpactFilter,
        *,
        t: float,
        level: float = 0.0,
    ) -> None:
        """The ``prediction`` from ``state`` at ``t`` (s since the epoch).

        The accelerations have white noise of this ``level``, m/s^1.5. ``flight`` prepares the
        guard functions where the kernel does not.
        """
        self.prediction = prediction
        self._prepare = flight
        self._state = state
        self._filter = filter_
        self._members = filter_.members
        self._t = t
        self._level = level

    @cached_property
    def _flight(self) -> Flight:
        return self._prepare()

    def dips(self, duration: float) -> list[Dip]:
        """The dips within ``duration`` seconds, in the order in which they begin."""
        if not self._state.closed:
            flight = np.array([self._t]), np.array([duration]), [self._state], [self._level]
            if (found := dips_of(self._filter, *flight)) is not None:
                return found[0]
        if not (self._flight.contacts and duration > 0):
            return []
        if self._flight.is_clear(self.prediction.motion, duration):
            return []
        give_turn()
        s = self._flight.instants(duration)
        values = np.nan_to_num(self._flight.values(self.prediction.motion, s))  # may overflow
        along = dips_along(s, values, self._value, self._rounding, self._spread)
        contacts, gaps = self._flight.contacts, self._flight.gaps
        kinds = [Kind.IMPACT if dip[0] < gaps else Kind.OPEN for dip in along]
        return [Dip(contacts[dip[0]], kind, *dip) for dip, kind in zip(along, kinds, strict=True)]

    def _rounding(self, j: int, s: float) -> float:
        return self._flight.rounding(j, s, self._state.x)

    def _value(self, j: int, s: float) -> float:
        return self._flight.value(j, s, self.prediction.state(s))

    def deviation(self, j: int, s: float) -> float:
        """Standard deviation of function ``j`` after ``s`` seconds, rounding included."""
        return math.hypot(self._spread(j, s), self._rounding(j, s))

    def _spread(self, j: int, s: float) -> float:
        """Standard deviation of function ``j`` after ``s`` seconds, by the state's."""
        if self._state.parameters:
            row = self._row(j, s)
            spread = row.dot(self.prediction.full_root(s)[: row.size])
        else:
            spread = self._gradient(j, s).dot(self.prediction.root(s))
        return math.hypot(*spread.tolist())

    def _gradient(self, j: int, s: float) -> Vector:
        return self._flight.gradient(j, s, self.prediction.state)

    def _row(self, j: int, s: float) -> Vector:
        """Gradient of function ``j`` by state and parameters after ``s`` seconds, (2n + p,)."""
        which, member = (self._flight.contacts[j],), self._members.at(self._state.theta)
        if j < self._flight.gaps:
            sensitivity = self._members.gap_sensitivity(which)
        else:
            x, closed = self.prediction.state(s), self._state.closed
            sensitivity = self._members.load_sensitivity(member, closed, which, x, self._t + s)
        return np.append(self._gradient(j, s), sensitivity)

    def confident_from(self, dip: Dip, depth: float) -> float:
        """From when on a dip is deeper than ``depth`` standard deviations, s."""

        def beyond(at: float) -> float:
            return self._value(dip.which, at) + depth * self.deviation(dip.which, at)

        if gaps := self._filter.gaps(self._state.closed, dip.deepest):
            found = dip.which, dip.above, dip.deepest, depth
            return gaps.root(self._t, self._state, self._level, *found)
        return falls_at(beyond, dip.above, dip.deepest)
