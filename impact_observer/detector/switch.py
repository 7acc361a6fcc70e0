# SPDX-License-Identifier: Apache-2.0
"""A contact switch: debounced edges; long closures are persistent contact."""

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


class SwitchSensor(Sensor):
    """A signal that is high while the contact is closed, or low if the switch is inverted.

    The rising edge is an IMPACT, at once. If the switch is still closed after
    ``min_contact_duration``, a CLOSE with the stamp of that edge supersedes the IMPACT, and the
    falling edge is an OPEN. A shorter closure is an IMPACT only.

    Debouncing: the level is held for ``dead_time`` after an edge. If the signal differs at the end
    of the dead time, the signal's last change is the next edge. So chatter up to the dead time is
    one edge with the stamp of the first change. A change that begins and ends in the dead time is
    ignored.
    """

    def __init__(
        self, source: Source, counts: SensorCounts, trace: SignalTrace | None = None
    ) -> None:
        """Begin with an open contact."""
        super().__init__(source, counts, trace)
        self._high = source.number("threshold")
        self._low = self._high - source.number("hysteresis")
        self._inverted = bool(source.inverted)
        self._dead_time = source.number("dead_time")
        self._duration = source.number("min_contact_duration")
        self._level = self._inverted
        self._input_closed = self._closed = self._persistent = False
        self._has_edge = False
        self._input_changed = self._edge = SampleTime(0, 0)

    def feed(self, sample: Sample) -> list[DetectedSwitch]:
        """Returns the switches that a sample decides.

        Raises:
            UsageError: the field is a vector.
        """
        time, switches = sample.time, []
        value = self._source.scalar(sample.values)
        while (deadline := self._deadline()) is not None and deadline.stamp <= time.stamp:
            switches += self._on_deadline(time.received)
        if self._trace is not None:
            self._trace.stamps.append(time.stamp)
            self._trace.signal.append(value)
        self._level = value >= (self._low if self._level else self._high)
        closed = self._level != self._inverted
        if closed != self._input_closed:
            self._input_closed, self._input_changed = closed, time
            dead_until = self._edge.later_by(self._dead_time).stamp if self._has_edge else 0
            if time.stamp >= dead_until:
                switches += self._follow_input(time.received)
            elif closed == self._closed:
                self._suppress(time.stamp)
        return switches

    def _suppress(self, stamp: int) -> None:
        """Count a change that began and ends in the dead time, ns."""
        self._counts.suppressed += 1
        if self._trace is not None:
            self._trace.suppressed.append(stamp)

    def _deadline(self) -> SampleTime | None:
        """Returns the end of the dead time, or of the shortest persistent contact."""
        if self._input_closed != self._closed:
            return self._edge.later_by(self._dead_time)
        if self._closed and not self._persistent:
            return self._edge.later_by(self._duration)
        return None

    def _on_deadline(self, decided: int) -> list[DetectedSwitch]:
        """End the chatter, or begin persistent contact, as the deadline is over."""
        if self._input_closed != self._closed:
            return self._follow_input(decided)
        self._persistent = True
        return [DetectedSwitch(decided, self._edge.stamp, Kind.CLOSE)]

    def _follow_input(self, decided: int) -> list[DetectedSwitch]:
        """Make an edge at the last change of the input."""
        again = self._has_edge and self._input_closed
        dead_until = self._edge.later_by(self._dead_time).stamp
        self._counts.short_releases += again and self._input_changed.stamp <= dead_until
        self._closed, self._edge, self._has_edge = self._input_closed, self._input_changed, True
        if self._trace is not None:
            end = self._edge.later_by(self._dead_time).stamp
            self._trace.dead.append((self._edge.stamp, end))
            self._trace.impacts += [self._edge.stamp] if self._closed else []
        if not self._closed:
            was_persistent, self._persistent = self._persistent, False
            return [DetectedSwitch(decided, self._edge.stamp, Kind.OPEN)] if was_persistent else []
        self._persistent = self._duration == 0
        kind = Kind.CLOSE if self._persistent else Kind.IMPACT
        return [DetectedSwitch(decided, self._edge.stamp, kind)]
