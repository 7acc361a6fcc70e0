"""One account of the events, the state that follows from it, and how likely it is."""

from collections.abc import Mapping
from itertools import takewhile
from types import MappingProxyType
from typing import NamedTuple

from impact_observer.estimation.gaussian_state import GaussianState
from impact_observer.events import Kind, Ruling

_NOTHING: Mapping[int, float] = MappingProxyType({})


class Note(NamedTuple):
    """What a law made of one contact in one event, or inserted itself.

    Attributes:
        event: stamp (ns) and sequence of the event with which it was noted.
        stamp: when it was, ns: of the event, but for what was inserted.
        contact: index.
        ruling: applied, rejected or inserted.
        reason: in plain words; empty when all is as it should be.
        innovation: in standard deviations; -1 where there is none.
    """

    event: tuple[int, int]
    stamp: int
    contact: int
    ruling: Ruling
    reason: str = ""
    innovation: float = -1.0

    @property
    def is_inserted(self) -> bool:
        """Whether the law inserted it."""
        return self.ruling is Ruling.INSERTED

    @property
    def gist(self) -> tuple[object, ...]:
        """What it says, but for figures."""
        return self.event, self.contact, self.ruling, self.reason[:5]


class MissedSwitch(NamedTuple):
    """A switching that was predicted and not heard.

    Attributes:
        contact: index.
        kind: how it switches.
        ago: when, seconds before the event that came then.
        surety: depth that the contact would have reached without it, in standard deviations.
    """

    contact: int
    kind: Kind
    ago: float
    surety: float


class Hypothesis(NamedTuple):
    """One way in which the events may have come about, and what follows from it.

    Attributes:
        known: the state, and how surely.
        clock: standard deviation of a stamp, s.
        weight: logarithm of its probability.
        notes: what it makes of the latest events, in their order.
        sunk: contacts of which something is below zero that must not be, with the logarithm of
            the probability that this is an error of the estimate.
        missed: what has switched unheard since the last event.
    """

    known: GaussianState
    clock: float
    weight: float = 0.0
    notes: tuple[Note, ...] = ()
    sunk: Mapping[int, float] = _NOTHING
    missed: tuple[MissedSwitch, ...] = ()

    @property
    def whole_weight(self) -> float:
        """Its weight, and that of what it has fallen through."""
        return self.weight + sum(self.sunk.values()) if self.sunk else self.weight

    def knowing(self, known: GaussianState) -> "Hypothesis":
        """The same account, with the state as it is ``known``."""
        return Hypothesis(known, self.clock, self.weight, self.notes, self.sunk, self.missed)

    def weighing(self, weight: float) -> "Hypothesis":
        """The same, with another ``weight``."""
        return Hypothesis(self.known, self.clock, weight, self.notes, self.sunk, self.missed)

    def noted(self, event: tuple[int, int]) -> list[Note]:
        """Its notes on the contacts of ``event``, which is the latest."""
        latest = takewhile(lambda note: note.event == event, reversed(self.notes))
        return [note for note in latest if not note.is_inserted][::-1]
