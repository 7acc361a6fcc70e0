# SPDX-License-Identifier: Apache-2.0
"""A robot at one state, in the place of a linear system."""

from functools import cached_property
from typing import cast

import numpy as np

from impact_observer.model import System
from impact_observer.model.rebounds import ReboundLaw
from impact_observer.robots.robot import Robot
from impact_observer.states import Matrix, Vector


class TangentRobot:
    """A robot at one state: gaps and speeds are linear near it.

    Attributes:
        n: number of coordinates.
        m: number of contacts.
        W: gradients of the gaps, shape (n, m).
        q_r: gaps where all coordinates are zero, linearly, shape (m,), m.
        eps: nominal restitution coefficients, shape (m,).
        rebounds: how the contacts rebound.
    """

    def __init__(self, robot: Robot, x: Vector) -> None:
        """The ``robot`` at the state ``x``, shape (2n,)."""
        self.n, self.m = robot.n, robot.m
        self._robot, self._q = robot, x[: self.n]
        gaps, self.W = robot.gaps_and_directions(self._q)
        self.q_r = gaps - self._q @ self.W
        self.eps = robot.eps
        self.rebounds: tuple[ReboundLaw, ...] = robot.rebounds

    @cached_property
    def M(self) -> Matrix:  # noqa: N802 (as of a system)
        """The mass matrix, shape (n, n)."""
        return self._robot.mass(self._q)

    @property
    def K(self) -> Matrix:  # noqa: N802
        """The stiffness that makes V a distance: the mass matrix over 1 s^2, shape (n, n)."""
        return self.M

    def gap(self, q: Vector) -> Vector:
        """Gaps near the state, shape (m,), m."""
        return np.asarray(q @ self.W + self.q_r)

    def contact_speed(self, u: Vector) -> Vector:
        """Contact speeds near the state, shape (m,), m/s."""
        return np.asarray(u @ self.W)


def tangent(robot: Robot, x: Vector) -> System:
    """A ``robot`` at a state, shape (2n,), in the place of a linear system."""
    return cast(System, TangentRobot(robot, x))
