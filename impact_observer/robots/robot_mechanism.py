# SPDX-License-Identifier: Apache-2.0
"""The mechanism of a robot: every answer by pinocchio, and derivatives along Runge-Kutta steps."""

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from scipy import linalg

from impact_observer.dynamics.contact.complementarity import complementary
from impact_observer.dynamics.mechanism import (
    Array,
    Flown,
    Gaps,
    Grip,
    Mechanism,
    Pressing,
    mechanism_of,
)
from impact_observer.errors import DynamicsError
from impact_observer.events import Contacts
from impact_observer.robots.robot import Robot
from impact_observer.robots.robot_flight import RobotFlight, held_state
from impact_observer.robots.robot_parameters import jump_by_parameters, torques_by_parameters
from impact_observer.states import Matrix, Vector

_GRAVITY = 9.81
_ZERO = 1e-11
"""Acceleration of a gap that counts as none, relative to the largest term of its sum."""
_LONGEST_STEP = 0.1
"""Longest step of flights with derivatives, in the inverse of the fastest rate at rest."""

Start: TypeAlias = tuple[Vector, float, float]
"""State, shape (2n,), s since the epoch, and duration of a flight, s."""


class RobotMechanism:
    """One robot.

    Attributes:
        system: the robot.
        timescale: of a fall through the reach of the robot, s.
        names: parameters by which derivatives are taken, as in ``robot_parameters``.
    """

    def __init__(self, robot: Robot, names: Sequence[str] = ()) -> None:
        """Take the parameters ``names`` for derivatives."""
        self.system: Robot = robot
        self.names = tuple(names)
        size = float(np.max(robot.reach, initial=1.0))
        self.timescale: float = math.sqrt(size / _GRAVITY)
        n = robot.n
        A, _ = robot.rate_derivatives(np.zeros(2 * n), robot.rest_torque(np.zeros(n)))
        rate = float(np.max(np.abs(np.linalg.eigvals(A))))
        self._step = _LONGEST_STEP / max(rate, 1.0)

    def motion(self, t: float, x: Vector, grip: Grip, /) -> RobotFlight:
        """A flow of high order, in whose steps guards are polynomials."""
        return RobotFlight(self.system, t, x, grip)

    def struck(self, x: Vector, contacts: Contacts, /, *, plastic: bool = False) -> Vector:
        """Newton's law, and the nearest position on the planes in the metric of ``M``."""
        robot, (q, u) = self.system, np.split(x, 2)
        velocity = robot.velocity_after(q, u, contacts, plastic=plastic)
        return np.concatenate([robot.projected(q, contacts), velocity])

    def stopped(self, x: Vector, contacts: Contacts, /) -> Vector:
        """The nearest state in the metric of ``M``."""
        return held_state(self.system, x, contacts)

    def pressing(self, t: float, x: Vector, /) -> Pressing:
        """How contacts are pressed; planes do not move."""
        robot, (q, u) = self.system, np.split(x, 2)
        root = np.linalg.cholesky(robot.mass(q))
        B = linalg.solve_triangular(root, robot.directions(q), lower=True)
        free = root.T @ robot.acceleration(q, u, robot.torques(t))
        length = np.sqrt(np.einsum("ik,ik->k", B, B))
        return Pressing(B, length, free, robot.bias(q, u), robot.reach)

    def grip(
        self,
        t: float,
        x: Vector,
        contacts: Contacts,
        /,
        ending: tuple[Grip, frozenset[int]] | None = None,
    ) -> Grip:
        """Accelerations decide."""
        if not contacts:
            return Grip((), ())
        robot = self.system
        here, which = self.pressing(t, x), list(contacts)
        B, rising = here.B[:, which], here.rising(contacts)
        loads = complementary(B, rising)
        if loads is None:
            names = ", ".join(repr(robot.contact_names[i]) for i in contacts)
            raise DynamicsError(
                f"{robot.name}: contacts {names}: the loads that hold them cannot be found"
            )
        none = _ZERO * (np.abs(here.free) @ np.abs(B) + np.abs(here.bias[which]))
        stays = (loads > 0) | (rising + B.T @ (B @ loads) <= none)
        closed = tuple(i for i, each in zip(contacts, stays, strict=True) if each)
        if ending is not None and closed == ending[0].closed:
            closed = tuple(i for i in closed if i not in ending[1])
        return Grip(closed, closed)

    def flown(self, t: Sequence[float], x: Array, s: Vector, held: Contacts, /) -> Flown:
        """Steps of Runge and Kutta of 4th order with their own derivatives."""
        n, K = self.system.n, len(x)
        Phi, Gamma = np.empty((K, 2 * n, 2 * n)), np.empty((K, 2 * n, len(self.names)))
        after = np.empty_like(x)
        for k, (each, start, seconds) in enumerate(self._flights(t, x, s)):
            after[k], Phi[k], Gamma[k], _ = self._flight(start, each, seconds, held)
        return Flown(after, Phi, Gamma)

    def noise(
        self, t: Sequence[float], x: Array, s: Vector, held: Contacts, intensity: Vector, /
    ) -> Array:
        """White accelerations along the motion of each state, step by step."""
        found = [
            self._flight(start, each, seconds, held, intensity)[3]
            for each, start, seconds in self._flights(t, x, s)
        ]
        return np.array(found)

    def rates(self, t: Sequence[float], x: Array, held: Contacts, /) -> Array:
        """``(u, u')`` of each state."""
        robot, times = self.system, np.broadcast_to(t, len(x)).tolist()
        each = zip(x, times, strict=True)
        return np.array([robot.rates(at, robot.torques(when), held) for at, when in each])

    def gaps(self, x: Array, /) -> Gaps:
        """One state after the other."""
        robot, n = self.system, self.system.n
        rows = x.reshape(-1, 2 * n)
        placed = [robot.gaps_and_directions(each[:n]) for each in rows]
        W = np.array([each.T for _, each in placed]).reshape(*x.shape[:-1], robot.m, n)
        g = np.array([each for each, _ in placed]).reshape(*x.shape[:-1], robot.m)
        return Gaps(g, np.einsum("...ij,...j->...i", W, x[..., n:]), W)

    def impact(self, x: Array, pressed: Contacts, /) -> Flown:
        """One state after the other."""
        robot, d = self.system, 2 * self.system.n
        rows = x.reshape(-1, d)
        after = np.array([robot.jumped(each, pressed) for each in rows])
        Phi = np.array([robot.jump_derivatives(each, pressed) for each in rows])
        Gamma = np.array([jump_by_parameters(robot, each, pressed, self.names) for each in rows])
        shape = x.shape[:-1]
        return Flown(
            after.reshape(x.shape), Phi.reshape(*shape, d, d), Gamma.reshape(*shape, d, -1)
        )

    def kinetic(self, x: Array, /) -> Array:
        """``u' M(q) u / 2``."""
        n = self.system.n
        rows = x.reshape(-1, 2 * n)
        found = [self.system.kinetic_energy(each[:n], each[n:]) for each in rows]
        return np.array(found).reshape(x.shape[:-1])

    def distance(self, x: Array, error: Array, /) -> Array:
        """``du' M(q) du / 2 + dq' M(q) dq / 2 s^2``: inertia weighs positions, too, over 1 s."""
        n = self.system.n
        M = np.array([self.system.mass(each[:n]) for each in x.reshape(-1, 2 * n)])
        M, halves = M.reshape(-1, n, n), error.reshape(-1, 2, n)
        found = np.einsum("kai,kij,kaj->k", halves, M, halves) / 2
        return np.asarray(found.reshape(x.shape[:-1]))

    def _flights(self, t: Sequence[float], x: Array, s: Vector) -> Sequence[Start]:
        """State, start and duration of each flight."""
        times, lengths = np.broadcast_to(t, len(x)), np.broadcast_to(s, len(x))
        return [*zip(x, times.tolist(), lengths.tolist(), strict=True)]

    def _torques(self, u: Vector, acceleration: Vector) -> Matrix:
        return torques_by_parameters(self.system, u, acceleration, self.names)

    def _flight(
        self,
        t: float,
        x: Vector,
        seconds: float,
        held: Contacts,
        intensity: Vector | None = None,
    ) -> tuple[Vector, Matrix, Matrix, Matrix]:
        """The state after a flight, its derivatives, and a root of the noise it has collected."""
        robot, n = self.system, self.system.n
        Phi, Gamma = np.eye(2 * n), np.zeros((2 * n, len(self.names)))
        Q = np.zeros((2 * n, 2 * n))
        count = max(math.ceil(abs(seconds) / self._step), 1)
        h = seconds / count
        for k in range(count):
            tau = robot.torques(t + (k + 0.5) * h)
            before = x
            x, step, by = robot.advanced_with_derivatives(x, tau, h, held, self._torques)
            Phi, Gamma = step @ Phi, step @ Gamma + by
            if intensity is not None:
                q = (before + x)[:n] / 2
                free = robot.mobility_matrix(q, held) @ robot.mass(q)
                faded = (np.eye(n) + step[n:, n:]) / 2  # what is left of a kick, in the mean
                Q = step @ Q @ step.T + _kicked(faded @ free * intensity, h)
        values, vectors = np.linalg.eigh((Q + Q.T) / 2)
        return x, Phi, Gamma, vectors * np.sqrt(np.maximum(values, 0.0))


def _kicked(kicks: Matrix, h: float) -> Matrix:
    """The covariance that white accelerations add in ``h`` seconds, shape (2n, 2n)."""
    n, square = len(kicks), kicks @ kicks.T
    Q = np.empty((2 * n, 2 * n))
    Q[:n, :n], Q[:n, n:] = h**3 / 3 * square, h**2 / 2 * square
    Q[n:, :n], Q[n:, n:] = h**2 / 2 * square, h * square
    return Q


@mechanism_of.register
def _(robot: Robot) -> Mechanism:
    return RobotMechanism(robot)
