# SPDX-License-Identifier: Apache-2.0
"""The observer's past: every event in its place, and the belief after each.

A late event is put in its place, and the events after it are applied again (``docs/nodes.md``).
"""

from bisect import bisect_right
from collections import defaultdict
from collections.abc import Callable, Container, Generator, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import NamedTuple, TypeAlias, TypeVar

from impact_observer.errors import ImpactObserverError
from impact_observer.events import Contacts, Kind
from impact_observer.observer.belief import Belief, Prediction
from impact_observer.observer.event_order import (
    EventKey,
    LatestSequences,
    OverruledSwitch,
    Superseding,
    superseding,
)
from impact_observer.observer.readings import SampleOutcome
from impact_observer.observer.synchronization import Synchronization

_BEFORE_EVENTS = -1
"""Sequence of the entry before any event, so that it comes first at its stamp."""


@dataclass(slots=True, eq=False)
class Entry:
    """The posterior of one event.

    Attributes:
        key: the event.
        since: stamp at which ``belief`` holds, ns; that of ``key``, or of an earlier event if
            ``key`` has no effect.
        belief: belief just after the event.
        synchronization: synchronization of the replicas just after the event.
        closed: indices of the contacts with ``chi = 1`` after the event, ascending.
        latest: sequence numbers of the events that have switched each contact.
        overruled: switches of the event whose effect another event changes.
        last: stamp (ns) and sequence of the last event so far; zeros before the first.
        impact: stamp of the last impact so far, ns; 0 before the first.
        outcome: outcome of a sample; None for an event.
        rejected: by index of a sensor, how many of its latest samples in a row were rejected.
        prediction: prediction from ``since`` on; None until the first request.
    """

    key: EventKey
    since: int
    belief: Belief = field(repr=False)
    synchronization: Synchronization
    closed: Contacts = ()
    latest: LatestSequences = field(default_factory=dict)
    overruled: tuple[OverruledSwitch, ...] = ()
    last: tuple[int, int] = (0, 0)
    impact: int = 0
    outcome: SampleOutcome | None = None
    rejected: Mapping[int, int] = field(default_factory=dict)
    prediction: Prediction | None = field(default=None, repr=False)

    @property
    def is_event(self) -> bool:
        """Whether the entry is of an event, and not of a sample or of the start."""
        return bool(self.key.switches)

    @property
    def begins(self) -> int:
        """From when on estimates use it, ns: stamps of a clock that has stepped may be early."""
        return max(self.key.stamp, self.since)

    @property
    def event(self) -> tuple[int, int]:
        """Stamp and sequence of its event."""
        return self.key.stamp, self.key.sequence


Update: TypeAlias = Callable[[Entry, EventKey, Superseding], Entry]
"""The entry of an event, from the entry before it, the event and what supersedes it."""


class Insertion(NamedTuple):
    """The changes by the insertion of an event.

    Attributes:
        entry: entry of the event.
        overrules: switches of other events whose effect the event changes, with those events.
        again: how many later events, samples not counted, were applied again.
        entries: consecutive entries that contain ``entry`` and all later entries.
        place: place of ``entry`` among ``entries``.
    """

    entry: Entry
    overrules: tuple[tuple[EventKey, OverruledSwitch], ...] = ()
    again: int = 0
    entries: Sequence[Entry] = ()
    place: int = 0

    @property
    def later(self) -> Sequence[Entry]:
        """The entries of the events after it."""
        return self.entries[self.place + 1 :]


class Insertions(NamedTuple):
    """The changes by the insertion of several events.

    Attributes:
        insertions: insertions of the events applied, in order.
        failed: errors of the events that could not be applied.
    """

    insertions: tuple[Insertion, ...]
    failed: Mapping[EventKey, ImpactObserverError]


_Value = TypeVar("_Value")


def outcome(steps: Generator[object, None, _Value]) -> _Value:
    """Returns the value with which a generator ends."""
    try:
        while True:
            next(steps)
    except StopIteration as end:
        value: _Value = end.value
        return value


def initial_entry(
    start: int,
    belief: Belief,
    synchronization: Synchronization,
    closed: Contacts = (),
    latest: LatestSequences | None = None,
) -> Entry:
    """The entry at stamp ``start`` (ns), before any event of that stamp."""
    key = EventKey(start, _BEFORE_EVENTS, ())
    return Entry(key, start, belief, synchronization, closed, latest or {})


class Timeline:
    """Events in order with the beliefs after them, back to a bounded past.

    Attributes:
        entries: the entry at the start of the past, then one entry an event.
    """

    def __init__(self, first: Entry, update: Update) -> None:
        """Start with an ``initial_entry``; ``update`` makes those of events and samples."""
        self.entries = [first]
        self._update = update

    @property
    def start(self) -> EventKey:
        """The earliest instant at which an estimate can still be made."""
        return self.entries[0].key

    @property
    def newest(self) -> EventKey:
        """The latest event."""
        return self.entries[-1].key

    @property
    def is_complete(self) -> bool:
        """Whether nothing has been forgotten yet."""
        return self.start.sequence == _BEFORE_EVENTS

    def insert(self, key: EventKey) -> Insertion:
        """Put an event that the timeline ``accepts`` in its place, and apply later events again.

        Raises:
            ImpactObserverError: the event or a later one cannot be applied; nothing changes.
        """
        if self.newest.stamp < key.stamp:  # the usual case
            entry = self._update(self.entries[-1], key, ())
            self.entries.append(entry)
            return Insertion(entry)
        made = outcome(self.inserting([key]))
        for error in made.failed.values():
            raise error
        return made.insertions[0]

    def inserting(self, keys: Iterable[EventKey]) -> Generator[None, None, Insertions]:
        """Put events that the timeline ``accepts`` in place, and apply later events again, once.

        Yields after each event that is applied. The entries change at the end only, and the caller
        must not change the timeline until then. A new event that cannot be applied is left out. If
        an old event cannot be applied again, the nearest new event before it is left out, or else
        the first new event after it.
        """
        new, failed = {*keys}, dict[EventKey, ImpactObserverError]()
        if not new:
            return Insertions((), failed)
        same, changed = self._changed_by(new)
        events = sorted([*(entry.key for entry in self.entries[same:]), *new])
        entries = self.entries[same:changed]
        while len(entries) < len(events):
            i = len(entries)
            previous = entries[-1] if entries else self.entries[same - 1]
            try:
                entries.append(self._update(previous, events[i], superseding(i, events)))
            except ImpactObserverError as error:
                nearest = (*range(i, -1, -1), *range(i + 1, len(events)))
                culprit = next(k for k in nearest if events[k] in new)
                failed[events[culprit]] = error
                new.discard(events[culprit])
                del entries[_superseded_by(events[culprit], entries[:culprit]) :]
                del events[culprit]
            yield
        if not new:
            return Insertions((), failed)
        self.entries[same:] = entries
        return Insertions(_insertions(new, entries), failed)

    def _changed_by(self, new: Iterable[EventKey]) -> tuple[int, int]:
        """The places of the first entry at the earliest of the stamps, and of the first to change.

        An event changes those after it, and those of its stamp that it supersedes.
        """
        earliest = min(new)
        first = changed = self._place(earliest)
        closing: dict[int, int] = {}
        for key in new:
            for contact, kind in key.switches if key.stamp == earliest.stamp else ():
                if kind is Kind.CLOSE:
                    closing[contact] = min(closing.get(contact, key.sequence), key.sequence)
        while first > 1 and self.entries[first - 1].key.stamp == earliest.stamp:
            first -= 1
            if closing and _is_superseded(self.entries[first], closing):
                changed = first
        return first, changed

    def go_on_from(self, stamp: int, belief: Belief) -> None:
        """Forget all up to the last event, and hold ``belief`` at a later ``stamp`` (ns)."""
        last = replace(self.entries[-1], since=stamp, belief=belief, prediction=None)
        self.entries = [last]

    def rerun(self, stamp: int) -> None:
        """Apply the events after ``stamp`` (ns) again with changed samples of forces.

        An event that cannot be applied any more is left out.
        """
        first = max(self._after(stamp), 1)
        previous = self.entries[first - 1]
        if previous.prediction is not None and not previous.prediction.follows_samples:
            previous.prediction = None
        events = [each.key for each in self.entries[first:]]
        entries = list[Entry]()
        for i, event in enumerate(events):
            with suppress(ImpactObserverError):
                previous = self._update(previous, event, superseding(i, events))
                entries.append(previous)
        self.entries[first:] = entries

    def _after(self, stamp: int) -> int:
        """The place of the first entry after ``stamp`` (ns)."""
        entries = self.entries
        if entries[-1].key.stamp <= stamp:  # as nearly always
            return len(entries)
        return bisect_right(entries, stamp, key=_stamp)

    def _applied(self, previous: Entry, events: Sequence[EventKey]) -> list[Entry]:
        entries = [previous]
        for i, event in enumerate(events):
            entries.append(self._update(entries[-1], event, superseding(i, events)))
        return entries[1:]

    def accepts(self, key: EventKey) -> bool:
        """Whether the past still reaches back to an event.

        Once the past has been shortened, an event at its very start is too late as well: an event
        that it may supersede cannot be undone any more.
        """
        start = self.start
        return key.stamp > start.stamp or (key.stamp == start.stamp and self.is_complete)

    def __contains__(self, key: EventKey) -> bool:
        """Whether the timeline has the same event, with the same switches."""
        if key.stamp > self.newest.stamp:  # as nearly always
            return False
        at = self._place(key)
        return at > 0 and self.entries[at - 1].key == key

    def has_sample(self, stamp: int, sequence: int) -> bool:
        """Whether the timeline has a sample of the same sensor at the same stamp."""
        at = bisect_right(self.entries, (stamp, sequence), key=lambda entry: entry.event)
        return self.entries[at - 1].event == (stamp, sequence)

    def _place(self, key: EventKey) -> int:
        return bisect_right(self.entries, key, key=lambda entry: entry.key)

    def entry_at(self, stamp: int) -> Entry:
        """The last entry at or before ``stamp`` (ns)."""
        return self.interval(stamp)[0]

    def around(self, stamp: int, sequence: int, contact: int) -> tuple[Entry, Entry] | None:
        """The entry before the event of a contact, and that of the event; None if not known.

        The event has this ``stamp`` (ns) and ``sequence``.
        """
        at = bisect_right(self.entries, (stamp, sequence), key=lambda entry: entry.event)
        while at > 1 and (entry := self.entries[at - 1]).event == (stamp, sequence):
            at -= 1
            if any(i == contact for i, _ in entry.key.switches):
                return self.entries[at - 1], entry
        return None

    def interval(self, stamp: int) -> tuple[Entry, int | None]:
        """The ``entry_at`` a stamp (ns), and the stamp of the next entry, None for the last."""
        entry = self.entries[-1]
        if entry.begins <= stamp:
            return entry, None
        after = max(bisect_right(self.entries, stamp, key=_begins), 1)
        following = self.entries[after].begins if after < len(self.entries) else None
        return self.entries[after - 1], following

    def restart(self, first: Entry, *, after: bool = False) -> None:
        """Start with another ``initial_entry``, and apply the events after it again.

        With ``after`` the state of ``first`` holds after all events of its stamp.
        """
        stamp = first.key.stamp
        keys = [entry.key for entry in self.entries[1:]]
        events = [each for each in keys if each.stamp > stamp or (not after and each > first.key)]
        self.entries = [first, *self._applied(first, events)]

    def forget_before(self, stamp: int, most: int) -> bool:
        """Drop the entries before ``stamp`` (ns) but the last of them; whether any was dropped.

        Of more entries than ``most``, the oldest are dropped, too.
        """
        entries = self.entries
        old = max(len(entries) - most, 0)
        while old + 1 < len(entries) and entries[old + 1].key.stamp <= stamp:
            old += 1  # rarely more than one
        del entries[:old]
        return old > 0


def _stamp(entry: Entry) -> int:
    return entry.key.stamp


def _begins(entry: Entry) -> int:
    return entry.begins


def _is_superseded(entry: Entry, closing: Mapping[int, int]) -> bool:
    """Whether events of its stamp that close contacts change what supersedes an event.

    ``closing`` has their lowest number by contact.
    """
    by = {each.contact: each.by for each in entry.overruled if each.is_superseded}
    hits = (contact for contact, kind in entry.key.switches if kind is Kind.IMPACT)
    return any(c in closing and (c not in by or closing[c] < by[c]) for c in hits)


def _superseded_by(event: EventKey, before: Sequence[Entry]) -> int:
    """Place of the first of the entries ``before`` an event that it supersedes, or their end."""
    changed = first = len(before)
    while first > 0 and before[first - 1].key.stamp == event.stamp:
        first -= 1
        if any(o.is_superseded and o.by == event.sequence for o in before[first].overruled):
            changed = first
    return changed


def _insertions(new: Container[EventKey], entries: Sequence[Entry]) -> tuple[Insertion, ...]:
    """Returns the insertion of each event of ``new`` among the ``entries``."""
    overrules = defaultdict[tuple[int, int], list[tuple[EventKey, OverruledSwitch]]](list)
    for entry in entries:
        for each in entry.overruled:
            overrules[each.by, 0 if each.by else entry.key.stamp].append((entry.key, each))
    insertions, again = list[Insertion](), 0
    for place in reversed(range(len(entries))):
        entry = entries[place]
        if entry.key not in new:
            again += entry.is_event
            continue
        number = entry.key.sequence
        changes = overrules.get((number, 0 if number else entry.key.stamp), ())
        others = tuple(each for each in changes if each[0] != entry.key)
        insertions.append(Insertion(entry, others, again, entries, place))
    return tuple(reversed(insertions))
