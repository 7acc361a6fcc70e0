# SPDX-License-Identifier: Apache-2.0
"""What became of the samples of each sensor in a smoothed motion."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import sqrt

import numpy as np

from impact_observer.filter.error_correlation import WHITE, ErrorCorrelation
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
        deviation: of the noise, declared or learned, in its unit.
        correlation: of the errors; that of white ones where process noise moves the motion, which
            forgets older samples.
    """

    sensor: Measurement
    samples: int
    used: int
    rejected: int
    deviation: float
    correlation: ErrorCorrelation = WHITE

    @property
    def text(self) -> str:
        """The counts in words."""
        unused = self.samples - self.used - self.rejected
        kinds = {"accepted": self.used, "rejected": self.rejected, "unused": unused}
        words = ", ".join(f"{count} {kind}" for kind, count in kinds.items() if count)
        return f"{self.sensor.name}: {self.samples} samples: {words}"

    @property
    def warnings(self) -> Iterator[str]:
        """What is wrong with the sensor, or with its declaration."""
        doubt = self.sensor.doubt(self.samples, self.rejected, self.deviation)
        return filter(None, (doubt, self.correlation.warning(self.sensor.name)))


def sensor_summaries(motion: Smoothed) -> tuple[SensorSummary, ...]:
    """What became of the samples of each sensor that has any."""
    arc, readings, summaries = motion.arc, motion.arc.samples.readings, list[SensorSummary]()
    flights = range(-1, len(arc.moments))
    is_still = not arc.is_of_robot and not any(arc.noise_after(k) for k in flights)
    errors = arc.sample_errors(motion.path) if readings else []
    for index, sensor in sorted({each.sensor.index: each.sensor for each in readings}.items()):
        every = [each for each in readings if each.sensor.index == index]
        own = [(each, error) for each, error in errors if each.sensor.index == index]
        correlation = WHITE
        if is_still and own:
            rows = np.array([(float(each.t), error, each.value) for each, error in own])
            correlation = ErrorCorrelation.of_errors(*rows.T)
        summaries.append(
            SensorSummary(
                sensor.measurement,
                len(every),
                len(own),
                sum(readings[i].sensor.index == index for i in arc.samples.rejected),
                sqrt(every[0].known.variance),
                correlation,
            )
        )
    return tuple(summaries)
