"""A recording to be explained: which of its switches are believed, and what was not heard."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from impact_observer.dynamics import ImpactLaw, Phases
from impact_observer.estimation.contact_change import ContactChange
from impact_observer.events import Kind
from impact_observer.identify.least_squares import Problem
from impact_observer.identify.motion import FlightEnd
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.observer.episode import Episode, changes
from impact_observer.observer.event_order import EventKey
from impact_observer.stamps import seconds_between

Hit: TypeAlias = tuple[int, int]
"""A stamp, ns, and the index of a contact."""


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """What was heard, and what is made of it.

    Attributes:
        told: what was heard.
        doubted: impacts that are not believed.
        inserted: impacts that nobody heard, and that the motion cannot do without.
    """

    told: Episode
    doubted: frozenset[Hit] = field(default=frozenset())
    inserted: frozenset[Hit] = field(default=frozenset())

    @property
    def start(self) -> float:
        """Where the initial state holds, s since the epoch."""
        return seconds_between(self.told.epoch, self.told.start)

    def marked(self, doubted: Iterable[Hit], inserted: Iterable[Hit]) -> "Recording":
        """The same, and other impacts believed."""
        return replace(self, doubted=frozenset(doubted), inserted=frozenset(inserted))

    @property
    def _keys(self) -> list[EventKey]:
        """The events that are believed, in order."""
        kept = [
            key._replace(switches=tuple(s for s in key.switches if not self._doubts(key, s)))
            for key in self.told.keys
        ]
        added = [EventKey(stamp, 0, ((contact, Kind.IMPACT),)) for stamp, contact in self.inserted]
        return sorted([*(key for key in kept if key.switches), *added])

    def _doubts(self, key: EventKey, switch: tuple[int, Kind]) -> bool:
        return switch[1] is not Kind.OPEN and (key.stamp, switch[0]) in self.doubted

    def hits(self) -> list[tuple[int, tuple[int, ...]]]:
        """Stamps (ns) and contacts of the believed moments at which something hits."""
        return [(change.stamp, change.hit) for change in self._touches()]

    def _touches(self) -> Iterator[ContactChange]:
        return changes(self._keys, self.told.epoch)

    def problem(self, family: ParametricFamily) -> Problem:
        """What a motion has to explain.

        Raises:
            ImpactLawError: the impact law has no solution at an event.
        """
        newton, phases = ImpactLaw(family.system), Phases(family.system)
        moments = []
        for change in self._touches():
            pressed = change.pressed(newton, -np.ones(len(change.hit))) if change.hit else ()
            inserted = any((change.stamp, i) in self.inserted for i in change.hit)
            held = phases.independent(change.closed)
            moments.append(FlightEnd(change.t, change.hit, pressed, held, not inserted))
        return Problem(family, moments, self.start)
