# SPDX-License-Identifier: Apache-2.0
"""The guard functions of a robot along a flight: gaps of open contacts, loads of closed ones."""

import math
from collections.abc import Callable

import numpy as np

from impact_observer.dynamics.flow import Motion
from impact_observer.events import Contacts
from impact_observer.filter.forecast import Flight
from impact_observer.filter.robot_motion import RobotMotion
from impact_observer.robots.robot import Robot
from impact_observer.states import Matrix, Vector

_FIRST_SAMPLES = 8.0 ** np.arange(-2, 0)
"""Samples in the first interval, over its length: a flight after an impact may be short."""
_ROUNDING = 1e-12
"""Rounding of a guard function, relative to its scale."""


class RobotGuards(Flight):
    """The guard functions of a flight: gaps of open contacts, then loads of closed ones.

    Attributes:
        contacts: the contact of each function.
        gaps: how many of them are gaps.
    """

    def __init__(self, robot: Robot, moving: RobotMotion, t: float, closed: Contacts) -> None:
        """A flight of ``robot`` from ``t``, s since the epoch, with ``closed`` contacts."""
        self._robot, self._moving, self._t, self._closed = robot, moving, t, closed
        open_ = tuple(i for i in range(robot.m) if i not in closed)
        self.gaps, self.contacts = len(open_), (*open_, *closed)

    def is_clear(self, motion: Motion, duration: float) -> bool:
        """Whether no function can fall below zero within ``duration`` seconds, by a bound.

        In a step gaps are cubic polynomials by values and speeds at both ends. A closed contact is
        in doubt.
        """
        if self._closed:
            return False
        count = math.ceil(duration / self._moving.longest_step)
        states = motion.states(np.linspace(0.0, duration, count + 1))
        n, third = self._robot.n, duration / count / 3
        placed = [(x[n:], *self._robot.gaps_and_directions(x[:n])) for x in states]
        gaps = np.array([g for _, g, _ in placed])
        change = np.array([W.T @ u for u, _, W in placed]) * third
        inner = np.minimum(gaps[:-1] + change[:-1], gaps[1:] - change[1:])
        return bool(np.all(gaps > 0) and np.all(inner > 0))

    def instants(self, duration: float) -> Vector:
        """Samples of the next ``duration`` seconds, shape (samples,)."""
        count = max(math.ceil(duration / self._moving.longest_step), 4)
        s = np.linspace(0.0, duration, count + 1)
        return np.concatenate([s[:1], s[1] * _FIRST_SAMPLES, s[1:]])

    def values(self, motion: Motion, s: Vector) -> Matrix:
        """The functions along a motion, at ``s`` seconds in rising order, (samples, functions)."""
        return np.array([self._at(at, motion.state(at)) for at in s.tolist()])

    def value(self, j: int, s: float, x: Vector) -> float:
        """Function ``j`` after ``s`` seconds, at the state ``x``."""
        return float(self._at(s, x)[j])

    def gradient(self, j: int, s: float, state: Callable[[float], Vector]) -> Vector:
        """Derivatives of function ``j`` by the ``state`` after ``s`` seconds, shape (2n,)."""
        n, x = self._robot.n, state(s)
        if j < self.gaps:
            W = self._robot.directions(x[:n], self.contacts[j : j + 1])
            return np.concatenate([W[:, 0], np.zeros(n)])
        tau = self._moving.forces(self._t + s)[0]
        loads = self._robot.load_gradients(x, tau, self._closed)
        return np.asarray(loads[j - self.gaps])

    def rounding(self, j: int, s: float, x: Vector) -> float:
        """Deviation of the rounding of function ``j`` after ``s`` seconds, at the state ``x``."""
        del s, x
        return _ROUNDING * float(self._robot.reach[self.contacts[j]])

    def _at(self, s: float, x: Vector) -> Vector:
        n = self._robot.n
        gaps = self._robot.gaps(x[:n], self.contacts[: self.gaps])
        if not self._closed:
            return gaps
        tau = self._moving.forces(self._t + s)[0]
        return np.concatenate([gaps, self._robot.loads(x[:n], x[n:], tau, self._closed)])
