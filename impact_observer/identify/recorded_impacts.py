# SPDX-License-Identifier: Apache-2.0
"""A recording to be explained: which impacts count, and which were missed."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from impact_observer.dynamics import ImpactLaw, Phases
from impact_observer.events import Kind
from impact_observer.filter.contact_change import ContactChange
from impact_observer.identify.fit_progress import FitProgress
from impact_observer.identify.problem import AT_STAMPS, Instants, Problem
from impact_observer.identify.sensor_rows import CountedSamples
from impact_observer.model.parameter_uncertainty import ParameterUncertainty
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.observer.episode import Episode, changes
from impact_observer.observer.event_order import EventKey
from impact_observer.options import Options
from impact_observer.stamps import from_seconds, seconds_between
from impact_observer.trajectory.linearised_system import FlightEnd

NEAR = 4.0
"""Standard deviations of a stamp within which a sample may be before an impact, or after it."""
Hit: TypeAlias = tuple[int, int]
"""A stamp, ns, and the index of a contact."""


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """Recorded events, with impacts rejected and inserted.

    Attributes:
        episode: the recorded events.
        rejected: impacts that are rejected as spurious.
        inserted: impacts that are taken for missed.
        sensors: samples of what is measured beside the impacts.
        clock: standard deviation of a stamp, s, declared or a first guess.
        is_declared: whether ``clock`` is declared.
        settled: impacts of bounces that settle; of each row the first stands for all, as the
            closing of its contact.
        instants: of the moments, as a smoothed motion has them; see ``Problem``.
        report: receives how far a fit is, and counts its flights.
        dead_time: after an event, in which the sensor reports no other hit of the contact, s.
        rows: switches that follow from the motion and that the sensor does not report: those of
            rows of bounces, of which it has reported the first edge, and openings.
        bouncing: closings that are such a first edge, and so impacts.
        is_debounced: whether closings are impacts of the sensor, taken as such first edges.
        mislabelled: probability that an event names another contact.
        named: contacts that events name, by the hit of another contact for which the event counts.
        prior: how well the given values of parameters are known; None if unknown.
        first_clock: error of the clock by which a prior is weighed at first, s.
    """

    episode: Episode
    rejected: frozenset[Hit] = field(default=frozenset())
    inserted: frozenset[Hit] = field(default=frozenset())
    sensors: tuple[CountedSamples, ...] = ()
    clock: float = 0.0
    is_declared: bool = True
    settled: frozenset[Hit] = field(default=frozenset())
    instants: Instants = field(default_factory=lambda: AT_STAMPS)
    report: FitProgress = field(default_factory=FitProgress)
    dead_time: float = 0.0
    rows: tuple[EventKey, ...] = ()
    bouncing: frozenset[Hit] = field(default=frozenset())
    is_debounced: bool = False
    mislabelled: float = Options.mislabelled
    named: Mapping[Hit, int] = field(default_factory=dict)
    prior: ParameterUncertainty | None = None
    first_clock: float = 0.0

    @property
    def counted_for_others(self) -> dict[Hit, int]:
        """The accepted hits that events report for another contact, and the index of that one."""
        return {hit: i for hit, i in self.named.items() if hit not in self.rejected}

    @property
    def rejected_events(self) -> frozenset[Hit]:
        """The rejected impacts, by the contacts that their events name."""
        return frozenset((hit[0], self.named.get(hit, hit[1])) for hit in self.rejected)

    @property
    def start(self) -> float:
        """The instant of the initial state, s since the epoch."""
        return seconds_between(self.episode.epoch, self.episode.start)

    @property
    def outliers(self) -> int:
        """Number of impacts that are rejected or inserted, but for those in a dead time."""
        return len(self.rejected) + len(self.inserted) - len(self.in_dead_time)

    @property
    def row_hits(self) -> frozenset[Hit]:
        """The hits of ``rows``."""
        return frozenset(
            (key.stamp, i)
            for key in self.rows
            for i, kind in key.switches
            if kind is not Kind.OPEN
        )

    @property
    def in_dead_time(self) -> set[Hit]:
        """The inserted impacts that the sensor could not report."""
        events = {(key.stamp, i) for key in self.episode.keys for i, _ in key.switches}
        after = from_seconds(self.dead_time + NEAR * self.clock)
        return {
            (stamp, i)
            for stamp, i in (self.inserted if self.dead_time else ())
            if any(0 <= stamp - at <= after for at, j in events - self.inserted if j == i)
        }

    def with_outliers(self, rejected: Iterable[Hit], inserted: Iterable[Hit]) -> "Recording":
        """The same events, with other impacts rejected and inserted."""
        return replace(self, rejected=frozenset(rejected), inserted=frozenset(inserted))

    def relabelled(self, struck: Mapping[Hit, int]) -> "Recording":
        """The same events, of which some count for another contact than before.

        ``struck`` are indices of the contacts by the hits as they count now. An event that says
        that the other contact switches too is left as it is.
        """
        named, keys = dict(self.named), []
        for key in self.episode.keys:
            own = {i for i, _ in key.switches}
            switches = []
            for i, kind in key.switches:
                to = struck.get((key.stamp, i), i)
                if to in own:
                    to = i
                else:
                    was = named.pop((key.stamp, i), i)
                    named |= {(key.stamp, to): was} if was != to else {}
                switches.append((to, kind))
            keys.append(key._replace(switches=tuple(sorted(switches))))
        return replace(self, episode=self.episode._replace(keys=keys), named=named)

    def hits(self) -> list[tuple[int, tuple[int, ...]]]:
        """Stamps (ns) and contacts of the accepted moments; no contacts where some only open."""
        return [(change.stamp, change.hit) for change in self._changes()]

    def _changes(self) -> Iterator[ContactChange]:
        """The accepted events, in order."""
        kept = []
        for key in self.episode.keys:
            switches = [
                (contact, Kind.IMPACT if (key.stamp, contact) in self.bouncing else kind)
                for contact, kind in key.switches
                if kind is Kind.OPEN or (key.stamp, contact) not in self.rejected
            ]
            kept.append(key._replace(switches=tuple(switches)))
        known = {(key.stamp, contact) for key in kept for contact, _ in key.switches}
        added = [
            EventKey(stamp, 0, ((contact, Kind.IMPACT),))
            for stamp, contact in self.inserted - known
        ]
        keys = sorted([*(key for key in kept if key.switches), *added, *self.rows])
        return changes(keys, self.episode.epoch)

    def problem(self, family: ParametricFamily) -> Problem:
        """The problem that a fit of ``family`` solves.

        Raises:
            ImpactLawError: the impact law has no solution at an event.
        """
        newton, phases = ImpactLaw(family.system), Phases(family.system)
        moments, unmeasured = [], self.inserted | self.row_hits
        for change in self._changes():
            inserted = any((change.stamp, i) in unmeasured for i in change.hit)
            moments.append(FlightEnd.of_change(change, newton, phases, measured=not inserted))
        sensors = self._certain()
        clock = self.clock, self.is_declared
        problem = Problem(family, moments, self.start, sensors, *clock, self.instants, self.report)
        return problem if self.prior is None else problem.with_prior(self.prior, self.first_clock)

    def _certain(self) -> tuple[CountedSamples, ...]:
        """Samples that are certain to be outside any impact."""
        hits = [key.stamp for key in self.episode.keys] + [stamp for stamp, _ in self.inserted]
        impacts = np.array([seconds_between(self.episode.epoch, s) for s in sorted({*hits})])
        margin = NEAR * self.clock
        return tuple(each.away_from(impacts, margin) for each in self.sensors)
