"""The replica's past: every event in its place, and the state after each.

An estimate is a function of the events ordered by stamp and sequence, and of the stamp asked
for; never of when an event arrived or who asked in between. So a late event is put in its place
and the replica is run again from there.
"""

from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

from impact_observer.events import Contacts, Kind
from impact_observer.observer.agreement import Agreement
from impact_observer.observer.belief import Belief, Course

_BEGINNING = -1
"""Sequence of the entry before any event, so that it comes first at its stamp."""

Step: TypeAlias = "Callable[[Entry, Key], Entry]"
"""The entry of an event, from the entry before it and the event."""


class Key(NamedTuple):
    """The order of events: by stamp, then by sequence, then by contact for unnumbered ones.

    Attributes:
        stamp: ns.
        sequence: of the event.
        switches: index of a contact and how it switches, in the event's order.
    """

    stamp: int
    sequence: int
    switches: tuple[tuple[int, Kind], ...]


@dataclass(slots=True, eq=False)
class Entry:
    """One event applied.

    Attributes:
        key: its place.
        belief: after it.
        agreement: of the replicas since then.
        closed: indices of the contacts with ``chi = 1`` after it, ascending.
        course: how the belief goes on, once somebody has asked for it.
    """

    key: Key
    belief: Belief = field(repr=False)
    agreement: Agreement
    closed: Contacts = ()
    course: Course | None = field(default=None, repr=False)


def beginning(start: int, belief: Belief, agreement: Agreement, closed: Contacts = ()) -> Entry:
    """The entry at stamp ``start`` (ns), before any event of that stamp."""
    return Entry(Key(start, _BEGINNING, ()), belief, agreement, closed)


class Timeline:
    """Events in order with the states after them, back to a bounded past.

    Attributes:
        entries: the entry at the start of the known past, then one entry an event.
    """

    def __init__(self, first: Entry) -> None:
        """Begin with the entry of a ``beginning``."""
        self.entries = [first]

    @property
    def start(self) -> Key:
        """The earliest instant that can still be asked for."""
        return self.entries[0].key

    @property
    def newest(self) -> Key:
        """The place of the latest event."""
        return self.entries[-1].key

    @property
    def whole(self) -> bool:
        """Whether nothing has been forgotten yet."""
        return self.start.sequence == _BEGINNING

    def __contains__(self, key: Key) -> bool:
        """Whether the very event is there already."""
        at = bisect_right(self.entries, key, key=_key)
        return at > 0 and self.entries[at - 1].key == key

    def at(self, stamp: int) -> Entry:
        """The last entry at or before ``stamp``."""
        entry = self.entries[-1]
        if entry.key.stamp <= stamp:
            return entry
        return self.entries[max(bisect_right(self.entries, stamp, key=_stamp), 1) - 1]

    def begin(self, first: Entry, step: Step) -> None:
        """Begin elsewhere, with the entry of another ``beginning``, and redo what follows."""
        events = [entry.key for entry in self.entries[1:] if entry.key > first.key]
        self.entries = [first, *_redone(first, events, step)]

    def insert(self, key: Key, step: Step) -> Entry:
        """Put an event, not before ``start``, in its place and redo everything after it."""
        at = bisect_right(self.entries, key, key=_key)
        events = [key, *(entry.key for entry in self.entries[at:])]
        # Only when every step has succeeded does the past change.
        self.entries[at:] = _redone(self.entries[at - 1], events, step)
        return self.entries[at]

    def forget_before(self, stamp: int) -> None:
        """Drop what lies before ``stamp`` except the state there."""
        keep = bisect_right(self.entries, stamp, key=_stamp) - 1
        if keep > 0:
            del self.entries[:keep]


def _redone(previous: Entry, events: list[Key], step: Step) -> list[Entry]:
    """An entry for each of ``events``, one after the other."""
    entries = []
    for event in events:
        previous = step(previous, event)
        entries.append(previous)
    return entries


def _key(entry: Entry) -> Key:
    return entry.key


def _stamp(entry: Entry) -> int:
    return entry.key.stamp
