# SPDX-License-Identifier: Apache-2.0
"""What the sensors of a robot measure, and its gradients."""

from collections.abc import Sequence

import numpy as np

from impact_observer.events import Contacts
from impact_observer.model.measurement import Coefficients, Measurement
from impact_observer.robots.robot import Robot
from impact_observer.states import Vector


class RobotReading:
    """A declared measurement of a robot.

    Attributes:
        measurement: as it was declared.
        index: among all sensors.
        is_dynamic: whether it measures accelerations, which depend on torques.
        is_affine: whether it measures positions and velocities of joints alone.
        by_acceleration: derivatives of ``value`` by the accelerations of joints, shape (n,).
    """

    def __init__(self, measurement: Measurement, robot: Robot, index: int = 0) -> None:
        """Resolve names of joints and contacts.

        Raises:
            UsageError: the robot does not have them, by file and key.
        """
        measurement.check(robot)
        self.measurement, self.index, self._robot = measurement, index, robot
        p, v, self.by_acceleration = (
            _coefficients(each, robot.coordinates)
            for each in (measurement.position, measurement.velocity, measurement.acceleration)
        )
        self._h = np.concatenate([p, v])
        self.is_dynamic = bool(np.any(self.by_acceleration))
        names = robot.contact_names
        self._contacts = (names.index(measurement.gap),) if measurement.gap else ()
        self.is_affine = not (self.is_dynamic or self._contacts)

    @property
    def function(self) -> tuple[Vector, Vector, Vector, float, int]:
        """X."""
        n, contact = self._robot.n, self._contacts[0] if self._contacts else -1
        return (
            self._h[:n],
            self._h[n:],
            self.by_acceleration,
            self.measurement.offset,
            contact,
        )

    @property
    def name(self) -> str:
        """Of the sensor."""
        return self.measurement.name

    def value(self, x: Vector, tau: Vector, closed: Contacts = ()) -> float:
        """What is measured without noise in a state (q, u), shape (2n,), with torques ``tau``."""
        robot, n = self._robot, self._robot.n
        found = self.measurement.offset + float(self._h @ x)
        if self._contacts:
            found += float(robot.gaps(x[:n], self._contacts)[0])
        if self.is_dynamic:
            found += float(self.by_acceleration @ robot.acceleration(x[:n], x[n:], tau, closed))
        return found

    def gradient(self, x: Vector, tau: Vector, closed: Contacts = ()) -> Vector:
        """Derivatives of ``value`` by the state, shape (2n,)."""
        robot, n = self._robot, self._robot.n
        found = np.array(self._h)
        if self._contacts:
            found[:n] += robot.directions(x[:n], self._contacts)[:, 0]
        if self.is_dynamic:
            by_q, by_u, _ = robot.acceleration_derivatives(x[:n], x[n:], tau, closed)
            found += np.concatenate([self.by_acceleration @ by_q, self.by_acceleration @ by_u])
        return np.asarray(found)


def _coefficients(given: Coefficients, joints: Sequence[str]) -> Vector:
    """Coefficients in the order of ``joints``, shape (n,)."""
    found = np.zeros(len(joints))
    for name, value in given:
        found[joints.index(name)] += value
    return found
