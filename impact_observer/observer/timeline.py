"""The replica's past: every event in its place, and the state after each.

An estimate is a function of the events ordered by stamp and sequence, and of the stamp asked
for; never of when an event arrived or who asked in between. So a late event is put in its place
and the replica is run again from there.
"""

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, TypeAlias

from impact_observer.events import Contacts, Kind
from impact_observer.observer.belief import Belief, Prediction
from impact_observer.observer.event_order import (
    EventKey,
    Interpretation,
    LatestSequences,
    OverruledSwitch,
    interpret,
    neighbours,
)
from impact_observer.observer.synchronization import Synchronization

_BEGINNING = -1
"""Sequence of the entry before any event, so that it comes first at its stamp."""

Step: TypeAlias = "Callable[[Entry, EventKey, Interpretation], Entry]"
"""The entry of an event, from the entry before it, the event and what it means."""


@dataclass(slots=True, eq=False)
class Entry:
    """One event applied.

    Attributes:
        key: its place.
        since: stamp of the instant at which ``belief`` holds, ns; that of ``key``, or an earlier
            one where the event does nothing.
        belief: after it.
        agreement: of the replicas since then.
        closed: indices of the contacts with ``chi = 1`` after it, ascending.
        spoken: numbers of the events that have said so.
        overruled: those of its switches that another event has a say in.
        prediction: how the belief goes on, once somebody has asked for it.
    """

    key: EventKey
    since: int
    belief: Belief = field(repr=False)
    agreement: Synchronization
    closed: Contacts = ()
    spoken: LatestSequences = field(default_factory=dict)
    overruled: tuple[OverruledSwitch, ...] = ()
    prediction: Prediction | None = field(default=None, repr=False)

    @property
    def event(self) -> tuple[int, int]:
        """Stamp and sequence of its event."""
        return self.key.stamp, self.key.sequence


class Insertion(NamedTuple):
    """What an event did that was put in its place.

    Attributes:
        entry: its own.
        again: how many events after it were run again.
        overrules: switches of others that it has a say in, with their events.
        later: the entries of the events after it.
    """

    entry: Entry
    again: int
    overrules: tuple[tuple[EventKey, OverruledSwitch], ...] = ()
    later: Sequence[Entry] = ()


def initial_entry(
    start: int,
    belief: Belief,
    agreement: Synchronization,
    closed: Contacts = (),
    spoken: LatestSequences | None = None,
) -> Entry:
    """The entry at stamp ``start`` (ns), before any event of that stamp."""
    return Entry(EventKey(start, _BEGINNING, ()), start, belief, agreement, closed, spoken or {})


class Timeline:
    """Events in order with the states after them, back to a bounded past.

    Attributes:
        entries: the entry at the start of the known past, then one entry an event.
    """

    def __init__(self, first: Entry) -> None:
        """Begin with the entry of a ``initial_entry``."""
        self.entries = [first]

    @property
    def start(self) -> EventKey:
        """The earliest instant that can still be asked for."""
        return self.entries[0].key

    @property
    def newest(self) -> EventKey:
        """The place of the latest event."""
        return self.entries[-1].key

    @property
    def whole(self) -> bool:
        """Whether nothing has been forgotten yet."""
        return self.start.sequence == _BEGINNING

    def __contains__(self, key: EventKey) -> bool:
        """Whether the very event is there already."""
        if self.newest < key:
            return False
        at = self._place(key)
        return at > 0 and self.entries[at - 1].key == key

    def _place(self, key: EventKey) -> int:
        """Where an event comes that is not there."""
        if self.newest < key:
            return len(self.entries)
        return bisect_right(self.entries, key, key=_key)

    def at(self, stamp: int) -> Entry:
        """The last entry at or before ``stamp``."""
        return self.around(stamp)[0]

    def around(self, stamp: int) -> tuple[Entry, int | None]:
        """``at(stamp)``, and the stamp (ns) of the entry after it; None where there is none."""
        entry = self.entries[-1]
        if entry.key.stamp <= stamp:
            return entry, None
        after = max(bisect_right(self.entries, stamp, key=_stamp), 1)
        following = self.entries[after].key.stamp if after < len(self.entries) else None
        return self.entries[after - 1], following

    def reaches(self, key: EventKey) -> bool:
        """Whether there is a past to put an event into.

        Where the past was forgotten, an event at the very start of the rest is too late: what it
        might supersede cannot be undone any more.
        """
        start = self.start
        return key.stamp > start.stamp or (key.stamp == start.stamp and self.whole)

    def begin(self, first: Entry, step: Step) -> None:
        """Begin elsewhere, with the entry of another ``initial_entry``, and redo what follows."""
        events = [entry.key for entry in self.entries[1:] if entry.key > first.key]
        self.entries = [first, *_redone(first, events, step)]

    def begin_after(self, first: Entry, step: Step) -> None:
        """``begin`` with what holds after all known events of its own stamp."""
        at = bisect_right(self.entries, first.key.stamp, key=_stamp)
        events = [entry.key for entry in self.entries[at:]]
        self.entries = [first, *_redone(first, events, step)]

    def insert(self, key: EventKey, step: Step) -> Insertion:
        """Put an event that it ``reaches`` in its place and redo everything after it."""
        if self.newest.stamp < key.stamp:  # as nearly all do
            entry = _next(self.entries[-1], key, (), step)
            self.entries.append(entry)
            return Insertion(entry, 0)
        at = first = self._place(key)
        if not key.sequence or any(kind is Kind.CLOSE for _, kind in key.switches):
            while first > 1 and self.entries[first - 1].key.stamp == key.stamp:
                first -= 1  # it may supersede those of its stamp, or be superseded
        again = [entry.key for entry in self.entries[at:]]
        events = [*(entry.key for entry in self.entries[first:at]), key, *again]
        # Only when every step has succeeded does the past change.
        fresh = _redone(self.entries[first - 1], events, step)
        self.entries[first:] = fresh
        overrules = _overrules(key, fresh) if len(fresh) > 1 else ()
        return Insertion(fresh[at - first], len(again), overrules, fresh[at - first + 1 :])

    def rehearsed(self, step: Step) -> Entry | None:
        """The latest event's entry, made again as ``insert`` made it, and put nowhere.

        None where there is no event, where it does nothing, or where another one, which may
        have a say in it, stands at its stamp.
        """
        if len(self.entries) < 2:
            return None
        previous, latest = self.entries[-2:]
        if latest.since <= previous.key.stamp:
            return None
        return Timeline(previous).insert(latest.key, step).entry

    def forget_before(self, stamp: int) -> bool:
        """Drop what lies before ``stamp`` except the state there; whether there was any."""
        entries, over = self.entries, 0
        while over + 1 < len(entries) and entries[over + 1].key.stamp <= stamp:
            over += 1  # hardly ever more than once
        del entries[:over]
        return over > 0


def _redone(previous: Entry, events: Sequence[EventKey], step: Step) -> list[Entry]:
    """An entry for each of ``events``, one after the other."""
    entries = []
    for i, event in enumerate(events):
        previous = _next(previous, event, neighbours(i, events), step)
        entries.append(previous)
    return entries


def _next(previous: Entry, event: EventKey, others: Sequence[EventKey], step: Step) -> Entry:
    """The entry of ``event``, ``others`` standing beside it; see ``interpret``."""
    reading = interpret(event, previous.closed, previous.spoken, others)
    if reading.switches:
        return step(previous, event, reading)
    return replace(previous, key=event, spoken=reading.spoken, overruled=reading.overruled)


def _overrules(
    key: EventKey, entries: Sequence[Entry]
) -> tuple[tuple[EventKey, OverruledSwitch], ...]:
    """The switches in ``entries`` that the event ``key`` has a say in."""
    return tuple(
        (entry.key, each)
        for entry in entries
        if entry.overruled and entry.key != key
        for each in entry.overruled
        if each.by == key.sequence and (key.sequence or entry.key.stamp == key.stamp)
    )


def _key(entry: Entry) -> EventKey:
    return entry.key


def _stamp(entry: Entry) -> int:
    return entry.key.stamp
