# SPDX-License-Identifier: Apache-2.0
"""The motion of a robot through one state by steps, with derivatives and noise.

Steps are those of Runge and Kutta, of equal length but for the last one, and are made when they
are needed. So the cost of many instants is that of the longest, and a state does not depend on
what was asked for before.
"""

import math
from functools import cached_property
from typing import NamedTuple

import numpy as np

from impact_observer.dynamics import Motion
from impact_observer.events import Contacts
from impact_observer.model.live_signals import LiveSamples
from impact_observer.robots.robot import Robot
from impact_observer.robots.robot_parameters import torques_by_parameters
from impact_observer.square_roots import triangular
from impact_observer.states import Matrix, Vector

_SAME_STEP = 1e-9
"""Part of a step that is rounding."""
_SAME_INSTANT = 1e-9
"""Time between two instants that count as one, s: that of a stamp."""


class Way(NamedTuple):
    """How a robot moves, and what is asked of it.

    Attributes:
        robot: the robot.
        names: parameters by which derivatives are taken.
        is_moved: whether the motion between impacts depends on one of them.
        closed: contacts that stay closed.
        step: of Runge and Kutta, s.
        short: steps up to which one linearisation in the middle is as exact as the step, s.
    """

    robot: Robot
    names: tuple[str, ...]
    is_moved: bool
    closed: Contacts
    step: float
    short: float


class _Step:
    """One step; derivatives are made when they are asked for.

    Attributes:
        before: the state before it, shape (2n,).
    """

    def __init__(self, way: Way, t: float, x: Vector, h: float) -> None:
        """From ``x`` at ``t``, s since the epoch, ``h`` seconds on."""
        self._way, self._t, self.before, self._h = way, t, x, h
        self._tau, self._slope = torques_between(way.robot, t, t + h)

    @cached_property
    def after(self) -> Vector:
        """The state after it, shape (2n,)."""
        if not self._is_short:
            return self._whole[0]
        way = self._way
        return way.robot.advanced(self.before, self._tau, self._h, way.closed, self._slope)

    @property
    def Phi(self) -> Matrix:  # noqa: N802 (the symbol of the theory)
        """The derivative of the state after by the one before, shape (2n, 2n)."""
        return self._short[0] if self._is_short else self._whole[1]

    @property
    def Gamma(self) -> Matrix:  # noqa: N802
        """Derivatives of the state after by the parameters, shape (2n, p)."""
        return self._short[1] if self._is_short else self._whole[2]

    @property
    def _is_short(self) -> bool:
        return abs(self._h) <= self._way.short

    @cached_property
    def _whole(self) -> tuple[Vector, Matrix, Matrix]:
        """The step with the derivatives of the step itself."""
        way = self._way

        def torques(u: Vector, acceleration: Vector) -> Matrix:
            return torques_by_parameters(way.robot, u, acceleration, way.names)

        return way.robot.advanced_with_derivatives(
            self.before,
            self._tau,
            self._h,
            way.closed,
            torques=torques,
            slope=self._slope,
        )

    @cached_property
    def _rates(self) -> tuple[Matrix, Matrix]:
        """Derivatives of the rates in the middle by states and torques."""
        middle = (self.before + self.after) / 2
        return self._way.robot.rate_derivatives(middle, self._tau, self._way.closed)

    @cached_property
    def _short(self) -> tuple[Matrix, Matrix]:
        """Both derivatives by the linearisation in the middle, to third order."""
        first = self._h * self._rates[0]
        square = first @ first
        Phi = first + square / 2 + square @ first / 6
        Phi.flat[:: len(Phi) + 1] += 1.0
        if not self._way.is_moved:
            return Phi, np.zeros((len(Phi), len(self._way.names)))
        n = len(Phi) // 2
        u = (self.before + self.after)[n:] / 2
        acceleration = (self.after - self.before)[n:] / self._h
        drags = torques_by_parameters(self._way.robot, u, acceleration, self._way.names)
        kicks = self._h * self._rates[1][n:] @ drags
        return Phi, np.vstack([self._h / 2 * kicks, (np.eye(n) + Phi[n:, n:]) / 2 @ kicks])

    def noise(self, intensity: Vector) -> Matrix:
        """A root of the covariance of white torques and accelerations in it, shape (2n, 2n)."""
        robot, n, h = self._way.robot, self._way.robot.n, abs(self._h)
        q = (self.before + self.after)[:n] / 2
        kicks = (
            self._rates[1][n:] if self._is_short else robot.mobility_matrix(q, self._way.closed)
        )
        white = kicks * robot.white_torques(self._t)
        if np.any(intensity):
            white = triangular(np.hstack([white, kicks @ robot.mass(q) * intensity]))
        white = (np.eye(n) + self.Phi[n:, n:]) / 2 @ white  # what is left of a kick, in the mean
        found = np.zeros((2 * n, 2 * n))
        found[:n, :n] = h**1.5 / 2 * white
        found[:n, n:] = h**1.5 / math.sqrt(12) * white
        found[n:, :n] = math.sqrt(h) * white
        return found


class RobotCourse(Motion):
    """The motion through one state, forward or back."""

    def __init__(self, way: Way, t: float, x: Vector, *, backward: bool) -> None:
        """From ``x``, shape (2n,), at ``t``, s since the epoch."""
        self._way, self.t, self._x = way, t, x
        self._step = -way.step if backward else way.step
        self._steps: list[_Step] = []
        self._maps = [(np.eye(x.size), np.zeros((x.size, len(way.names))))]
        self._last: tuple[tuple[int, float], _Step] | None = None

    def state(self, s: float) -> Vector:
        """The state after ``s`` seconds, shape (2n,)."""
        return self._to(s)[1].after if s else self._x

    def states(self, s: Vector) -> Matrix:
        """``state`` after each of ``s`` seconds, shape (samples, 2n)."""
        return np.array([self.state(each) for each in s.tolist()])

    def maps(self, s: float) -> tuple[Matrix, Matrix]:
        """Its derivatives by the first state, shape (2n, 2n), and by parameters, (2n, p)."""
        if not s:
            return self._maps[0]
        whole, last = self._to(s)
        while len(self._maps) <= whole:
            self._maps.append(_after(self._maps[-1], self._steps[len(self._maps) - 1]))
        return _after(self._maps[whole], last)

    def noise(self, s: float, intensity: Vector) -> Matrix:
        """A root of the covariance of white torques and accelerations, shape (2n, 2n)."""
        if not s:
            return np.zeros((self._x.size, self._x.size))
        whole, last = self._to(s)
        first, *others = *self._steps[:whole], last
        root = first.noise(intensity)
        for step in others:
            root = triangular(np.hstack([step.Phi @ root, step.noise(intensity)]))
        return root

    def _to(self, s: float) -> tuple[int, _Step]:
        """How many whole steps come before the last step to ``s`` seconds, and this last one."""
        whole = max(math.ceil(s / self._step - _SAME_STEP) - 1, 0)
        left = s - whole * self._step
        while len(self._steps) < whole:
            self._steps.append(self._made(len(self._steps), self._step))
        if self._last is None or self._last[0] != (whole, left):
            self._last = (whole, left), self._made(whole, left)
        return whole, self._last[1]

    def _made(self, whole: int, seconds: float) -> _Step:
        """The step after some whole ones."""
        x = self._steps[whole - 1].after if whole else self._x
        return _Step(self._way, self.t + whole * self._step, x, seconds)


def _after(maps: tuple[Matrix, Matrix], step: _Step) -> tuple[Matrix, Matrix]:
    Phi, Gamma = maps
    return step.Phi @ Phi, step.Phi @ Gamma + step.Gamma


def torques_between(robot: Robot, since: float, until: float) -> tuple[Vector, Vector | None]:
    """Torques in the middle of a step, shape (n,), and their slope; None for zero.

    Where samples change within the step, the line with the same integral and first moment: the
    velocities and coordinates that it gives differ by the change of masses in the step.
    """
    forcing, middle = robot.forcing, (since + until) / 2
    samples = forcing.sampled
    if not isinstance(samples, LiveSamples) or forcing.frequency.size:
        tau, slope = forcing.derivatives(np.array([middle]), 1)[:, 0]
        return tau, slope
    ends = min(since, until), max(since, until)
    low = int(samples.time.searchsorted(ends[0] + _SAME_INSTANT))
    high = int(samples.time.searchsorted(ends[1] - _SAME_INSTANT, side="right"))
    held = samples.force[max(low - 1, 0) : max(low, high, 1)]
    if len(held) == 1:
        return forcing.constant + held[0], None
    knots = np.concatenate([ends[:1], samples.time[low:high], ends[1:]])
    share = np.diff(knots) / (ends[1] - ends[0])
    arm = (knots[1:] + knots[:-1]) / 2 - middle
    slope = 12 / (ends[1] - ends[0]) ** 2 * ((share * arm) @ held)
    return forcing.constant + share @ held, slope
