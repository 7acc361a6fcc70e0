# SPDX-License-Identifier: Apache-2.0
"""The meaning of an event among others if stamps and sequence numbers disagree.

Events act in the order of their stamps. Jitter may swap two stamps, but not two sequence numbers.
So after an event, ``chi`` of a contact is what the event with the highest sequence number so far
has set, among those that jitter may have swapped: a number that leaps is no rule. A contact that
stays closed is reported twice with the stamp of one edge: at once as an IMPACT, and later as the
CLOSE that supersedes it.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from typing import NamedTuple, TypeAlias

from impact_observer.events import Contacts, ImpactEvent, Kind
from impact_observer.observer.contact_change import ContactChange
from impact_observer.stamps import NS_PER_S

NEAR_NUMBERS = 1000
"""Largest difference of the sequence numbers of two events whose stamps jitter has swapped."""
NEAR_STAMPS = NS_PER_S
"""Largest difference of the stamps of two such events, ns: above jitter, below a history."""

LatestSequences: TypeAlias = Mapping[int, tuple[int, int]]
"""Sequence number and stamp (ns) of the event that has set a contact, by its index."""

Superseding: TypeAlias = Sequence[tuple[int, int]]
"""Indices of contacts of whose IMPACT a CLOSE supersedes, each with the number of that event."""


AFTER_EVENTS = 1 << 64
"""Sequence of the sample of the first sensor, so that samples come after events of their stamp."""


class EventKey(NamedTuple):
    """An event in its order: by stamp, then by sequence, then by contact for unnumbered ones.

    Attributes:
        stamp: ns.
        sequence: number of the event; 0 if the sender does not count.
        switches: index of a contact and how it switches, in the event's order.
        sample: instead of an event, the number that a sensor has measured; empty for an event.
    """

    stamp: int
    sequence: int
    switches: tuple[tuple[int, Kind], ...]
    sample: tuple[float, ...] = ()

    @classmethod
    def measured(cls, stamp: int, sensor: int, value: float) -> "EventKey":
        """A sample of a sensor, by its index, which comes after the events of its stamp."""
        return cls(stamp, AFTER_EVENTS + sensor, (), (value,))

    @property
    def sensor(self) -> int:
        """Index of the sensor of a sample."""
        return self.sequence - AFTER_EVENTS


class OverruledSwitch(NamedTuple):
    """A switch whose effect another event changes.

    Attributes:
        contact: index of the contact.
        reported: the kind that the event reports.
        applied: the kind that is applied; None for none.
        by: sequence number of the other event.
    """

    contact: int
    reported: Kind
    applied: Kind | None
    by: int

    @property
    def is_superseded(self) -> bool:
        """Whether a CLOSE has replaced the switch, so that the switch has no effect."""
        return self.reported is Kind.IMPACT and self.applied is None

    @property
    def effect(self) -> str:
        """The effect of the switch, in words."""
        if self.applied is None:
            return f"its {self.reported.name} does nothing"
        return f"a hit, and it stays {'closed' if self.applied is Kind.CLOSE else 'open'}"


class Interpretation(NamedTuple):
    """The effect of an event among the others.

    Attributes:
        switches: the switches to apply, in the order of ``EventKey``.
        latest: sequence numbers after the event.
        overruled: the switches of the event whose effect another event changes.
    """

    switches: tuple[tuple[int, Kind], ...]
    latest: LatestSequences
    overruled: tuple[OverruledSwitch, ...] = ()


def interpret(
    event: EventKey, closed: Contacts, latest: LatestSequences, superseding: Superseding = ()
) -> Interpretation:
    """Interpret ``event`` after the events before; an unnumbered event is ordered by its stamp.

    Args:
        event: the event.
        closed: contacts with ``chi = 1`` before it.
        latest: sequence numbers before it.
        superseding: see ``superseding``.
    """
    applied, overruled, after = [], [], latest
    for contact, kind in event.switches:
        newest = _newest_near(event, latest.get(contact))
        change = _overruled((contact, kind), newest, closed, superseding)
        if change is not None:
            overruled.append(change)
        effect = kind if change is None else change.applied
        if effect is not None:
            applied.append((contact, effect))
            if event.sequence and not newest:
                after = {**after, contact: (event.sequence, event.stamp)}
    return Interpretation(tuple(applied), after, tuple(overruled))


def _overruled(
    switch: tuple[int, Kind], newest: int, closed: Contacts, superseding: Superseding
) -> OverruledSwitch | None:
    """How an event of ``superseding`` or number ``newest`` changes a switch; None if neither."""
    contact, kind = switch
    if kind is Kind.IMPACT:
        for closing, number in superseding:
            if closing == contact:
                return OverruledSwitch(contact, kind, None, number)
    if not newest:
        return None
    stays = Kind.CLOSE if contact in closed else Kind.IMPACT
    return OverruledSwitch(contact, kind, None if kind is Kind.OPEN else stays, newest)


def _newest_near(event: EventKey, latest: tuple[int, int] | None) -> int:
    """The number of the event that set a contact, if jitter may have swapped it with ``event``.

    Such a number is higher, but not by a leap; otherwise 0 is returned.
    """
    if latest is None or not event.sequence:
        return 0
    number, stamp = latest
    is_near = event.stamp - stamp <= NEAR_STAMPS
    return number if is_near and 0 < number - event.sequence <= NEAR_NUMBERS else 0


def superseding(i: int, events: Sequence[EventKey]) -> Superseding:
    """The first of ``events``, in order, whose CLOSE supersedes an IMPACT of the ``i``-th event.

    The CLOSE follows at the same stamp; for an unnumbered event, any CLOSE of the stamp counts.
    """
    event = events[i]
    hits = {contact for contact, kind in event.switches if kind is Kind.IMPACT}
    first = i + 1
    while not event.sequence and first > 0 and events[first - 1].stamp == event.stamp:
        first -= 1
    pairs = list[tuple[int, int]]()
    while hits and first < len(events) and events[first].stamp == event.stamp:
        for contact, kind in events[first].switches:
            if kind is Kind.CLOSE and contact in hits and first != i:
                pairs.append((contact, events[first].sequence))
                hits.remove(contact)
        first += 1
    return tuple(pairs)


def keys_of(events: Iterable[ImpactEvent], index: Mapping[str, int]) -> list[EventKey]:
    """The ``events`` in order, each once; without contacts that have no ``index``, by name."""
    known = (
        (e, {(index[s.contact], s.kind) for s in e.switches if s.contact in index}) for e in events
    )
    keys = {EventKey(e.stamp, e.sequence, tuple(sorted(kinds))) for e, kinds in known if kinds}
    return sorted(keys)


def interpretations(events: Sequence[EventKey]) -> Iterator[tuple[Contacts, Interpretation]]:
    """The contacts closed before each of ``events``, and its interpretation; all open at first.

    The events are in order, each once.
    """
    closed: Contacts = ()
    latest: LatestSequences = {}
    for i, event in enumerate(events):
        meaning = interpret(event, closed, latest, superseding(i, events))
        yield closed, meaning
        closed, latest = ContactChange.of(0.0, closed, meaning.switches).closed, meaning.latest


def impacts_of(events: Iterable[ImpactEvent]) -> Iterator[tuple[int, str, Kind]]:
    """Impacts and closings as applied: stamp (ns), contact and kind, in order of stamps.

    An impact of a contact that is closed, and stays so, is no closing. ``events`` are of one
    sender, in any order; each episode counts by itself.
    """

    def run(event: ImpactEvent) -> tuple[int, int]:
        return event.epoch, event.episode

    for _, members in groupby(sorted(events, key=run), key=run):
        of_run = list(members)
        names = sorted({switch.contact for event in of_run for switch in event.switches})
        keys = keys_of(of_run, {name: i for i, name in enumerate(names)})
        for key, (closed, meaning) in zip(keys, interpretations(keys), strict=True):
            for contact, kind in meaning.switches:
                if kind is not Kind.OPEN:
                    yield key.stamp, names[contact], Kind.IMPACT if contact in closed else kind
