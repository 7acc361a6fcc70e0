# SPDX-License-Identifier: Apache-2.0
"""Samples of what is measured beside the impacts, as linear functions of the state."""

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from impact_observer.events import Contacts
from impact_observer.filter.members import Members
from impact_observer.filter.moving_system import MovingSystem
from impact_observer.filter.saltation import ROUNDING
from impact_observer.kernel._kernel import TINY
from impact_observer.model import System
from impact_observer.model.measurement import Coefficients, Measurement
from impact_observer.robots.robot import Robot
from impact_observer.robots.robot_readings import RobotReading
from impact_observer.states import Matrix, Stamps, Vector, frozen

_HALF_STEP = 1000
"""Half the distance of the instants by which speeds of grounds are differentiated, ns."""
_NOTHING = np.zeros(0)


class Row(NamedTuple):
    """A measured function ``h x + rest`` of a state.

    Attributes:
        h: by the state (q, u), shape (2n,).
        rest: in the unit of the measurement.
        of_theta: by the parameters that are estimated, shape (p,) or none.
    """

    h: Vector
    rest: float
    of_theta: Vector = _NOTHING

    def value(self, x: Vector) -> float:
        """At a state, shape (2n,)."""
        return float(self.h.dot(x)) + self.rest

    @property
    def whole(self) -> Vector:
        """By the state, and then by the parameters, shape (2n,) or (2n + p,)."""
        return np.concatenate([self.h, self.of_theta]) if self.of_theta.size else self.h

    def variance(self, root: Matrix) -> float:
        """That of the function, by a ``root`` of the covariance of state and constants."""
        seen = self.whole.dot(root[: self.h.size + self.of_theta.size])
        return float(seen.dot(seen))

    def rounding(self, sizes: Vector) -> float:
        """Standard deviation of its rounding, positive; states have these ``sizes``, (2n,)."""
        return ROUNDING * (float(np.abs(self.h).dot(sizes)) + abs(self.rest)) + TINY


class Place(NamedTuple):
    """Where a measured function is linearised.

    Attributes:
        t: s since the epoch.
        instant: the same, ns.
        x: the state (q, u) then, in the frame, shape (2n,).
        closed: contacts that are closed.
    """

    t: float
    instant: int
    x: Vector
    closed: Contacts


class DeclaredSensor:
    """A declared measurement of one system.

    Attributes:
        measurement: as it was declared.
        index: among all sensors.
        is_dynamic: whether it measures accelerations, which depend on forces.
        period: of what it measures, in its unit: an angle that turns; 0 for none.
    """

    period = 0.0

    def __init__(self, measurement: Measurement, system: System, index: int = 0) -> None:
        """Resolve names of coordinates and contacts.

        Raises:
            UsageError: the system does not have them, by file and key.
        """
        measurement.check(system)
        self.measurement, self.index = measurement, index
        self._system = system
        n = system.n
        p, v, a = (
            _coefficients(each, system)
            for each in (measurement.position, measurement.velocity, measurement.acceleration)
        )
        self._contact: int | None = None
        self._offset = measurement.offset
        if measurement.gap:
            self._contact = system.contact_names.index(measurement.gap)
            p = system.W[:, self._contact]
            self._offset += float(system.q_r[self._contact])
        self._p, self._v, self._a = p, v, a
        self.is_dynamic = bool(np.any(a))
        self._h = frozen(np.concatenate([p, v]))
        self._still = Row(self._h, self._offset)
        self._n = n

    @property
    def function(self) -> tuple[Vector, Vector, Vector, float, int]:
        """Factors of position, velocity and acceleration, offset, and contact, -1 for none."""
        contact = -1 if self._contact is None else self._contact
        offset = self.measurement.offset
        return self._p, self._v, self._a, offset, contact

    @property
    def name(self) -> str:
        """Of the sensor."""
        return self.measurement.name

    @property
    def variance(self) -> float:
        """Of its noise, in the square of its unit."""
        return self.measurement.deviation**2

    def row(self, moving: MovingSystem, at: Place) -> Row:
        """The measured function of states near a place; ``moving`` between impacts."""
        if not self.is_dynamic and (self._system.frame is None or self._contact is not None):
            return self._still
        h, rest = self._h, self._offset + float(self.shifts(np.array([at.instant]))[0])
        if self.is_dynamic:
            n, rates = self._n, moving.rates_at(at.t, at.x, at.closed)
            h = h + self._a.dot(rates.A[n:])
            forces = rates.B[n:].dot(moving.forces(at.t)[0])
            rest += float(self._a.dot(forces))
        return Row(h, rest)

    def row_of(self, members: Members, theta: Vector, at: Place) -> Row:
        """``row`` of the member of a family whose parameters are ``theta``, shape (p,)."""
        member = members.at(theta)
        row = self.row(member.moving, at)
        of_theta = np.zeros(theta.size)
        if self._contact is not None:
            sensitivity = members.gap_sensitivity((self._contact,))[0]
            of_theta, change = sensitivity, sensitivity.dot(theta - members.family.nominal)
            row = row._replace(rest=row.rest + float(change))
        if self.is_dynamic:
            rates = members.rate_sensitivity(member, at.closed, at.x, at.t)[self._n :]
            of_theta = of_theta + self._a.dot(rates)
        return row._replace(of_theta=of_theta)

    def values(self, moving: MovingSystem, t: Vector, states: Matrix, closed: Contacts) -> Vector:
        """What is measured without noise at states of one phase, less ``shifts``.

        Args:
            moving: between impacts.
            t: s since the epoch, shape (samples,).
            states: (q, u) then, in the frame, shape (samples, 2n).
            closed: contacts that are closed.
        """
        h, rest = self._h, self._offset
        if self.is_dynamic:
            n, rates = self._n, moving.rates(closed)
            h = h + self._a.dot(rates.A[n:])
            forces = moving.system.forcing.derivatives(t, 0)[0]
            rest = rest + forces @ self._a.dot(rates.B[n:])
        return np.asarray(states @ h + rest)

    def shifts(self, instants: Stamps) -> Vector:
        """What moving grounds add, as coordinates are those in the frame, shape (samples,).

        At ``instants``, ns since the epoch.
        """
        frame = self._system.frame
        if frame is None or self._contact is not None:
            return np.zeros(instants.size)
        around = np.concatenate([instants - _HALF_STEP, instants, instants + _HALF_STEP])
        parts = (np.split(each, 3) for each in frame.displacements(around))
        (_, s, _), (before, speed, after) = parts
        acceleration = (after - before) / (2e-9 * _HALF_STEP)
        rows = ((self._p, s), (self._v, speed), (self._a, acceleration))
        return np.asarray(sum(motion @ (row @ frame.shift) for row, motion in rows))


class Reading(NamedTuple):
    """A sample at its instant.

    Attributes:
        sensor: whose sample.
        value: as it was measured.
        t: s since the epoch.
        instant: the same, ns.
        since_impact: s since the last impact that was reported; infinite before any.
        closed: contacts with ``chi = 1``.
        rejected: how many samples of its sensor in a row were rejected before it.
    """

    sensor: DeclaredSensor
    value: float
    t: float
    instant: int
    since_impact: float = math.inf
    closed: Contacts = ()
    rejected: int = 0

    @property
    def is_blanked(self) -> bool:
        """Whether an impact was too short a time ago."""
        return self.since_impact < self.sensor.measurement.blanking


class SampleOutcome(NamedTuple):
    """What a law made of a sample.

    Attributes:
        innovation: value less predicted value.
        normalized: its magnitude in standard deviations; -1 where a law has none.
        accepted: whether it was used.
        reason: why not; empty otherwise.
    """

    innovation: float
    normalized: float = -1.0
    accepted: bool = True
    reason: str = ""


class RobotSensor(DeclaredSensor):
    """A declared measurement of a robot; angles of continuous joints count modulo 2 pi."""

    def __init__(self, measurement: Measurement, robot: Robot, index: int = 0) -> None:
        """Resolve names of joints and contacts.

        Raises:
            UsageError: the robot does not have them, by file and key.
        """
        self._reading = reading = RobotReading(measurement, robot, index)
        self.measurement, self.index = measurement, index
        self.is_dynamic = reading.is_dynamic
        turning = itertools.compress(robot.coordinates, robot.turns)
        self.period = math.tau if {*dict(measurement.position)}.intersection(turning) else 0.0
        zero = np.zeros(robot.n)
        self._affine = (
            self._expanded(np.zeros(2 * robot.n), zero, ()) if reading.is_affine else None
        )

    @property
    def function(self) -> tuple[Vector, Vector, Vector, float, int]:
        """As of another sensor."""
        return self._reading.function

    def row(self, moving: MovingSystem, at: Place) -> Row:
        """The measured function of states near a place."""
        if self._affine is not None:
            return self._affine
        tau = moving.forces(at.t)[0] if self.is_dynamic else np.zeros(at.x.size // 2)
        return self._expanded(at.x, tau, at.closed)

    def _expanded(self, x: Vector, tau: Vector, closed: Contacts) -> Row:
        h = self._reading.gradient(x, tau, closed)
        return Row(h, self._reading.value(x, tau, closed) - float(h.dot(x)))

    def row_of(self, members: Members, theta: Vector, at: Place) -> Row:
        """``row`` of the member of a family whose parameters are ``theta``, shape (p,)."""
        row = self.row(members.given.moving, at)
        if not self.is_dynamic:
            return row
        rates = members.rate_sensitivity(members.at(theta), at.closed, at.x, at.t)
        return row._replace(of_theta=self._reading.by_acceleration @ rates[at.x.size // 2 :])

    def shifts(self, instants: Stamps) -> Vector:
        """What moving grounds add: nothing, shape (samples,)."""
        return np.zeros(instants.size)


def sensors_of(
    measurements: Sequence[Measurement], system: System | Robot
) -> tuple[DeclaredSensor, ...]:
    """The sensors of a system or a robot.

    Raises:
        UsageError: the system does not have a coordinate or contact, by file and key.
    """
    if isinstance(system, Robot):
        return tuple(RobotSensor(each, system, i) for i, each in enumerate(measurements))
    return tuple(DeclaredSensor(each, system, i) for i, each in enumerate(measurements))


def _coefficients(given: Coefficients, system: System) -> Vector:
    found = np.zeros(system.n)
    for name, value in given:
        found[system.coordinates.index(name)] += value
    return found
