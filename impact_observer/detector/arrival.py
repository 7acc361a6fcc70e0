"""Messages whose arrival is the event."""

from impact_observer.detector.sensors import Found, Sample
from impact_observer.detector.source import Source
from impact_observer.events import Kind
from impact_observer.stamps import from_seconds


class ArrivalSensor:
    """An IMPACT at each message, but for those within ``dead_time`` of the last one."""

    def __init__(self, source: Source) -> None:
        self._dead_time = from_seconds(source.number("dead_time"))
        self._dead_until = 0

    @property
    def due(self) -> int | None:
        """Silence says nothing."""
        return None

    def feed(self, sample: Sample) -> list[Found]:
        """See :class:`~impact_observer.detector.sensors.Sensor`."""
        moment = sample.moment
        if moment.stamp < self._dead_until:
            return []
        self._dead_until = moment.stamp + self._dead_time
        return [Found(moment.arrival, moment.stamp, Kind.IMPACT)]

    def silent(self, _: int) -> list[Found]:
        """Silence says nothing."""
        return []
