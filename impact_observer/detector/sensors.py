# SPDX-License-Identifier: Apache-2.0
"""What all kinds of sensors have in common, and the simplest kind."""

from abc import ABC, abstractmethod
from typing import NamedTuple

from impact_observer.detector.source import Source
from impact_observer.events import Kind
from impact_observer.stamps import from_seconds

MAX_DELAY = 20_000_000
"""How long a message may take from the sensor to here, ns. Only when this time is over, too, does
the absence of a sample decide something."""


class SampleTime(NamedTuple):
    """The time of a sample, by two clocks.

    Attributes:
        received: when the message was received, ns.
        stamp: when it was measured, ns; ``received`` where the message has no stamp.
    """

    received: int
    stamp: int

    def after(self, seconds: float) -> "SampleTime":
        """So many seconds later."""
        length = from_seconds(seconds)
        return SampleTime(self.received + length, self.stamp + length)


class Sample(NamedTuple):
    """What one message holds.

    Attributes:
        time: of the message.
        values: the number of the field, or the components of a vector; empty for a sensor without
            a field.
    """

    time: SampleTime
    values: tuple[float, ...] = ()


class DetectedSwitch(NamedTuple):
    """A switch of a sensor's contact.

    Attributes:
        decided: when it was certain, on the clock of reception, ns.
        stamp: when it happened, before the latency is subtracted, ns.
        kind: IMPACT, CLOSE or OPEN.
    """

    decided: int
    stamp: int
    kind: Kind


class Sensor(ABC):
    """Detects the switches in one stream of samples, whose stamps never go back.

    Attributes:
        largest_signal: of all samples; 0 where no signal is compared with a threshold.
    """

    def __init__(self, source: Source) -> None:
        """Detect by what ``source`` declares."""
        self._source = source
        self.largest_signal = 0.0

    @property
    def due(self) -> int | None:
        """From when on (received, ns) the absence of samples decides something; None for never."""
        deadline = self._deadline()
        return None if deadline is None else deadline.received + MAX_DELAY

    @abstractmethod
    def feed(self, sample: Sample) -> list[DetectedSwitch]:
        """The switches that a sample decides, and the time up to it."""

    def advance(self, now: int) -> list[DetectedSwitch]:
        """The switches that are decided if no sample is received until ``now``, ns."""
        switches = []
        while (decided := self.due) is not None and decided <= now:
            switches += self._on_deadline(decided)
        return switches

    def _deadline(self) -> SampleTime | None:
        """The time that decides something, if no sample before it follows."""
        return None

    def _on_deadline(self, decided: int) -> list[DetectedSwitch]:
        """The switches that the deadline decides; never called without a ``_deadline``."""
        raise AssertionError(f"deadline at {decided}, but {type(self).__name__} has none")


class ArrivalSensor(Sensor):
    """A sensor that publishes one message at each impact; what it holds does not matter.

    Each message is an IMPACT, except within ``dead_time`` after an impact.
    """

    def __init__(self, source: Source) -> None:
        super().__init__(source)
        self._dead_time = from_seconds(source.number("dead_time"))
        self._dead_until = 0

    def feed(self, sample: Sample) -> list[DetectedSwitch]:
        """See :class:`Sensor`."""
        time = sample.time
        if time.stamp < self._dead_until:
            return []
        self._dead_until = time.stamp + self._dead_time
        return [DetectedSwitch(time.received, time.stamp, Kind.IMPACT)]
