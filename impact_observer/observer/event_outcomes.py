# SPDX-License-Identifier: Apache-2.0
"""Which events of a recording an observer applied, rejected or inserted in the end."""

from bisect import bisect_right
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from impact_observer.events import ImpactEvent, Ruling, Verdict, final_rulings
from impact_observer.observer.event_order import impacts_of
from impact_observer.states import Stamps


@dataclass(frozen=True, slots=True, eq=False)
class EventOutcomes:
    """The events that an observer used, by its final verdicts; stamps are in ns, ascending.

    Attributes:
        instants: stamps of events applied or inserted, openings included, shape (events,).
        reported: those of ``instants`` at which an event was reported, shape (reported,). An
            estimate may be published before the event arrives; an inserted impact has no event.
        impacts: stamp and contact of each impact applied or inserted.
        rulings: how many switches were finally applied, rejected and inserted, without
            insertions that were withdrawn; None without verdicts. All events then count as
            applied.
        hits: stamps of all impacts that were reported or that the observer inserted.
        measured: how many samples of sensors were used, and how many were not, by the verdicts on
            samples; None without such verdicts.
    """

    instants: Stamps
    reported: Stamps
    impacts: tuple[tuple[int, str], ...]
    rulings: Counter[Ruling] | None
    hits: tuple[int, ...] = ()
    measured: tuple[int, int] | None = None

    def until(self, stamp: int) -> int:
        """How many impacts had been used at ``stamp`` (ns)."""
        return bisect_right(self.impacts, stamp, key=lambda impact: impact[0])


def outcomes_of(
    events: Iterable[ImpactEvent], verdicts: Iterable[Verdict] | None
) -> EventOutcomes:
    """The outcomes of all ``events``; ``verdicts`` are None where none were published."""
    every = [*events]
    impacts = sorted({(stamp, contact) for stamp, contact, _ in impacts_of(every)})
    stamps = np.unique(np.array([event.stamp for event in every], dtype=np.int64))
    if verdicts is None:
        hits = tuple(sorted({stamp for stamp, _ in impacts}))
        return EventOutcomes(stamps, stamps, tuple(impacts), None, hits)
    last = final_rulings(verdicts)
    used = {(s, contact) for (s, _, contact), r in last.items() if r is not Ruling.REJECTED}
    inserted = {(s, contact) for (s, _, contact), r in last.items() if r is Ruling.INSERTED}
    # A verdict without a contact is on the whole event.
    applied = {(s, c) for s, c in impacts if (s, c) in used or (s, "") in used} | inserted
    instants = np.array(sorted({stamp for stamp, _ in used}), dtype=np.int64)
    reported = np.intersect1d(instants, stamps)
    rulings = count_rulings(last, set(stamps.tolist()))
    hits = tuple(sorted({stamp for stamp, _ in {*impacts, *inserted}}))
    return EventOutcomes(instants, reported, tuple(sorted(applied)), rulings, hits)


def count_rulings(
    last: Mapping[tuple[int, int, str], Ruling], reported: Collection[int]
) -> Counter[Ruling]:
    """How many switches have each final ruling.

    A rejection at a stamp at which no event was ``reported`` (ns) withdraws an insertion, and is
    not counted.
    """
    return Counter(
        r for (stamp, *_), r in last.items() if r is not Ruling.REJECTED or stamp in reported
    )
