"""A signal with a peak at each impact: acceleration, force, sound."""

import math
from dataclasses import dataclass

from impact_observer.detector.sensors import DetectedInstant, Found, Sample, due
from impact_observer.detector.source import Source
from impact_observer.events import Kind
from impact_observer.stamps import from_seconds, seconds_between

Point = tuple[int, float]
"""A stamp (ns) and the signal there."""


@dataclass(slots=True)
class _Hill:
    """The signal since it rose above the threshold.

    Attributes:
        onset: when it did.
        top: its largest value, with the first stamp that has it.
        last: the last stamp of a row that has it, as where the sensor is at its limit.
        left: the sample before the top; None when there was none.
        right: the sample after the top; None as long as there is none.
    """

    onset: DetectedInstant
    top: Point
    last: int
    left: Point | None
    right: Point | None = None

    def add(self, before: Point, point: Point) -> None:
        """Go on with ``point``, which comes after ``before``."""
        if point[1] > self.top[1]:
            self.top, self.last, self.left, self.right = point, point[0], before, None
        elif self.right is None and point[1] == self.top[1]:
            self.last = point[0]
        elif self.right is None:
            self.right = point

    def instant(self) -> int:
        """Stamp of the peak, ns."""
        if self.last > self.top[0]:
            return (self.top[0] + self.last) // 2
        if self.left is None or self.right is None:
            return self.top[0]
        return self.top[0] + vertex(self.left, self.top, self.right)


def vertex(left: Point, top: Point, right: Point) -> int:
    """Where the parabola through three points has its top, ns after ``top``.

    Of ``cos(w t)``, sampled every ``h``, the top is missed by at most ``w^2 h^2 / 62`` samples, to
    leading order: with a half-sine of ten samples by 0.0016 of one.
    """
    a, b = float(top[0] - left[0]), float(right[0] - top[0])
    if a <= 0 or b <= 0:
        return 0
    up, down = (top[1] - left[1]) / a, (right[1] - top[1]) / b
    if not up > down:
        return 0
    # The slope is up in the middle of the one interval, down in that of the other.
    return round(-a / 2 + (a + b) / 2 * up / (up - down))


class PeakSensor:
    """An IMPACT at each peak of a signal, interpolated between samples.

    A peak begins where the signal reaches the threshold from below ``threshold - hysteresis``,
    and is known when it has fallen below that, or ``dead_time`` after it began. Nothing that rises
    within ``dead_time`` of a peak is another one.

    Attributes:
        highest: the largest value so far.
    """

    def __init__(self, source: Source) -> None:
        """Before the first sample nothing is known: a signal that begins above is no peak."""
        self._source = source
        self._high = source.number("threshold")
        self._low = self._high - source.number("hysteresis")
        self._dead_time = source.number("dead_time")
        self._baseline = source.number("baseline")
        self.highest = 0.0
        self._mean: tuple[float, ...] = ()
        self._before: Point | None = None
        self._hill: _Hill | None = None
        self._armed = False
        self._dead_until = 0

    @property
    def due(self) -> int | None:
        """See :class:`~impact_observer.detector.sensors.Sensor`."""
        return due(self._deadline())

    def feed(self, sample: Sample) -> list[Found]:
        """See :class:`~impact_observer.detector.sensors.Sensor`.

        Raises:
            UsageError: a vector has no direction up or down.
        """
        moment, found = sample.moment, []
        point = (moment.stamp, self._signal(sample))
        self.highest = max(self.highest, point[1])
        if (deadline := self._deadline()) is not None and deadline.stamp <= moment.stamp:
            found = self._finish(moment.arrival)
        if self._hill is not None:
            self._hill.add(self._before or point, point)
            if point[1] < self._low:
                found += self._finish(moment.arrival)
        elif point[1] >= self._high and self._armed and moment.stamp >= self._dead_until:
            self._hill = _Hill(moment, point, moment.stamp, self._before)
        self._armed = point[1] < self._low or (self._armed and point[1] < self._high)
        if self._baseline and self._hill is None:
            self._follow(sample)
        self._before = point
        return found

    def silent(self, now: int) -> list[Found]:
        """See :class:`~impact_observer.detector.sensors.Sensor`."""
        at = self.due
        return [] if at is None or at > now else self._finish(at)

    def _signal(self, sample: Sample) -> float:
        """What is compared with the threshold."""
        values = sample.values
        if self._baseline:
            values = self._rest(sample)
        if self._source.direction == "both":
            return math.hypot(*values)
        value = self._source.scalar(values)
        return value if self._source.direction == "up" else -value

    def _rest(self, sample: Sample) -> tuple[float, ...]:
        """The values less their mean until then, which starts with the first sample."""
        if len(self._mean) != len(sample.values):
            self._mean = sample.values
        return tuple(x - m for x, m in zip(sample.values, self._mean, strict=True))

    def _follow(self, sample: Sample) -> None:
        """Let the mean go on: not on a hill, where it would move the top."""
        since = 0 if self._before is None else sample.moment.stamp - self._before[0]
        weight = -math.expm1(-seconds_between(0, since) / self._baseline)
        rest = self._rest(sample)
        self._mean = tuple(m + weight * r for m, r in zip(self._mean, rest, strict=True))

    def _deadline(self) -> DetectedInstant | None:
        """When a peak is over though the signal stays high."""
        if self._hill is None or self._dead_time == 0:
            return None
        return self._hill.onset.after(self._dead_time)

    def _finish(self, at: int) -> list[Found]:
        """The peak is known."""
        assert self._hill is not None
        stamp, self._hill = self._hill.instant(), None
        self._dead_until = stamp + from_seconds(self._dead_time)
        return [Found(at, stamp, Kind.IMPACT)]
