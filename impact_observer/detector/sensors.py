# SPDX-License-Identifier: Apache-2.0
"""The base class of all kinds of sensors, and the simplest kind."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import NamedTuple

from impact_observer.detector.source import Source
from impact_observer.events import Kind
from impact_observer.stamps import from_seconds

MAX_DELAY = 20_000_000
"""The longest time that a message takes from the sensor to the detector, ns.

The absence of a sample decides something only when this time is over, too.
"""


class SampleTime(NamedTuple):
    """When a message was received, and when it was measured, ns; equal without a stamp."""

    received: int
    stamp: int

    def later_by(self, seconds: float) -> "SampleTime":
        """Returns the time ``seconds`` later, s."""
        length = from_seconds(seconds)
        return SampleTime(self.received + length, self.stamp + length)


class Sample(NamedTuple):
    """The time and the numbers of one message: of a vector its components; maybe none."""

    time: SampleTime
    values: tuple[float, ...] = ()


class DetectedSwitch(NamedTuple):
    """A switch of a sensor's contact.

    Attributes:
        decided: the time on the clock of reception at which the switch was certain, ns.
        stamp: the instant of the switch, before the latency is subtracted, ns.
        kind: IMPACT, CLOSE or OPEN.
    """

    decided: int
    stamp: int
    kind: Kind


@dataclass(slots=True)
class SensorCounts:
    """Counts of the messages of one source, and of the events detected in them.

    Attributes:
        messages: received.
        impacts: how often the contact closed.
        closings: how often persistent contact began.
        openings: how often persistent contact ended.
        invalid: messages with a number that is not finite, without the field or the stamp, or
            with a stamp that no event may have.
        out_of_order: messages with a stamp before that of an earlier one.
        last_event: stamp of the last event, ns; 0 before the first.
        largest_signal: of a peak source, in the field's own unit.
        suppressed: peaks, edges or messages in a dead time, which are no impacts. A peak is one
            that is higher than the ringing before it.
        short_releases: of a switch, from an opening to the next closing, no longer than the dead
            time.
        rises: from where peaks reached the threshold to their stamps, ns, added up.
    """

    messages: int = 0
    impacts: int = 0
    closings: int = 0
    openings: int = 0
    invalid: int = 0
    out_of_order: int = 0
    last_event: int = 0
    largest_signal: float = 0.0
    suppressed: int = 0
    short_releases: int = 0
    rises: int = 0


@dataclass(slots=True)
class SignalTrace:
    """The signal of a sensor as its threshold sees it, kept for a picture.

    Attributes:
        stamps: of the samples, ns.
        signal: at these stamps, in the field's own unit.
        dead: stamps at which dead times begin and end, ns.
        impacts: stamps of impacts before the latency is subtracted, ns.
        suppressed: stamps of what was suppressed, ns.
    """

    stamps: list[int] = field(default_factory=list)
    signal: list[float] = field(default_factory=list)
    dead: list[tuple[int, int]] = field(default_factory=list)
    impacts: list[int] = field(default_factory=list)
    suppressed: list[int] = field(default_factory=list)


class Sensor(ABC):
    """Detects the switches in one stream of samples, whose stamps never go back."""

    def __init__(
        self, source: Source, counts: SensorCounts, trace: SignalTrace | None = None
    ) -> None:
        """The sensor that ``source`` declares; ``counts`` go on, and the ``trace`` if wanted."""
        self._source, self._counts, self._trace = source, counts, trace

    @property
    def due(self) -> int | None:
        """The time of reception from which on the absence of samples decides something, ns."""
        deadline = self._deadline()
        return None if deadline is None else deadline.received + MAX_DELAY

    @abstractmethod
    def feed(self, sample: Sample) -> list[DetectedSwitch]:
        """Returns the switches that a sample and the time up to this sample decide."""

    def advance(self, now: int) -> list[DetectedSwitch]:
        """Returns the switches that are decided if no sample is received until ``now``, ns."""
        switches = []
        while (decided := self.due) is not None and decided <= now:
            switches += self._on_deadline(decided)
        return switches

    def _deadline(self) -> SampleTime | None:
        """Returns the time that decides something if no earlier sample follows."""
        return None

    def _on_deadline(self, decided: int) -> list[DetectedSwitch]:
        """Returns the switches that the deadline decides."""
        raise AssertionError(f"deadline at {decided}, but {type(self).__name__} has none")


class ArrivalSensor(Sensor):
    """A sensor that publishes one message of any content at each impact.

    Each message is an IMPACT, except within ``dead_time`` after an impact.
    """

    def __init__(
        self, source: Source, counts: SensorCounts, trace: SignalTrace | None = None
    ) -> None:
        super().__init__(source, counts, trace)
        self._dead_time = from_seconds(source.number("dead_time"))
        self._dead_until = 0

    def feed(self, sample: Sample) -> list[DetectedSwitch]:
        """Returns the IMPACT of a message outside the dead time."""
        time = sample.time
        if time.stamp < self._dead_until:
            self._counts.suppressed += 1
            return []
        self._dead_until = time.stamp + self._dead_time
        return [DetectedSwitch(time.received, time.stamp, Kind.IMPACT)]
