"""What every event means among the others, where stamps and sequence numbers disagree.

Events act in the order of their stamps. But a stamp may be off by more than two events are apart;
a sequence number is not. So what ``chi`` of a contact is, once an event has acted, is what the
highest number so far has said of it. And a switch that turns out to be closed for long is told
twice with the stamp of one edge: as an IMPACT at once, and later as the CLOSE that replaces it.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from typing import NamedTuple, TypeAlias

from impact_observer.estimation.contact_change import ContactChange
from impact_observer.events import Contacts, ImpactEvent, Kind

LatestSequences: TypeAlias = Mapping[int, int]
"""By index of a contact, the highest sequence number that has spoken of it."""


class EventKey(NamedTuple):
    """The order of events: by stamp, then by sequence, then by contact for unnumbered ones.

    Attributes:
        stamp: ns.
        sequence: of the event.
        switches: index of a contact and how it switches, in the event's order.
    """

    stamp: int
    sequence: int
    switches: tuple[tuple[int, Kind], ...]


class OverruledSwitch(NamedTuple):
    """A switch that another event has a say in.

    Attributes:
        contact: its index.
        said: how it says to switch.
        acts: how it does; None for not at all.
        by: sequence number of the other event.
    """

    contact: int
    said: Kind
    acts: Kind | None
    by: int

    @property
    def is_superseded(self) -> bool:
        """Whether a CLOSE has replaced it, and no part of it is left."""
        return self.said is Kind.IMPACT and self.acts is None

    @property
    def effect(self) -> str:
        """What it does, in words."""
        if self.acts is None:
            return f"its {self.said.name} does nothing"
        return f"a hit, and it stays {'closed' if self.acts is Kind.CLOSE else 'open'}"


class Interpretation(NamedTuple):
    """What an event means.

    Attributes:
        switches: as they act, in the order of ``EventKey``.
        spoken: as it is after the event.
        overruled: those switches that another event has a say in.
    """

    switches: tuple[tuple[int, Kind], ...]
    spoken: LatestSequences
    overruled: tuple[OverruledSwitch, ...] = ()


def interpret(
    event: EventKey, closed: Contacts, spoken: LatestSequences, others: Sequence[EventKey] = ()
) -> Interpretation:
    """What ``event`` means after those before it.

    Events without a number go by their stamp alone.

    Args:
        event: the event.
        closed: contacts with ``chi = 1`` until now.
        spoken: by the events before it.
        others: events that follow it at the same stamp, in order; all of that stamp where it
            has no number.
    """
    is_stale = False  # a higher number has spoken of one of its contacts
    for contact, _ in event.switches:
        is_stale |= 0 < event.sequence < spoken.get(contact, 0)
    if not (others or is_stale):  # as nearly always
        return Interpretation(event.switches, _after(event, event.switches, spoken))
    acting, overruled = [], []
    for contact, said in event.switches:
        found = _overruled(event.sequence, (contact, said), closed, spoken, others)
        if found is not None:
            overruled.append(found)
        acts = said if found is None else found.acts
        if acts is not None:
            acting.append((contact, acts))
    switches = tuple(acting)
    return Interpretation(switches, _after(event, switches, spoken), tuple(overruled))


def neighbours(i: int, events: Sequence[EventKey]) -> Sequence[EventKey]:
    """Those of ``events``, in order, that stand beside the ``i``-th; see ``interpret``."""
    stamp, first, end = events[i].stamp, i, i + 1
    while end < len(events) and events[end].stamp == stamp:
        end += 1
    while not events[i].sequence and first > 0 and events[first - 1].stamp == stamp:
        first -= 1
    return [*events[first:i], *events[i + 1 : end]]


def deduplicated(events: Iterable[EventKey]) -> list[EventKey]:
    """``events`` in order, without those that came before: by sequence, or in all."""
    found: dict[object, EventKey] = {}
    for each in events:
        found.setdefault(each.sequence or each, each)
    return sorted(found.values())


def interpretations(events: Sequence[EventKey]) -> Iterator[tuple[Contacts, Interpretation]]:
    """What each of ``events`` means, all open at first; with the contacts closed before it.

    Args:
        events: in order, each once.
    """
    closed: Contacts = ()
    spoken: LatestSequences = {}
    for i, event in enumerate(events):
        reading = interpret(event, closed, spoken, neighbours(i, events))
        yield closed, reading
        closed, spoken = ContactChange.of(0.0, closed, reading.switches).closed, reading.spoken


def impacts_of(events: Iterable[ImpactEvent]) -> Iterator[tuple[int, str, Kind]]:
    """Impacts and closings as they act: stamp (ns), contact and kind, in order of stamps.

    Args:
        events: of one sender, in any order; of each episode by itself.
    """

    def run(event: ImpactEvent) -> tuple[int, int]:
        return event.epoch, event.episode

    for _, members in groupby(sorted(events, key=run), key=run):
        told = list(members)
        names = sorted({switch.contact for event in told for switch in event.switches})
        index = {name: i for i, name in enumerate(names)}
        keys = deduplicated(
            EventKey(
                e.stamp,
                e.sequence,
                tuple(sorted({(index[s.contact], s.kind) for s in e.switches})),
            )
            for e in told
        )
        for key, (_, reading) in zip(keys, interpretations(keys), strict=True):
            for contact, kind in reading.switches:
                if kind is not Kind.OPEN:
                    yield key.stamp, names[contact], kind


def _after(
    event: EventKey, switches: Iterable[tuple[int, Kind]], spoken: LatestSequences
) -> LatestSequences:
    """Who has spoken of which contact, once ``switches`` of ``event`` have acted."""
    if not event.sequence:
        return spoken
    latest = dict(spoken)
    for contact, _ in switches:
        if event.sequence > latest.get(contact, 0):
            latest[contact] = event.sequence
    return latest


def _overruled(
    sequence: int,
    switch: tuple[int, Kind],
    closed: Contacts,
    spoken: LatestSequences,
    others: Sequence[EventKey],
) -> OverruledSwitch | None:
    """How another event overrules a switch of the event numbered ``sequence``; None if none."""
    contact, said = switch
    if said is Kind.IMPACT:
        for each in others:
            if (contact, Kind.CLOSE) in each.switches:
                return OverruledSwitch(contact, said, None, each.sequence)
    newest = spoken.get(contact, 0)
    if not 0 < sequence < newest:
        return None
    stays = Kind.CLOSE if contact in closed else Kind.IMPACT
    return OverruledSwitch(contact, said, None if said is Kind.OPEN else stays, newest)
