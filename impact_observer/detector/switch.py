"""A contact switch: edges, freed of chatter, and contacts that last told from hits."""

from impact_observer.detector.sensors import DetectedInstant, Found, Sample, due
from impact_observer.detector.source import Source
from impact_observer.events import Kind


class SwitchSensor:
    """A signal that is high while the contact is closed, or low where it is inverted.

    The rising edge is an IMPACT, at once. When the switch is still closed after
    ``min_contact_duration``, a CLOSE with the very stamp of that edge supersedes it, and the
    falling edge is an OPEN. A shorter closure is the IMPACT only.

    For ``dead_time`` after an edge nothing changes; what holds at its end counts from when it
    began. So chatter of any length up to the dead time is one edge, with the first one's stamp,
    and what is shorter than the dead time and begins within it is passed over.
    """

    def __init__(self, source: Source) -> None:
        """Before the first sample the contact is taken to be open."""
        self._source = source
        self._high = source.number("threshold")
        self._low = self._high - source.number("hysteresis")
        self._inverted = bool(source.inverted)
        self._dead_time = source.number("dead_time")
        self._duration = source.number("min_contact_duration")
        self._level = self._inverted
        self._raw = False
        self._closed = False
        self._lasts = False
        self._changed = self._edge = DetectedInstant(0, 0)
        self._resting = False

    @property
    def due(self) -> int | None:
        """See :class:`~impact_observer.detector.sensors.Sensor`."""
        return due(self._deadline())

    def feed(self, sample: Sample) -> list[Found]:
        """See :class:`~impact_observer.detector.sensors.Sensor`.

        Raises:
            UsageError: the field is a vector.
        """
        moment, found = sample.moment, []
        value = self._source.scalar(sample.values)
        while (deadline := self._deadline()) is not None and deadline.stamp <= moment.stamp:
            found += self._pass(moment.arrival)
        self._level = value >= (self._low if self._level else self._high)
        raw = self._level != self._inverted
        if raw != self._raw:
            self._raw, self._changed = raw, moment
            if not self._is_dead(moment):
                found += self._accept(moment.arrival)
        return found

    def silent(self, now: int) -> list[Found]:
        """See :class:`~impact_observer.detector.sensors.Sensor`."""
        found = []
        while (at := self.due) is not None and at <= now:
            found += self._pass(at)
        return found

    def _is_dead(self, moment: DetectedInstant) -> bool:
        """Whether the last edge is too fresh for another one."""
        return self._resting and moment.stamp < self._edge.after(self._dead_time).stamp

    def _deadline(self) -> DetectedInstant | None:
        """When the passing of time decides something."""
        if self._raw != self._closed:
            return self._edge.after(self._dead_time)
        if self._closed and not self._lasts:
            return self._edge.after(self._duration)
        return None

    def _pass(self, at: int) -> list[Found]:
        """The deadline is over: chatter has ended, or the contact lasts."""
        if self._raw != self._closed:
            return self._accept(at)
        self._lasts = True
        return [Found(at, self._edge.stamp, Kind.CLOSE)]

    def _accept(self, at: int) -> list[Found]:
        """What the switch says has been so since it last changed."""
        self._closed, self._edge, self._resting = self._raw, self._changed, True
        if not self._closed:
            lasted, self._lasts = self._lasts, False
            return [Found(at, self._edge.stamp, Kind.OPEN)] if lasted else []
        self._lasts = self._duration == 0
        kind = Kind.CLOSE if self._lasts else Kind.IMPACT
        return [Found(at, self._edge.stamp, kind)]
