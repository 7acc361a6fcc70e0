# SPDX-License-Identifier: Apache-2.0
"""Which contacts of a robot come to rest after an impact, and which stay closed.

The rules are those of linear models: ``zeno.py`` and ``dynamics/contact/persistent_contact.py``.
"""

import math

import numpy as np
from scipy import linalg

from impact_observer.dynamics.contact.complementarity import complementary
from impact_observer.errors import DynamicsError
from impact_observer.events import Contacts
from impact_observer.plant.zeno import LOW, SHORT
from impact_observer.robots.robot import Robot
from impact_observer.states import Matrix, Vector

_GRAVITY = 9.81
_ROUNDING = 1e-12
"""Contact speed that counts as zero, relative to that of all kinetic energy in it."""
_ZERO = 1e-11
"""Acceleration that counts as none, relative to the largest term of its sum."""


class RobotRest:
    """The decisions for one robot.

    Attributes:
        lowest: heights of flights that count as zero, shape (m,), m.
        shortest: longest flight that counts as zero, s.
    """

    def __init__(self, robot: Robot) -> None:
        """Prepare the scales."""
        self._robot = robot
        self.lowest = LOW * robot.reach
        size = float(np.max(robot.reach, initial=1.0))
        self.shortest = SHORT * math.sqrt(size / _GRAVITY)

    def speed_tolerance(self, x: Vector) -> Vector:
        """Contact speeds that count as zero in a state (q, u), shape (m,), m/s."""
        robot, n = self._robot, self._robot.n
        energy = 2 * robot.kinetic_energy(x[:n], x[n:])
        return np.asarray(_ROUNDING * np.sqrt(np.maximum(energy * robot.mobility(x[:n]), 0.0)))

    def resting(self, x: Vector, tau: Vector, contacts: Contacts, before: Vector) -> Contacts:
        """The contacts that rest on their planes after an impact, as indices.

        Args:
            x: state (q, u+), shape (2n,).
            tau: torques, shape (n,).
            contacts: the contacts that took part.
            before: state (q, u-), shape (2n,), the scale of rounding of contact speeds.
        """
        gamma, rounding = self._robot.contact_speeds(x), self.speed_tolerance(before)
        resting = [i for i in contacts if gamma[i] >= -rounding[i]]
        while resting:
            falls = self._falls(x, tau, resting)
            flights = [
                0.0 if gamma[i] <= rounding[i] else self._flight(gamma[i], fall, self.lowest[i])
                for i, fall in zip(resting, falls.tolist(), strict=True)
            ]
            if max(flights) <= 1.0:
                break
            # Remove one at a time: without its load the others may rest or separate.
            resting.pop(flights.index(max(flights)))
        return tuple(resting)

    def staying(self, x: Vector, tau: Vector, contacts: Contacts) -> Contacts:
        """Those of ``contacts`` with ``g = 0, gamma = 0`` that stay closed in the state ``x``.

        Raises:
            DynamicsError: the loads cannot be found.
        """
        if not contacts:
            return ()
        B, rising, zero = self._problem(x, tau, contacts)
        loads = complementary(B, rising)
        if loads is None:
            names = ", ".join(repr(self._robot.contact_names[i]) for i in contacts)
            raise DynamicsError(
                f"{self._robot.name}: contacts {names}: the loads that hold them cannot be found"
            )
        away = rising + B.T @ (B @ loads)
        return tuple(
            i
            for i, load, rate, none in zip(contacts, loads, away, zero, strict=True)
            if load > 0 or rate <= none
        )

    def _problem(
        self, x: Vector, tau: Vector, contacts: list[int] | Contacts
    ) -> tuple[Matrix, Vector, Vector]:
        """``B`` of ``G = B'B``, accelerations of gaps without loads, and what counts as zero."""
        robot, n = self._robot, self._robot.n
        q, u = x[:n], x[n:]
        W = robot.directions(q, contacts)
        B = np.linalg.cholesky(robot.inverse_mass(q)).T @ W
        free, bias = robot.acceleration(q, u, tau), robot.bias(q, u, contacts)
        size = np.abs(W).T @ np.abs(free) + np.abs(bias)
        return B, W.T @ free + bias, _ZERO * size

    def _falls(self, x: Vector, tau: Vector, contacts: list[int]) -> Vector:
        """Acceleration with which each contact would come back if the others were held, m/s^2."""
        B, rising, _ = self._problem(x, tau, contacts)
        loads = complementary(B, rising)
        falls = np.zeros(len(contacts))
        if loads is None:
            return falls
        pressed = np.flatnonzero(loads > 0)
        if pressed.size:
            inverse = linalg.pinvh(B[:, pressed].T @ B[:, pressed])
            falls[pressed] = loads[pressed] / np.diag(inverse)
        return falls

    def _flight(self, speed: float, fall: float, lowest: float) -> float:
        """Next flight, relative to the longest that counts as none."""
        if fall <= 0:
            return math.inf
        return min(2 * speed / fall / self.shortest, speed * speed / (2 * fall) / lowest)
