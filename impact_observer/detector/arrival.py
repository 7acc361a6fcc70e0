"""A sensor that publishes one message at each impact; what the message holds does not matter."""

from impact_observer.detector.sensors import DetectedSwitch, Sample
from impact_observer.detector.source import Source
from impact_observer.events import Kind
from impact_observer.stamps import from_seconds


class ArrivalSensor:
    """An IMPACT at each message, except within ``dead_time`` after an impact.

    Attributes:
        due: always None, since time without messages decides nothing.
    """

    due: int | None = None

    def __init__(self, source: Source) -> None:
        self._dead_time = from_seconds(source.number("dead_time"))
        self._dead_until = 0

    def feed(self, sample: Sample) -> list[DetectedSwitch]:
        """See :class:`~impact_observer.detector.sensors.Sensor`."""
        time = sample.time
        if time.stamp < self._dead_until:
            return []
        self._dead_until = time.stamp + self._dead_time
        return [DetectedSwitch(time.received, time.stamp, Kind.IMPACT)]

    def advance(self, _: int) -> list[DetectedSwitch]:
        """See :class:`~impact_observer.detector.sensors.Sensor`."""
        return []
