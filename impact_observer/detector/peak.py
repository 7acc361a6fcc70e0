# SPDX-License-Identifier: Apache-2.0
"""A signal with a peak at each impact: acceleration, force, sound."""

import math
from collections import deque
from dataclasses import dataclass

from impact_observer.detector.sensors import (
    DetectedSwitch,
    Sample,
    SampleTime,
    Sensor,
    SensorCounts,
    SignalTrace,
)
from impact_observer.detector.source import Source
from impact_observer.events import Kind
from impact_observer.stamps import from_seconds, seconds_between

Point = tuple[int, float]
"""A stamp (ns) and the signal there."""


RINGING = 1.5
"""A peak in a dead time is no ringing if it is so many times higher than the peaks before it."""
_RECENT = 4
"""Peaks, or samples of a flat signal, with which a peak in a dead time is compared."""


@dataclass(slots=True)
class _Top:
    """The top of a signal, as its samples come: the first sample with the largest value.

    The samples beside the top are ``left`` and ``right``; ``right`` is None before it has come.
    ``last`` is the stamp of the last equal sample in a row, as at the limit of a range.
    """

    top: Point
    last: int
    left: Point
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
        """Returns the stamp of the top, ns."""
        if self.last > self.top[0]:
            return (self.top[0] + self.last) // 2
        if self.right is None:
            return self.top[0]
        return self.top[0] + vertex(self.left, self.top, self.right)


@dataclass(slots=True)
class _Peak:
    """The signal since it exceeded the threshold: the top of the whole peak, and the first top.

    The first top is that of the field times its ``sign`` at the begin; of a vector the sign is 1.
    """

    begin: SampleTime
    sign: float
    whole: _Top
    first: _Top

    def extend(self, before: Point, point: Point, field_before: float, field: float) -> None:
        """Take the next sample ``point`` with the ``field``, whose predecessor was ``before``."""
        self.whole.extend(before, point)
        if self.first.right is None:
            left = (before[0], field_before * self.sign)
            self.first.extend(left, (point[0], field * self.sign))


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
    again, or ``dead_time`` after it began. No other peak begins within ``dead_time`` of the top.
    With a ``decay`` the threshold is the root of the squares of the declared one and of the
    ringing: ``RINGING`` times the highest sample since a peak began, which falls with that time
    constant.
    The stamp is that of the top, or of the onset: the first top after the signal reached the
    threshold, without a change of sign in between.
    """

    def __init__(
        self, source: Source, counts: SensorCounts, trace: SignalTrace | None = None
    ) -> None:
        """A signal that is above the threshold from its first sample on is no peak."""
        super().__init__(source, counts, trace)
        self._high = source.number("threshold")
        self._low = self._high - source.number("hysteresis")
        self._dead_time = source.number("dead_time")
        self._decay = source.number("decay")
        self._loudest: Point = (0, 0.0)
        self._baseline = source.number("baseline")
        self._mean: tuple[float, ...] = ()
        self._before: Point | None = None
        self._field_before = 0.0
        self._peak: _Peak | None = None
        self._armed = False
        self._dead_until = 0
        self._recent = deque[Point](maxlen=_RECENT)
        self._is_rising = self._is_suppressing = False

    def feed(self, sample: Sample) -> list[DetectedSwitch]:
        """Returns the switches that a sample decides.

        Raises:
            UsageError: the field is a vector, and the direction is up or down.
        """
        time, switches = sample.time, []
        point, field = (time.stamp, self._signal(sample)), self._field(sample)
        before = self._before or point
        self._counts.largest_signal = max(self._counts.largest_signal, point[1])
        if self._trace is not None:
            self._trace.stamps.append(time.stamp)
            self._trace.signal.append(point[1])
        if (deadline := self._deadline()) is not None and deadline.stamp <= time.stamp:
            switches = self._on_deadline(time.received)
        self._note_ringing(before, point)
        scale = self._ringing(point)
        if self._peak is not None:
            self._peak.extend(before, point, self._field_before, field)
            if point[1] < self._low:
                switches += self._on_deadline(time.received)
        elif point[1] >= scale * self._high and self._armed and time.stamp >= self._dead_until:
            self._peak, self._loudest = self._begin(time, before, point, field), point
        is_low, is_high = (point[1] < scale * each for each in (self._low, self._high))
        self._armed = is_low or (self._armed and is_high)
        if self._baseline and self._peak is None:  # a peak would shift the mean
            since = 0 if self._before is None else time.stamp - self._before[0]
            weight = -math.expm1(-seconds_between(0, since) / self._baseline)
            rest = self._without_mean(sample)
            self._mean = tuple(m + weight * r for m, r in zip(self._mean, rest, strict=True))
        self._before, self._field_before = point, field
        return switches

    def _begin(self, time: SampleTime, before: Point, point: Point, field: float) -> _Peak:
        """Returns the peak that begins with a sample, which is never the first one."""
        sign = math.copysign(1.0, field)
        first = _Top((point[0], field * sign), point[0], (before[0], self._field_before * sign))
        return _Peak(time, sign, _Top(point, time.stamp, before), first)

    def _ringing(self, point: Point) -> float:
        """Returns the threshold at a sample, over the declared one."""
        if not self._decay:
            return 1.0
        left = self._loudest[1] * math.exp(
            -seconds_between(self._loudest[0], point[0]) / self._decay
        )
        if (self._peak is not None or point[0] < self._dead_until) and point[1] > left:
            self._loudest, left = point, point[1]
        return math.hypot(1.0, RINGING * left / self._high)

    def _note_ringing(self, before: Point, point: Point) -> None:
        """Count a peak in the dead time that is higher than the ringing."""
        if point[1] == before[1] or (self._is_rising and point[1] < before[1]):
            self._recent.append(before)
        self._is_rising = point[1] > before[1] or (self._is_rising and point[1] == before[1])
        if self._peak is not None or not before[0] < self._dead_until:
            return
        loudest = max((value for _, value in self._recent), default=0.0)
        is_dead = point[0] < self._dead_until
        is_high = point[1] >= self._high and point[1] > RINGING * loudest
        if is_dead and is_high and not self._is_suppressing:
            self._is_suppressing = True
            self._counts.suppressed += 1
            if self._trace is not None:
                self._trace.suppressed.append(point[0])
        self._is_suppressing = self._is_suppressing and point[1] >= self._low

    def _field(self, sample: Sample) -> float:
        """Returns the number with its sign; of a vector the norm."""
        values = self._without_mean(sample) if self._baseline else sample.values
        return values[0] if len(values) == 1 else math.hypot(*values)

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
        return self._peak.begin.later_by(self._dead_time)

    def _on_deadline(self, decided: int) -> list[DetectedSwitch]:
        """End the peak; returns its IMPACT."""
        assert self._peak is not None
        peak, self._peak = self._peak, None
        top, onset = peak.whole.instant(), peak.first.instant()
        dead_time = from_seconds(self._dead_time)
        self._dead_until = top + dead_time
        stamp = onset if self._source.instant == "onset" else top
        self._counts.rises += stamp - peak.begin.stamp
        if self._trace is not None:
            self._trace.impacts.append(stamp)
            self._trace.dead.append((top, self._dead_until))
        return [DetectedSwitch(decided, stamp, Kind.IMPACT)]
