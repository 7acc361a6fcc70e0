# SPDX-License-Identifier: Apache-2.0
"""A signal with a peak at each impact: acceleration, force, sound."""

import math
from dataclasses import dataclass

from impact_observer.detector.sensors import DetectedSwitch, Sample, SampleTime, Sensor
from impact_observer.detector.source import Source
from impact_observer.events import Kind
from impact_observer.stamps import from_seconds, seconds_between

Point = tuple[int, float]
"""A stamp (ns) and the signal there."""


@dataclass(slots=True)
class _Peak:
    """The signal since it exceeded the threshold.

    Attributes:
        onset: the time at which the signal exceeded the threshold.
        top: the first sample with the largest value.
        last: stamp of the last sample in a row with the largest value, as at the limit of the
            sensor's range.
        left: the sample before the top; None if there was none.
        right: the sample after the top; None before it is received.
    """

    onset: SampleTime
    top: Point
    last: int
    left: Point | None
    right: Point | None = None

    def extend(self, before: Point, point: Point) -> None:
        """Take the next sample ``point``, whose predecessor was ``before``."""
        if point[1] > self.top[1]:
            self.top, self.last, self.left, self.right = point, point[0], before, None
        elif self.right is None and point[1] == self.top[1]:
            self.last = point[0]
        elif self.right is None:
            self.right = point

    def instant(self) -> int:
        """Returns the stamp of the peak, ns."""
        if self.last > self.top[0]:
            return (self.top[0] + self.last) // 2
        if self.left is None or self.right is None:
            return self.top[0]
        return self.top[0] + vertex(self.left, self.top, self.right)


def vertex(left: Point, top: Point, right: Point) -> int:
    """Returns the vertex of the parabola through three points, ns after ``top``.

    For ``cos(w t)``, sampled every ``h``, the error is at most ``w^2 h^2 / 62`` samples, to
    leading order; for a half-sine of ten samples this is 0.0016 of a sample.
    """
    a, b = float(top[0] - left[0]), float(right[0] - top[0])
    if a <= 0 or b <= 0:
        return 0
    up, down = (top[1] - left[1]) / a, (right[1] - top[1]) / b
    if not up > down:
        return 0
    # The slope is `up` in the middle of the first interval and `down` in that of the second.
    return round(-a / 2 + (a + b) / 2 * up / (up - down))


class PeakSensor(Sensor):
    """An IMPACT at each peak of a signal, interpolated between samples.

    A peak begins when the signal reaches the threshold after the signal was below
    ``threshold - hysteresis``. The peak ends when the signal is below ``threshold - hysteresis``
    again, or ``dead_time`` after the onset. No other peak begins within ``dead_time`` of the top.
    """

    def __init__(self, source: Source) -> None:
        """A signal that is above the threshold from its first sample on is no peak."""
        super().__init__(source)
        self._high = source.number("threshold")
        self._low = self._high - source.number("hysteresis")
        self._dead_time = source.number("dead_time")
        self._baseline = source.number("baseline")
        self._mean: tuple[float, ...] = ()
        self._before: Point | None = None
        self._peak: _Peak | None = None
        self._armed = False
        self._dead_until = 0

    def feed(self, sample: Sample) -> list[DetectedSwitch]:
        """Returns the switches that a sample decides.

        Raises:
            UsageError: the field is a vector, and the direction is up or down.
        """
        time, switches = sample.time, []
        point = (time.stamp, self._signal(sample))
        self.largest_signal = max(self.largest_signal, point[1])
        if (deadline := self._deadline()) is not None and deadline.stamp <= time.stamp:
            switches = self._on_deadline(time.received)
        if self._peak is not None:
            self._peak.extend(self._before or point, point)
            if point[1] < self._low:
                switches += self._on_deadline(time.received)
        elif point[1] >= self._high and self._armed and time.stamp >= self._dead_until:
            self._peak = _Peak(time, point, time.stamp, self._before)
        self._armed = point[1] < self._low or (self._armed and point[1] < self._high)
        if self._baseline and self._peak is None:  # a peak would shift the mean
            since = 0 if self._before is None else time.stamp - self._before[0]
            weight = -math.expm1(-seconds_between(0, since) / self._baseline)
            rest = self._without_mean(sample)
            self._mean = tuple(m + weight * r for m, r in zip(self._mean, rest, strict=True))
        self._before = point
        return switches

    def _signal(self, sample: Sample) -> float:
        """Returns the number that is compared with the threshold."""
        values = self._without_mean(sample) if self._baseline else sample.values
        if self._source.direction == "both":
            return math.hypot(*values)
        value = self._source.scalar(values)
        return value if self._source.direction == "up" else -value

    def _without_mean(self, sample: Sample) -> tuple[float, ...]:
        """Returns the values minus their running mean, which starts at the first sample.

        The mean is a first-order low pass with the time constant ``baseline``.
        """
        if len(self._mean) != len(sample.values):
            self._mean = sample.values
        return tuple(x - m for x, m in zip(sample.values, self._mean, strict=True))

    def _deadline(self) -> SampleTime | None:
        """Returns the time at which a peak ends even if the signal stays high."""
        if self._peak is None or self._dead_time == 0:
            return None
        return self._peak.onset.later_by(self._dead_time)

    def _on_deadline(self, decided: int) -> list[DetectedSwitch]:
        """End the peak; returns its IMPACT."""
        assert self._peak is not None
        stamp, self._peak = self._peak.instant(), None
        self._dead_until = stamp + from_seconds(self._dead_time)
        return [DetectedSwitch(decided, stamp, Kind.IMPACT)]
