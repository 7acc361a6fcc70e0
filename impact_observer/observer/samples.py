# SPDX-License-Identifier: Apache-2.0
"""Sensors beside the impacts, their samples, and what a law made of each."""

import math
from collections import Counter, deque
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from impact_observer.events import Contacts, MeasurementVerdict
from impact_observer.model.measurement import Measurement
from impact_observer.model.system import LARGEST_STATE, System
from impact_observer.observer.event_order import EventKey
from impact_observer.robots.robot import Robot
from impact_observer.stamps import MAX_STAMP
from impact_observer.states import Stamps, Vector

MOST_KEPT = 20_000
"""Most samples kept until their use: those of 20 s at 1 kHz."""
MOST_VERDICTS = 100_000
"""Most verdicts kept until ``take``."""
_HALF_STEP = 1000
"""Half the distance of the instants by which speeds of grounds are differentiated, ns."""


class DeclaredSensor:
    """A declared ``measurement`` of one system.

    Attributes:
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
        rows = np.zeros((3, system.n))
        given = measurement.position, measurement.velocity, measurement.acceleration
        for row, coefficients in zip(rows, given, strict=True):
            for name, value in coefficients.items():
                row[system.coordinates.index(name)] += value
        gap = measurement.gap
        contact = system.contact_names.index(gap) if gap else -1
        self.function = *rows, measurement.offset, contact
        self.period = math.tau if np.any(rows[0, system.turns]) else 0.0

    @property
    def name(self) -> str:
        """Name of the sensor."""
        return self.measurement.name

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


def sensors_of(
    measurements: Sequence[Measurement], system: System | Robot
) -> tuple[DeclaredSensor, ...]:
    """The sensors of a system; raises as ``DeclaredSensor``."""
    return tuple(DeclaredSensor(each, system, i) for i, each in enumerate(measurements))


class SensorSample(NamedTuple):
    """The value that a sensor, by its index, has measured at a ``stamp``, ns, without delay."""

    sensor: int
    stamp: int
    value: float


class Reading(NamedTuple):
    """A sample as a law gets it.

    Attributes:
        sensor: whose sample.
        value: as it was measured.
        instant: ns since the epoch.
        since_impact: s since the last impact that was reported; infinite before any.
        closed: contacts with ``chi = 1``.
        rejected: how many samples of its sensor in a row were rejected before it.
    """

    sensor: DeclaredSensor
    value: float
    instant: int
    since_impact: float = math.inf
    closed: Contacts = ()
    rejected: int = 0


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

    @classmethod
    def unused(cls, reason: str) -> "SampleOutcome":
        """A sample without an innovation is not used."""
        return cls(0.0, -1.0, False, reason)


class SampleStream:
    """The received samples, and the verdicts on them.

    Attributes:
        sensors: the sensors whose samples are received.
        waiting: samples that are not in the timeline yet.
        counts: counts of each sensor: ``samples``, ``accepted``, ``rejected`` by its gate,
            ``unused``, ``invalid``, ``dropped`` as too many were waiting, and ``shed`` by a node
            that could not keep up.
        newest: the latest stamp of each sensor, ns; 0 before the first.
    """

    def __init__(self, sensors: Sequence[DeclaredSensor]) -> None:
        """Start with no sample."""
        self.sensors = sensors
        self.waiting: deque[EventKey] = deque(maxlen=MOST_KEPT)
        self.counts: list[Counter[str]] = [Counter() for _ in sensors]
        self.newest = [0] * len(sensors)
        self._verdicts: deque[MeasurementVerdict] = deque(maxlen=MOST_VERDICTS)

    def add_samples(self, samples: Iterable[SensorSample]) -> None:
        """Receive samples; those that are no numbers are judged at once."""
        for sensor, stamp, value in samples:
            counts = self.counts[sensor]
            counts["samples"] += 1
            if not 0 < stamp <= MAX_STAMP:
                counts["invalid"] += 1
            elif not abs(value) <= LARGEST_STATE:
                counts["invalid"] += 1
                reason = f"{value:g} found; expected a number of at most {LARGEST_STATE:g}"
                outcome = SampleOutcome.unused(reason)
                name = self.sensors[sensor].name
                self._verdicts.append(MeasurementVerdict(stamp, name, 0.0, *outcome))
            else:
                self.newest[sensor] = max(self.newest[sensor], stamp)
                if len(self.waiting) == MOST_KEPT:
                    self.counts[self.waiting[0].sensor]["dropped"] += 1
                self.waiting.append(EventKey.measured(stamp, sensor, float(value)))

    def judge(self, key: EventKey, outcome: SampleOutcome) -> None:
        """Note the outcome of a sample."""
        kind = "accepted" if outcome.accepted else "unused"
        if outcome.reason.startswith("gate"):
            kind = "rejected"
        self.counts[key.sensor][kind] += 1
        (value,), name = key.sample, self.sensors[key.sensor].name
        self._verdicts.append(MeasurementVerdict(key.stamp, name, value, *outcome))

    def clear(self) -> None:
        """Forget all samples, but keep their counts and verdicts."""
        self.waiting.clear()
        self.newest = [0] * len(self.sensors)

    def take(self) -> tuple[MeasurementVerdict, ...]:
        """Return the verdicts since the last call."""
        verdicts = tuple(self._verdicts)
        self._verdicts.clear()
        return verdicts
