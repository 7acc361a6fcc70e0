# SPDX-License-Identifier: Apache-2.0
"""Samples of what is measured beside the impacts, as functions of the state."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from impact_observer.events import Contacts
from impact_observer.model import System
from impact_observer.model.measurement import Coefficients, Measurement
from impact_observer.robots.robot import Robot
from impact_observer.states import Stamps, Vector

_HALF_STEP = 1000
"""Half the distance of the instants by which speeds of grounds are differentiated, ns."""


class DeclaredSensor:
    """A declared measurement of one system or robot.

    Attributes:
        measurement: as it was declared.
        index: among all sensors.
        period: of what it measures, in its unit: an angle that turns; 0 for none.
        function: factors of position, velocity and acceleration, shape (n,) each, offset, and
            the contact whose gap is measured, -1 for none.
    """

    def __init__(self, measurement: Measurement, system: System | Robot, index: int = 0) -> None:
        """Resolve names of coordinates and contacts.

        Raises:
            UsageError: the system does not have them, by file and key.
        """
        measurement.check(system)
        self.measurement, self.index, self._frame = measurement, index, system.frame
        p, v, a = (
            _coefficients(each, system)
            for each in (measurement.position, measurement.velocity, measurement.acceleration)
        )
        gap = measurement.gap
        contact = system.contact_names.index(gap) if gap else -1
        self.function = p, v, a, measurement.offset, contact
        self.period = math.tau if np.any(p[system.turns]) else 0.0

    @property
    def name(self) -> str:
        """Of the sensor."""
        return self.measurement.name

    @property
    def variance(self) -> float:
        """Of its noise, in the square of its unit."""
        return self.measurement.deviation**2

    def shifts(self, instants: Stamps) -> Vector:
        """What moving grounds add, as coordinates are those in the frame, shape (samples,).

        At ``instants``, ns since the epoch.
        """
        if self._frame is None:
            return np.zeros(instants.size)
        around = np.concatenate([instants - _HALF_STEP, instants, instants + _HALF_STEP])
        parts = (np.split(each, 3) for each in self._frame.displacements(around))
        (_, s, _), (before, speed, after) = parts
        acceleration = (after - before) / (2e-9 * _HALF_STEP)
        rows = zip(self.function[:3], (s, speed, acceleration), strict=True)
        return np.asarray(sum(motion @ (row @ self._frame.shift) for row, motion in rows))


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


def sensors_of(
    measurements: Sequence[Measurement], system: System | Robot
) -> tuple[DeclaredSensor, ...]:
    """The sensors of a system or a robot.

    Raises:
        UsageError: the system does not have a coordinate or contact, by file and key.
    """
    return tuple(DeclaredSensor(each, system, i) for i, each in enumerate(measurements))


def _coefficients(given: Coefficients, system: System | Robot) -> Vector:
    found = np.zeros(system.n)
    for name, value in given.items():
        found[system.coordinates.index(name)] += value
    return found
