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
    """The time of a sample, by two clocks.

    Attributes:
        received: when the message was received, ns.
        stamp: when it was measured, ns; ``received`` where the message has no stamp.
    """

    received: int
    stamp: int

    def later_by(self, seconds: float) -> "SampleTime":
        """Returns the time ``seconds`` later, s."""
        length = from_seconds(seconds)
        return SampleTime(self.received + length, self.stamp + length)


class Sample(NamedTuple):
    """The time and the numbers of one message.

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
        decided: the time on the clock of reception at which the switch was certain, ns.
        stamp: the instant of the switch, before the latency is subtracted, ns.
        kind: IMPACT, CLOSE or OPEN.
    """

    decided: int
    stamp: int
    kind: Kind


@dataclass(slots=True)
class DeadTimes:
    """What lay in the dead times of a sensor.

    Attributes:
        suppressed: peaks, edges or messages in a dead time, which are no impacts. A peak is one
            that is higher than the ringing before it.
        short_releases: of a switch, from an opening to the next closing, no longer than the dead
            time.
        rises: from where peaks reached the threshold to their stamps, ns, added up.
    """

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
    """Detects the switches in one stream of samples, whose stamps never go back.

    Attributes:
        largest_signal: of all samples; 0 where no signal is compared with a threshold.
        dead_times: what lay in the dead times.
        trace: the signal; None where no picture is wanted.
    """

    def __init__(self, source: Source) -> None:
        """Make the sensor that ``source`` declares."""
        self._source = source
        self.largest_signal = 0.0
        self.dead_times = DeadTimes()
        self.trace: SignalTrace | None = None

    @property
    def due(self) -> int | None:
        """The time of reception from which on the absence of samples decides something, ns.

        None means that the absence of samples decides nothing.
        """
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

    def __init__(self, source: Source) -> None:
        super().__init__(source)
        self._dead_time = from_seconds(source.number("dead_time"))
        self._dead_until = 0

    def feed(self, sample: Sample) -> list[DetectedSwitch]:
        """Returns the IMPACT of a message outside the dead time."""
        time = sample.time
        if time.stamp < self._dead_until:
            self.dead_times.suppressed += 1
            return []
        self._dead_until = time.stamp + self._dead_time
        return [DetectedSwitch(time.received, time.stamp, Kind.IMPACT)]
