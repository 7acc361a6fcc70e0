# SPDX-License-Identifier: Apache-2.0
"""Samples of sensors on their way into the timeline of an observer."""

from collections import Counter, deque
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from impact_observer.events import MeasurementVerdict
from impact_observer.model.system import LARGEST_STATE
from impact_observer.observer.event_order import EventKey
from impact_observer.observer.readings import DeclaredSensor, SampleOutcome
from impact_observer.stamps import MAX_STAMP

MOST_KEPT = 20_000
"""Most samples kept until their use: those of 20 s at 1 kHz."""
MOST_VERDICTS = 100_000
"""Most verdicts kept until ``take``."""


class SensorSample(NamedTuple):
    """One sample of a sensor.

    Attributes:
        sensor: index of the sensor among those of the observer.
        stamp: when the value holds, ns; a known delay is subtracted.
        value: the value measured.
    """

    sensor: int
    stamp: int
    value: float


class SampleStream:
    """The received samples, and the verdicts on them.

    Attributes:
        sensors: the sensors whose samples are received.
        waiting: samples that are not in the timeline yet.
        counts: counts of each sensor: ``samples``, ``accepted``, ``rejected`` by its gate,
            ``unused``, ``invalid``, ``dropped`` as too many were waiting, and ``shed`` by a node
            that could not keep up.
        newest: the latest stamp of each sensor, ns; 0 before the first.
        verdicts: verdicts not taken yet.
    """

    def __init__(self, sensors: Sequence[DeclaredSensor]) -> None:
        """Start with no sample."""
        self.sensors = sensors
        self.waiting: deque[EventKey] = deque(maxlen=MOST_KEPT)
        self.counts: list[Counter[str]] = [Counter() for _ in sensors]
        self.newest = [0] * len(sensors)
        self.verdicts: deque[MeasurementVerdict] = deque(maxlen=MOST_VERDICTS)

    def add_samples(self, samples: Iterable[SensorSample]) -> None:
        """Receive samples; a sample that is no number is judged invalid at once."""
        for sensor, stamp, value in samples:
            self.counts[sensor]["samples"] += 1
            if not (abs(value) <= LARGEST_STATE and 0 < stamp <= MAX_STAMP):
                self.counts[sensor]["invalid"] += 1
                if 0 < stamp <= MAX_STAMP:
                    reason = f"{value:g} found; expected a number of at most {LARGEST_STATE:g}"
                    self._note(sensor, stamp, 0.0, SampleOutcome(0.0, -1.0, False, reason))
                continue
            self.newest[sensor] = max(self.newest[sensor], stamp)
            key = EventKey.measured(stamp, sensor, float(value))
            if len(self.waiting) == MOST_KEPT:
                self.counts[self.waiting[0].sensor]["dropped"] += 1
            self.waiting.append(key)

    def judge(self, key: EventKey, outcome: SampleOutcome) -> None:
        """Note the outcome of a sample."""
        kind = "accepted" if outcome.accepted else "unused"
        if outcome.reason.startswith("gate"):
            kind = "rejected"
        self.counts[key.sensor][kind] += 1
        (value,) = key.sample
        self._note(key.sensor, key.stamp, value, outcome)

    def _note(self, sensor: int, stamp: int, value: float, outcome: SampleOutcome) -> None:
        name = self.sensors[sensor].name
        self.verdicts.append(MeasurementVerdict(stamp, name, value, *outcome))

    def clear(self) -> None:
        """Forget all samples, but keep their counts and verdicts."""
        self.waiting.clear()
        self.newest = [0] * len(self.sensors)

    def take(self) -> tuple[MeasurementVerdict, ...]:
        """Return the verdicts since the last call."""
        verdicts = tuple(self.verdicts)
        self.verdicts.clear()
        return verdicts
