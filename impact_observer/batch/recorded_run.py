# SPDX-License-Identifier: Apache-2.0
"""One run of the sender in a recording: its events, and accounts of their meaning."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from impact_observer.batch.filter_account import TracedLaw, filter_moments
from impact_observer.batch.moments import Moment, Moments, MomentSwitching
from impact_observer.batch.noise_sizes import ROUNDED
from impact_observer.dynamics import ImpactLaw, Phases
from impact_observer.errors import BagError
from impact_observer.events import MISLABELLED, ImpactEvent, Kind, Ruling, Verdict
from impact_observer.model import System
from impact_observer.model.free_parameters import is_observed
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.observer import Options, make_observer
from impact_observer.observer.contact_change import ContactChange
from impact_observer.observer.event_order import EventKey, keys_of, switched
from impact_observer.observer.sender_runs import runs_of
from impact_observer.observer.unknown_parameters import UnknownParameters
from impact_observer.stamps import Elapsed, seconds_between
from impact_observer.states import Matrix, Vector

_FEW_IN_FLIGHT = 10
"""Multiples of a step in the usual flight, of which a step is no resolution of a clock."""


@dataclass(frozen=True, slots=True, eq=False)
class RecordedRun:
    """The events of one run of the sender.

    Attributes:
        system: the system that they are of.
        events: in order of reception.
        epoch: stamp of ``t = 0`` of the forcing, ns.
        start: stamp of the initial state, ns.
        keys: the events, each once and in order, from the start on.
    """

    system: System
    events: Sequence[ImpactEvent]
    epoch: int
    start: int
    keys: Sequence[EventKey]

    @classmethod
    def of(cls, system: System, events: Sequence[ImpactEvent], epoch: int = 0) -> "RecordedRun":
        """The run of ``events``; the initial state is at the epoch if the first event is there."""
        epoch = epoch or max(each.epoch for each in events)
        first = min((e.sequence for e in events if e.sequence), default=0)
        begun = min(each.stamp for each in events)
        start = epoch if epoch and first <= 1 and epoch <= begun else begun
        index = {name: i for i, name in enumerate(system.contact_names)}
        keys = [key for key in keys_of(events, index) if key.stamp >= start]
        return cls(system, events, epoch or start, start, keys)

    @classmethod
    def last(cls, system: System, events: Sequence[ImpactEvent]) -> "RecordedRun":
        """The last run of ``events``, in order of reception.

        Raises:
            BagError: it contains no impact of the system's contacts.
        """
        runs = runs_of(events)
        run = cls.of(system, runs[-1]) if runs else None
        if run is None or not any(change.hit for change in run.changes()):
            named = {s.contact for each in runs[-1:] for e in each for s in e.switches}
            own = system.contact_names
            wanted, others = (", ".join(each) or "none" for each in (own, sorted(named - {*own})))
            raise BagError(
                f"contains no impact of the model's contacts ({wanted}); others in it: {others}"
            )
        return run

    @property
    def resolution(self) -> float:
        """What the times between the stamps are multiples of, s; 0 where this is chance."""
        flights = np.diff(np.unique([key.stamp for key in self.keys]))
        step = int(np.gcd.reduce(flights))
        few = _FEW_IN_FLIGHT * step > np.median(flights) if flights.size > 1 else True
        return 0.0 if few or step == 1 else seconds_between(0, step)

    @property
    def rounding(self) -> float:
        """Standard deviation of stamps that are wrong by their rounding only, s."""
        return max(self.resolution / float(np.sqrt(12)), ROUNDED)

    def reported(self) -> Moments:
        """The moments if all events are as they were reported."""
        return self._moments([(change, True) for change in self.changes()])

    def changes(self) -> Iterator[ContactChange]:
        """The changes of the contacts at each event, with seconds since the epoch."""
        for key, closed, switches in switched(self.keys):
            t = seconds_between(self.epoch, key.stamp)
            yield ContactChange.of(t, closed, switches, stamp=key.stamp, sequence=key.sequence)

    def by_filter(
        self,
        family: ParametricFamily,
        theta: Vector,
        covariance: Matrix,
        options: Options,
        show: Callable[[str], None],
    ) -> Moments:
        """The moments as a filter understands the events.

        Args:
            family: the system and its parameters.
            theta: their values, shape (p,).
            covariance: of these, shape (p, p).
            options: of the observer.
            show: receives what is being done.

        Raises:
            ImpactLawError, UsageError: as ``Observer.receive``.
        """
        near, own = _filter_family(family, theta)
        unknowns = UnknownParameters(near, covariance[np.ix_(own, own)]) if near.size else None
        chosen = replace(options, law=TracedLaw.name, ensemble=1, epoch=self.epoch)
        observer = make_observer(near.system, chosen, law=TracedLaw, unknowns=unknowns)

        def done(count: int) -> None:
            show(f"missing or false impacts: {count} of {len(self.keys)}")

        found = filter_moments(observer, self.events, done)
        return self._moments([(each.change, each.is_measured) for each in found])

    def verdicts(self, moments: Moments) -> Iterator[Verdict]:
        """The verdicts on all events by an account, in the order of stamps."""
        names, found = self.system.contact_names, list[Verdict]()
        own = {(each.stamp, each.sequence): each for each in moments.each if each.is_measured}
        for key in self.keys:
            moment = own.get((key.stamp, key.sequence))
            switching = moment.switching if moment else MomentSwitching((), ())
            struck = {*switching.hit}
            for i, kind in key.switches:
                ruling, reason = Ruling.APPLIED, ""
                if kind is not Kind.OPEN and i not in struck:
                    other = struck - {j for j, _ in key.switches}
                    ruling = Ruling.APPLIED if other else Ruling.REJECTED
                    reason = f"{MISLABELLED}{names[min(other)]}" if other else "no motion has it"
                found.append(Verdict(key.stamp, ruling, key.sequence, names[i], reason))
        for moment in moments.each:
            if not moment.is_measured:
                found += [
                    Verdict(moment.stamp, Ruling.INSERTED, contact=names[i], reason="missed")
                    for i in moment.switching.hit
                ]
        foreign = {
            Verdict(each.stamp, Ruling.UNKNOWN_CONTACT, each.sequence, switch.contact)
            for each in self.events
            for switch in each.switches
            if switch.contact not in names
        }
        yield from sorted([*found, *foreign], key=lambda v: (v.stamp, v.sequence))

    def _moments(self, every: Sequence[tuple[ContactChange, bool]]) -> Moments:
        newton, phases, found = ImpactLaw(self.system), Phases(self.system), list[Moment]()
        for change, is_measured in every:
            if change.is_nothing:
                continue
            towards = -np.ones(len(change.hit))
            pressed = change.pressed(newton, towards) if change.hit else ()
            closed = phases.independent(change.before), phases.independent(change.closed)
            switching = MomentSwitching(change.hit, pressed, *closed)
            t = Elapsed(change.stamp - self.epoch)
            found.append(Moment(t, switching, is_measured, change.stamp, change.sequence))
        return Moments(Elapsed(self.start - self.epoch), found)


def _filter_family(family: ParametricFamily, theta: Vector) -> tuple[ParametricFamily, list[int]]:
    """Return the family about other values, and which of its parameters a filter can learn.

    What moves comes first in a filter.
    """
    own = sorted(
        (j for j, each in enumerate(family.parameters) if is_observed(each.name)),
        key=lambda j: not family.parameters[j].moves,
    )
    parameters = tuple(replace(family.parameters[j], value=float(theta[j])) for j in own)
    system = family.near(theta) if family.size else family.system
    return ParametricFamily(system, parameters), own
