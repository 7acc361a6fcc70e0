# SPDX-License-Identifier: Apache-2.0
"""What became of the samples of each sensor in a smoothed motion."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

from impact_observer.model.measurement import Measurement
from impact_observer.smooth.smoother import Smoothed


@dataclass(frozen=True, slots=True)
class SensorSummary:
    """The samples of one sensor in a smoothed motion.

    Attributes:
        sensor: its declaration.
        samples: how many there are from the start of the motion on.
        used: how many of them count.
        rejected: how many the gate rejects; the others are near impacts, or after the last one.
    """

    sensor: Measurement
    samples: int
    used: int
    rejected: int

    @property
    def text(self) -> str:
        """The counts in words."""
        unused = self.samples - self.used - self.rejected
        kinds = {"accepted": self.used, "rejected": self.rejected, "unused": unused}
        words = ", ".join(f"{count} {kind}" for kind, count in kinds.items() if count)
        return f"{self.sensor.name}: {self.samples} samples: {words}"

    @property
    def doubt(self) -> str:
        """The warning that the sensor contradicts impacts and model; empty if it does not."""
        return self.sensor.doubt(self.samples, self.rejected)


def sensor_summaries(motion: Smoothed) -> Iterator[SensorSummary]:
    """What became of the samples of each sensor that has any."""
    arc, readings = motion.arc, motion.arc.samples.readings
    every = Counter(each.sensor.index for each in readings)
    used = Counter(each.sensor.index for each in arc.used_samples(motion.path))
    rejected = Counter(readings[i].sensor.index for i in arc.samples.rejected)
    sensors = {each.sensor.index: each.sensor.measurement for each in readings}
    for index in sorted(sensors):
        yield SensorSummary(sensors[index], every[index], used[index], rejected[index])
