"""What an observer made of the events of a recording, by its final verdicts."""

from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from impact_observer.events import ImpactEvent, Ruling, Verdict, final_rulings
from impact_observer.observer.event_order import hits
from impact_observer.states import Stamps


@dataclass(frozen=True, slots=True, eq=False)
class EventOutcomes:
    """What an observer made of the events.

    Attributes:
        instants: stamps of what it applied or inserted, openings included, ns, ascending,
            shape (events,).
        told: those of them that events told, which an estimate may be too early to know of,
            shape (told,); an impact that was inserted has no event to wait for.
        impacts: stamp (ns) and contact of each impact among them, ascending.
        rulings: how many switches it applied, rejected and inserted in the end, insertions that
            it has taken back left out; None where it published no verdicts, and is taken to have
            applied all.
    """

    instants: Stamps
    told: Stamps
    impacts: tuple[tuple[int, str], ...]
    rulings: Counter[Ruling] | None

    def until(self, stamp: int) -> int:
        """How many impacts it had used at ``stamp`` (ns)."""
        return sum(at <= stamp for at, _ in self.impacts)


def outcomes_of(
    events: Iterable[ImpactEvent], verdicts: Iterable[Verdict] | None
) -> EventOutcomes:
    """What an observer made of ``events``.

    Args:
        events: all that there are.
        verdicts: all that it gave; None where it published none.
    """
    every = [*events]
    told = sorted({(stamp, contact) for stamp, contact, _ in hits(every)})
    stamps = np.unique(np.array([event.stamp for event in every], dtype=np.int64))
    if verdicts is None:
        return EventOutcomes(stamps, stamps, tuple(told), None)
    last = final_rulings(verdicts)
    used = {(s, contact) for (s, _, contact), r in last.items() if r is not Ruling.REJECTED}
    inserted = {(s, contact) for (s, _, contact), r in last.items() if r is Ruling.INSERTED}
    # A verdict without a contact is on the whole event.
    impacts = {(s, c) for s, c in told if (s, c) in used or (s, "") in used} | inserted
    instants = np.array(sorted({stamp for stamp, _ in used}), dtype=np.int64)
    both = np.intersect1d(instants, stamps)
    return EventOutcomes(
        instants, both, tuple(sorted(impacts)), count_rulings(last, set(stamps.tolist()))
    )


def count_rulings(
    last: Mapping[tuple[int, int, str], Ruling], told: Collection[int]
) -> Counter[Ruling]:
    """How many switches have each ruling in the end.

    An insertion that was taken back is none: its stamp is not one of those ``told`` (ns), and
    nothing that came from the sensor was rejected.
    """
    rejected = Ruling.REJECTED
    return Counter(r for (stamp, _, _), r in last.items() if r is not rejected or stamp in told)
