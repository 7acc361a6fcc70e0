# SPDX-License-Identifier: Apache-2.0
"""The ledger of a hypothesis: what it decides on each event, and which switches were missed."""

from collections.abc import Mapping
from itertools import takewhile
from types import MappingProxyType
from typing import NamedTuple

from impact_observer.events import Contacts, Kind, Ruling
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.settling import Rest
from impact_observer.filter.tuning import TUNING


class Note(NamedTuple):
    """What a hypothesis decides on one contact of an event, or on an impact it inserts.

    Attributes:
        event: stamp (ns) and sequence of the event at which it was decided.
        stamp: of the impact, ns: that of the event, or an earlier one for an inserted impact.
        contact: index.
        ruling: applied, rejected or inserted.
        reason: in plain words; empty for an event that is accepted as it was reported.
        innovation: in standard deviations; -1 where there is none.
        switched: index of the contact that has switched: another one where it was mislabelled.
        kind: how it has switched, of an inserted one; of others CLOSE where a contact has settled
            though it was reported to bounce on.
        is_dead: whether it was in the sensor's dead time, which could not report it, or the CLOSE
            that began a row of bounces that the sensor does not report.
    """

    event: tuple[int, int]
    stamp: int
    contact: int
    ruling: Ruling
    reason: str = ""
    innovation: float = -1.0
    switched: int = -1
    kind: Kind = Kind.IMPACT
    is_dead: bool = False

    @property
    def is_inserted(self) -> bool:
        """Whether it is on a missed impact that the hypothesis inserts."""
        return self.ruling is Ruling.INSERTED

    @property
    def decision(self) -> tuple[object, ...]:
        """The decision without its numbers, which follow the colon of the reason."""
        return self.event, self.contact, self.ruling, self.reason.partition(":")[0]


class MissedSwitch(NamedTuple):
    """A switch that was predicted and not reported.

    Attributes:
        contact: index.
        kind: how it switches.
        ago: when, seconds before the next event.
        depth: penetration that the estimate would reach without it, in standard deviations.
        is_dead: whether it is in the sensor's dead time, which cannot report it.
    """

    contact: int
    kind: Kind
    ago: float
    depth: float
    is_dead: bool = False


class Ledger(NamedTuple):
    """What a hypothesis decides on the events so far.

    Attributes:
        notes: decisions on the latest events, in their order.
        missed: missed switches since the last event.
        events: number of events that are explained.
        last_error: number of the last event that an error of the model explains; 0 for none.
        reported: when the sensor has reported each contact last, s since the epoch.
        settled: closed contacts of which bounces may still be reported.
        unreported: contacts whose bounces the sensor does not report until they rest.
    """

    notes: tuple[Note, ...] = ()
    missed: tuple[MissedSwitch, ...] = ()
    events: int = 0
    last_error: int = 0
    reported: Mapping[int, float] = MappingProxyType({})
    settled: Mapping[int, Rest] = MappingProxyType({})
    unreported: Contacts = ()

    def later(self, s: float) -> "Ledger":
        """The same ``s`` seconds later: the missed switches are longer ago."""
        return self._replace(missed=tuple(m._replace(ago=m.ago + s) for m in self.missed))

    def with_missed(self, switch: MissedSwitch, rest: Rest | None) -> "Ledger":
        """The same with a missed ``switch``; with the ``rest`` of a contact that closes there."""
        missed = (*self.missed, switch)
        if rest is None:
            return self._replace(missed=missed)
        unreported = tuple(i for i in self.unreported if i != switch.contact)
        settled = {**self.settled, switch.contact: rest}
        return self._replace(missed=missed, settled=settled, unreported=unreported)

    def with_event(
        self,
        change: ContactChange,
        ruling: tuple[Ruling, str],
        innovations: Mapping[int, float],
        switched: Contacts = (),
        *,
        kind: Kind = Kind.IMPACT,
        is_dead: bool = False,
    ) -> "Ledger":
        """The same with notes on an event, and on the missed switches before the event.

        Args:
            change: the event.
            ruling: ruling and reason.
            innovations: absolute innovation by contact, in standard deviations.
            switched: the contacts that have switched; empty for those of the event.
            kind: how these contacts have switched.
            is_dead: whether the sensor does not report the bounces after it.
        """
        event = (change.stamp, change.sequence)
        inserted = [
            Note(
                event,
                change.stamp - round(each.ago * 1e9),
                each.contact,
                Ruling.INSERTED,
                f"{each.kind.name} {'in the dead time' if each.is_dead else 'missed'}: without it"
                f" the estimate would penetrate by {each.depth:.3g} standard deviations",
                switched=each.contact,
                kind=each.kind,
                is_dead=each.is_dead,
            )
            for each in self.missed
        ]
        own = [
            Note(event, change.stamp, i, *ruling, innovations.get(i, -1.0), j, kind, is_dead)
            for i, j in zip(change.contacts, switched or change.contacts, strict=True)
        ]
        notes = (*self.notes, *inserted, *own)
        first = max(len(notes) - TUNING.most_notes, 0)
        while first and notes[first - 1].event == notes[first].event:
            first -= 1  # the notes on one event stay together
        reported = {**self.reported, **dict.fromkeys(change.hit, change.t)}
        return self._replace(notes=notes[first:], missed=(), reported=reported)

    def without_event(self, change: ContactChange) -> "Ledger":
        """The same without the notes on an event, but for missed switches before the event."""
        event = (change.stamp, change.sequence)
        notes = (note for note in self.notes if note.event != event or note.is_inserted)
        return self._replace(notes=tuple(notes))

    def is_as_reported(self, event: tuple[int, int]) -> bool:
        """Whether ``event``, the latest, happened as reported, and nothing before the event.

        What the sensor could not report does not count.
        """
        latest = [*takewhile(lambda note: note.event == event, reversed(self.notes))]
        return all(
            note.is_dead or (note.ruling is Ruling.APPLIED and not note.reason) for note in latest
        )

    def closed_unreported(self, contact: int) -> bool:
        """Whether ``contact``, which is closed, was closed in the sensor's dead time."""
        latest = next((each for each in reversed(self.missed) if each.contact == contact), None)
        if latest is not None:
            return latest.is_dead
        notes = (each for each in reversed(self.notes) if each.switched == contact)
        return next((each.is_dead for each in notes), False)

    def notes_on(self, event: tuple[int, int]) -> list[Note]:
        """The notes on the contacts of ``event``, which is the latest."""
        latest = takewhile(lambda note: note.event == event, reversed(self.notes))
        return [note for note in latest if not note.is_inserted][::-1]
