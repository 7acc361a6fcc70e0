# SPDX-License-Identifier: Apache-2.0
"""Events and samples in the order in which they act: by stamp, then by sequence."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from operator import attrgetter
from typing import NamedTuple, TypeAlias

from impact_observer.events import Contacts, ImpactEvent, Kind
from impact_observer.observer.contact_change import ContactChange

BEFORE_ALL = -1
"""Sequence of a state that holds before all events of its stamp."""
AFTER_EVENTS = 1 << 64
"""Sequence of the sample of the first sensor: samples come after the events of their stamp."""
AFTER_ALL = 1 << 65
"""Sequence of a state that holds after all events and samples of its stamp."""

Switches: TypeAlias = tuple[tuple[int, Kind], ...]
"""Index of a contact and how it switches, each."""
LastSwitches: TypeAlias = Mapping[int, int]
"""Sequence of the event that has closed or opened a contact last, by its index."""


class EventKey(NamedTuple):
    """An event in its order: by stamp, then by sequence, then by contact for unnumbered ones.

    Attributes:
        stamp: ns.
        sequence: number of the event; 0 if the sender does not count.
        switches: the contacts of an event, in order.
        sample: instead of an event, the number that a sensor has measured; empty for an event.
    """

    stamp: int
    sequence: int
    switches: Switches = ()
    sample: tuple[float, ...] = ()

    @classmethod
    def measured(cls, stamp: int, sensor: int, value: float) -> "EventKey":
        """A sample of a sensor, by its index."""
        return cls(stamp, AFTER_EVENTS + sensor, (), (value,))

    @property
    def sensor(self) -> int:
        """Index of the sensor of a sample."""
        return self.sequence - AFTER_EVENTS


def acting(
    events: Sequence[EventKey], numbers: LastSwitches
) -> Iterator[tuple[EventKey, Switches, LastSwitches]]:
    """Each of the ``events`` of one stamp, its switches that act, and the numbers after it.

    A sensor knows only later that a contact stays closed, and reports its edge once more then: the
    CLOSE replaces the IMPACT of its stamp and contact. Jitter may put a switch after a later one
    of the contact, which the numbers of the sender tell: an IMPACT or OPEN then does nothing, and
    a CLOSE is an impact.
    """
    closing = {i for event in events for i, kind in event.switches if kind is Kind.CLOSE}
    for event in events:
        act = list[tuple[int, Kind]]()
        for i, kind in event.switches:
            if kind is Kind.IMPACT and i in closing:
                continue
            is_late = 0 < event.sequence < numbers.get(i, 0)
            if not is_late:
                act.append((i, kind))
                if kind is not Kind.IMPACT:
                    numbers = {**numbers, i: event.sequence}
            elif kind is Kind.CLOSE:
                act.append((i, Kind.IMPACT))
        yield event, tuple(act), numbers


def keys_of(events: Iterable[ImpactEvent], index: Mapping[str, int]) -> list[EventKey]:
    """The ``events`` in order, each once; without contacts that have no ``index``, by name."""
    found = set[EventKey]()
    for event in events:
        known = {(index[s.contact], s.kind) for s in event.switches if s.contact in index}
        if known:
            found.add(EventKey(event.stamp, event.sequence, tuple(sorted(known))))
    return sorted(found)


def switched(events: Iterable[EventKey]) -> Iterator[tuple[EventKey, Contacts, Switches]]:
    """Each of ``events``, the contacts closed before it, and the switches of it that act.

    The events are in order, each once; all contacts are open at first.
    """
    closed: Contacts = ()
    numbers: LastSwitches = {}
    for _, members in groupby(events, key=attrgetter("stamp")):
        for event, switches, after in acting([*members], numbers):
            numbers = after
            yield event, closed, switches
            closed = ContactChange.of(0.0, closed, switches).closed


def impacts_of(events: Iterable[ImpactEvent]) -> Iterator[tuple[int, str, Kind]]:
    """Impacts and closings as applied: stamp (ns), contact and kind, in order of stamps.

    An impact of a contact that is closed, and stays so, is no closing. ``events`` are of one
    sender, in any order; each episode counts by itself.
    """
    by_run = attrgetter("epoch", "episode")
    for _, members in groupby(sorted(events, key=by_run), key=by_run):
        of_run = [*members]
        names = sorted({switch.contact for event in of_run for switch in event.switches})
        keys = keys_of(of_run, {name: i for i, name in enumerate(names)})
        for key, closed, switches in switched(keys):
            for contact, kind in switches:
                if kind is not Kind.OPEN:
                    yield key.stamp, names[contact], Kind.IMPACT if contact in closed else kind
