# SPDX-License-Identifier: Apache-2.0
"""Notes on events: what each hypothesis decides, in words."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from impact_observer.bank.balance import ImpactState
from impact_observer.bank.bank import (
    MISSED,
    OTHER,
    RESTART,
    SPURIOUS,
    TRUE,
    Hypotheses,
    Missed,
    objects,
)
from impact_observer.events import MISLABELLED, Contacts, Ruling
from impact_observer.stamps import Elapsed

_KEPT = 64
"""Notes of each hypothesis that are kept, and those on the same event as the oldest of them."""


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
        state: at the impact; None for an event that is none.
    """

    event: tuple[int, int]
    stamp: int
    contact: int
    ruling: Ruling
    reason: str = ""
    innovation: float = -1.0
    switched: int = -1
    state: ImpactState | None = None

    @property
    def is_inserted(self) -> bool:
        """Whether it is on a missed impact that the hypothesis inserts."""
        return self.ruling is Ruling.INSERTED

    @property
    def decision(self) -> tuple[object, ...]:
        """The decision without its numbers, which follow the colon of the reason."""
        return self.event, self.contact, self.ruling, self.reason.partition(":")[0]


class Event(NamedTuple):
    """What a sensor reports at one instant.

    Attributes:
        hit: contacts that hit.
        closed: those of them that stay closed.
        opened: contacts that open; those that hit have been open before, unreported.
        stamp: ns.
        sequence: number of the event.
    """

    hit: Contacts
    closed: Contacts = ()
    opened: Contacts = ()
    stamp: int = 0
    sequence: int = 0

    @property
    def key(self) -> tuple[int, int]:
        """Stamp and sequence."""
        return self.stamp, self.sequence


def decided(
    rows: Hypotheses,
    at: tuple[Event, Elapsed],
    kind: tuple[int, str],
    sizes: Sequence[float],
    states: Sequence[ImpactState | None],
) -> Hypotheses:
    """Hypotheses that have decided on an event.

    Args:
        rows: the hypotheses.
        at: the event, and its instant, s since the epoch.
        kind: ``TRUE``, ``SPURIOUS``, ``OTHER`` or ``RESTART``, and the name of the other contact.
        sizes: innovations in standard deviations; -1 for none.
        states: at the impact; None for an event that is none.
    """
    event, t = at
    decision, name = kind
    ruling, reason = {
        TRUE: (Ruling.APPLIED, ""),
        SPURIOUS: (Ruling.REJECTED, "no motion has this impact"),
        OTHER: (Ruling.APPLIED, f"{MISLABELLED}{name}"),
        RESTART: (Ruling.APPLIED, "restart: the estimate before it is rejected"),
    }[decision]
    notes, hit = [], event.hit if states[0] is None else states[0].contacts
    for k, (size, state) in enumerate(zip(sizes, states, strict=True)):
        inserted = tuple(_inserted(each, event, t) for each in rows.missed[k])
        own = tuple(
            Note(event.key, event.stamp, i, ruling, reason, size, other, state)
            for i, other in zip(event.hit, hit, strict=True)
        )
        notes.append(_latest((*rows.notes[k], *inserted, *own)))
    past = rows.decided(8 * hit[0] + decision)
    return rows._replace(
        past=past,
        notes=objects(notes),
        missed=objects([()] * rows.size),
        sunk=np.zeros(rows.size),
    )


def _latest(notes: tuple[Note, ...]) -> tuple[Note, ...]:
    """The notes that are kept: no event keeps a part of its notes."""
    first = max(len(notes) - _KEPT, 0)
    while first and notes[first - 1].event == notes[first].event:
        first -= 1
    return notes[first:]


def _inserted(each: Missed, event: Event, t: Elapsed) -> Note:
    why = "in the dead time" if each.is_dead else "missed"
    return Note(
        event.key,
        event.stamp - round((t - each.t) * 1e9),
        each.contact,
        Ruling.INSERTED,
        f"IMPACT {why}: without it the estimate would penetrate by {each.depth:.3g} standard"
        " deviations",
        switched=each.contact,
        state=each.state,
    )


def with_missed(rows: Hypotheses, missed: Sequence[Missed]) -> Hypotheses:
    """Hypotheses each with one more impact that was not reported."""
    every = [(*before, each) for before, each in zip(rows.missed, missed, strict=True)]
    contacts = np.array([each.contact for each in missed], dtype=np.intp)
    return rows._replace(past=rows.decided(8 * contacts + MISSED), missed=objects(every))
