# SPDX-License-Identifier: Apache-2.0
"""The motion of a robot while its closed contacts stay, and the first crossing of a guard.

The integrator is DOP853 of Hairer, Norsett and Wanner. Its dense output makes a guard within one
step a smooth function, which is replaced by a polynomial in Chebyshev points: the roots of the
polynomial are all roots of the guard in that step, two close ones included.
"""

import math
from bisect import bisect_left
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import scipy
from numpy.polynomial import chebyshev

from impact_observer.dynamics.mechanism import Grip, GuardedMotion, PhaseEnd
from impact_observer.errors import DynamicsError
from impact_observer.robots.robot import Robot
from impact_observer.states import Matrix, Vector

RTOL, ATOL = 1e-12, 1e-13
"""Tolerances of the integrator: relative, and absolute in rad, m, rad/s or m/s."""
_DEGREE = 15
"""Degree of the polynomials of guards."""
_NODES = np.cos(np.pi * (np.arange(_DEGREE + 1) + 0.5) / (_DEGREE + 1))[::-1]
_FIT = np.linalg.inv(chebyshev.chebvander(_NODES, _DEGREE))
_REAL = 1e-7
"""Imaginary part of a root that is rounding: a double root has one of the root of 1e-16."""
_MOST_SEGMENTS = 10_000
"""Steps of one phase that are kept after states behind them have been asked for."""

_LOAD = 1e-11
"""Load below zero that is rounding, relative to the largest of the phase's start."""
_DEEP = 4e-13
"""Gap below zero that is rounding, relative to the scale of the gap."""
_TOGETHER = 1e-12
"""Gap that closes together with another one, relative to the same scale."""

Solver: TypeAlias = Any
"""An integrator of scipy."""


class _Segment(NamedTuple):
    """A step of the integrator: its begin and end, s since the start, and its dense output."""

    begin: float
    end: float
    dense: Any


class RobotFlight(GuardedMotion):
    """The motion of one phase, computed step by step as far as it is asked for."""

    def __init__(self, robot: Robot, t: float, x: Vector, grip: Grip) -> None:
        """Start from the state ``x``, shape (2n,), at ``t``, s since the epoch."""
        self.t, self._robot, self._x, self._closed = float(t), robot, x, grip.closed
        self._opened = tuple(i for i in range(robot.m) if i not in grip.closed)
        self._segments: list[_Segment] = []
        self._ends: list[float] = []
        self._forcing = robot.forcing
        self._constant = None if self._forcing.depends_on_time else robot.torques(0.0)
        self._searched = 0
        self._solver = self._solver_from(0.0, x)
        deep = _DEEP * robot.reach[list(self._opened)]
        loads = robot.loads(x[: robot.n], x[robot.n :], self._torques(0.0), grip.closed)
        light = _LOAD * float(np.max(np.abs(loads), initial=0.0))
        self._tolerance = np.concatenate([deep, np.full(loads.size, light)])

    def _torques(self, s: float) -> Vector:
        """Torques of the drives, shape (n,), ``s`` seconds after the start."""
        if self._constant is not None:
            return self._constant
        return self._robot.torques(min(self.t + s, self._last_time))

    def end(self, horizon: float, /) -> PhaseEnd | None:
        """The first root of a guard; steps that were searched are not searched again."""
        while True:
            while self._searched < len(self._segments):
                segment = self._segments[self._searched]
                if segment.begin > horizon:
                    return None
                if (found := self._crossing(segment)) is not None:
                    return None if found[0] > horizon else self._end_at(*found)
                self._searched += 1
            if self._reached > horizon:
                return None
            self._step()

    def _end_at(self, s: float, guard: int) -> PhaseEnd:
        """The end by a ``guard``, with the gaps that close at the same instant."""
        opened = len(self._opened)
        if guard >= opened:
            return PhaseEnd(s, frozenset(), frozenset({self._closed[guard - opened]}))
        robot, x = self._robot, self.state(s)
        near = robot.gaps(x[: robot.n]) <= _TOGETHER * robot.reach
        closing = near & (robot.contact_speeds(x) < 0)
        gaps = {i for i in self._opened if closing[i]}
        return PhaseEnd(s, frozenset({self._opened[guard], *gaps}), frozenset())

    def states(self, s: Vector, /) -> Matrix:
        """States (q, u) at times >= 0 since the start, shape (k, 2n).

        Many steps before the first of them are forgotten.
        """
        found = np.empty((s.size, self._x.size))
        if not s.size:
            return found
        while self._reached < float(s.max()):
            self._step()
        index = np.searchsorted(self._ends, s)
        for k in np.unique(index):
            at = index == k
            found[at] = self._segments[k].dense(s[at]).T
        found[s <= 0] = self._x
        self._forget_before(float(s.min()))
        return found

    def state(self, s: float, /) -> Vector:
        """The state (q, u) at one time, shape (2n,)."""
        if s <= 0:
            return self._x
        while self._reached < s:
            self._step()
        return np.asarray(self._segments[bisect_left(self._ends, s)].dense(s))

    def _forget_before(self, s: float) -> None:
        """Drop old steps where there are many: states before ``s`` are not asked for again."""
        gone = min(bisect_left(self._ends, s), self._searched) - 1
        if gone > _MOST_SEGMENTS:
            del self._segments[:gone], self._ends[:gone]
            self._searched -= gone

    @property
    def _reached(self) -> float:
        return self._ends[-1] if self._ends else 0.0

    def _rates(self, s: float, x: Vector) -> Vector:
        return self._robot.rates(x, self._torques(s), self._closed)

    def _solver_from(self, s: float, x: Vector) -> Solver:
        """An integrator up to the next instant at which the torques are not smooth."""
        t = self.t
        knots = self._forcing.knots(t + s, math.inf) if self._forcing.sampled else np.zeros(0)
        self._last_time = float(np.nextafter(knots[0], -math.inf)) if knots.size else math.inf
        bound = float(knots[0]) - t if knots.size else math.inf
        return scipy.integrate.DOP853(self._rates, s, x, bound, rtol=RTOL, atol=ATOL)

    def _step(self) -> None:
        solver = self._solver
        if solver.status == "finished":
            self._solver = solver = self._solver_from(solver.t, solver.y)
        problem = solver.step()
        if solver.status == "failed" or not np.all(np.isfinite(solver.y)):
            t = self.t + solver.t
            raise DynamicsError(
                f"{self._robot.name}: the motion cannot be computed at t = {t:.9g} s:"
                f" {problem or 'it is not finite'}"
            )
        self._segments.append(_Segment(solver.t_old, solver.t, solver.dense_output()))
        self._ends.append(solver.t)
        if self._closed:  # the integrator drifts from the planes
            solver.y = held_state(self._robot, solver.y, self._closed)
            solver.f = self._rates(solver.t, solver.y)

    def _guards(self, x: Matrix, times: Vector) -> Matrix:
        """Gaps of open contacts and loads of closed ones, shape (guards, k).

        ``x`` are states, shape (2n, k), ``times`` s since the start, shape (k,).
        """
        robot, n = self._robot, self._robot.n
        values = np.empty((self._tolerance.size, times.size))
        for k, (each, s) in enumerate(zip(x.T, times.tolist(), strict=True)):
            gaps = robot.gaps(each[:n], self._opened)
            values[: gaps.size, k] = gaps
            if self._closed:
                tau = self._torques(s)
                values[gaps.size :, k] = robot.loads(each[:n], each[n:], tau, self._closed)
        return values

    def _crossing(self, segment: _Segment) -> tuple[float, int] | None:
        """The first root of a guard in one step, and which guard."""
        middle, half = (segment.begin + segment.end) / 2, (segment.end - segment.begin) / 2
        times = middle + half * _NODES
        values = self._guards(segment.dense(times), times)
        first: tuple[float, int] | None = None
        for k, coefficients in enumerate(values @ _FIT.T):
            z = _first_fall(coefficients, float(self._tolerance[k]))
            if z is None:
                continue
            s = middle + half * z
            slope = float(chebyshev.chebval(z, chebyshev.chebder(coefficients))) / half
            for _ in range(2 if z > -1.0 and slope < 0 else 0):  # from the polynomial to the guard
                at = np.array([s])
                s -= float(self._guards(segment.dense(at), at)[k, 0]) / slope
                s = min(max(s, segment.begin), segment.end)
            if first is None or s < first[0]:
                first = float(s), k
        return first


def held_state(robot: Robot, x: Vector, closed: Sequence[int]) -> Vector:
    """The nearest state in the metric of ``M`` with ``g = 0`` and ``gamma = 0``, shape (2n,)."""
    q = robot.projected(x[: robot.n], closed)
    return np.concatenate([q, robot.stopped(q, x[robot.n :], closed)])


def _first_fall(coefficients: Vector, tolerance: float) -> float | None:
    """Where in [-1, 1] a polynomial first becomes negative, by more than the ``tolerance``.

    The polynomial has Chebyshev ``coefficients``. Dips that are less deep do not count. Where the
    polynomial is negative from the begin on the place is -1.
    """
    if coefficients[0] > np.sum(np.abs(coefficients[1:])):
        return None
    size = float(np.max(np.abs(coefficients)))
    used = np.flatnonzero(np.abs(coefficients) > 1e-17 * size)
    if not used.size:
        return None
    roots = chebyshev.chebroots(coefficients[: used[-1] + 1])
    real = np.sort(roots.real[np.abs(roots.imag) <= _REAL])
    ends = np.concatenate([[-1.0], real[(real > -1.0) & (real < 1.0)], [1.0]])
    for begin, end in pairwise(ends.tolist()):
        inside = chebyshev.chebval(begin + (end - begin) * _INNER, coefficients)
        falls_on = end == 1.0 and inside[-1] < min(inside[-2], 0.0)
        if falls_on or np.min(inside) < -tolerance:
            return float(begin)
    return None


_INNER = np.append((1.0 - np.cos(np.pi * np.arange(1, 16) / 16)) / 2, 1.0)
"""Places in an interval at which the depth of a dip is looked up; the last is its end."""
