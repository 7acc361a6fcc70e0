"""What all kinds of sensors have in common: samples in, switchings out."""

from typing import NamedTuple, Protocol

from impact_observer.events import Kind
from impact_observer.stamps import from_seconds

PATIENCE = 20_000_000
"""How long a message may be on its way, ns: silence is believed only when it is older."""


class DetectedInstant(NamedTuple):
    """An instant, by both clocks.

    Attributes:
        arrival: when the message came, ns.
        stamp: when it was measured, ns; the arrival where the message does not say.
    """

    arrival: int
    stamp: int

    def after(self, seconds: float) -> "DetectedInstant":
        """So many seconds later."""
        length = from_seconds(seconds)
        return DetectedInstant(self.arrival + length, self.stamp + length)


def due(deadline: DetectedInstant | None) -> int | None:
    """Arrival (ns) from which on silence says that a deadline is over; None without a deadline."""
    return None if deadline is None else deadline.arrival + PATIENCE


class Sample(NamedTuple):
    """What one message says.

    Attributes:
        moment: when.
        values: the number of the field, or the parts of a vector; none where only the arrival
            counts.
    """

    moment: DetectedInstant
    values: tuple[float, ...] = ()


class Found(NamedTuple):
    """How ``chi`` of a sensor's contact switches.

    Attributes:
        at: when it was known, by arrival, ns.
        stamp: when it was, before the latency is subtracted, ns.
        kind: what it was.
    """

    at: int
    stamp: int
    kind: Kind


class Sensor(Protocol):
    """Finds switchings in one stream of samples, whose stamps never go back."""

    @property
    def due(self) -> int | None:
        """Arrival from which on silence says something, ns; None when it never will."""

    def feed(self, sample: Sample) -> list[Found]:
        """What a sample shows, and what the time until then has shown."""

    def silent(self, now: int) -> list[Found]:
        """What it shows that until ``now`` (ns, by arrival) there was no other sample."""
