# SPDX-License-Identifier: Apache-2.0
"""The history of one run of the sender: its events, and the estimates between the events."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from math import isfinite

import numpy as np

from impact_observer.dynamics import mechanism_of
from impact_observer.errors import (
    DynamicsError,
    ImpactLawError,
    ImpactObserverError,
    UsageError,
)
from impact_observer.events import (
    Contacts,
    ImpactEstimate,
    Kind,
    Remark,
    Ruling,
    Verdict,
)
from impact_observer.observer.belief import Belief, Prediction
from impact_observer.observer.contact_change import ContactChange
from impact_observer.observer.encoder_start import EncoderStart
from impact_observer.observer.episode import require_epoch
from impact_observer.observer.event_order import EventKey, Superseding, interpret
from impact_observer.observer.impact_sides import ImpactSides, Near
from impact_observer.observer.laws.law import Law
from impact_observer.observer.readings import DeclaredSensor, Reading, SampleOutcome
from impact_observer.observer.sequence_numbers import SequenceNumbers
from impact_observer.observer.synchronization import SynchronizationTest
from impact_observer.observer.timeline import Entry, Insertion, Timeline, outcome
from impact_observer.observer.verdicts import IssuedVerdicts
from impact_observer.stamps import NS_PER_S, Elapsed, from_seconds, seconds_between, text
from impact_observer.states import (
    NO_COVARIANCE,
    Estimate,
    Estimates,
    Matrix,
    Stamps,
    Vector,
)
from impact_observer.turns import give_turn

MOST_EVENTS = 5000
"""Events of the history that are kept, whatever its length."""
MOST_MEASURED = 20_000
"""Samples of sensors that are kept beside the events."""

Refusal = tuple[Ruling, str, Remark]
"""Why an event is refused: ruling, reason, and the remark that is counted."""


class RunHistory:
    """The events of one run of the sender: beliefs after events, and estimates between them.

    Attributes:
        law: the law that corrects and predicts the belief.
        test: the test of the replicas' synchronization.
        epoch: stamp of ``t = 0`` of the forcing, ns; 0 while unknown.
        sensors: the sensors beside the impacts.
        timeline: the events with their beliefs; None before the first event or a given epoch.
        numbers: the sequence numbers of the events.
        encoders: where a robot starts; None for the epoch or the first stamp.
    """

    def __init__(
        self,
        law: Law,
        test: SynchronizationTest,
        epoch: int,
        *,
        first_entry: Callable[[int], Entry],
        history: int,
        sensors: Sequence[DeclaredSensor] = (),
        encoders: EncoderStart | None = None,
    ) -> None:
        """Start with no event.

        Args:
            law: as the attribute, like ``test``, ``epoch``, ``sensors`` and ``encoders``.
            test: of the synchronization.
            epoch: of the run, or 0.
            first_entry: the initial state at a stamp (ns), before any event.
            history: how late an event may be and still be applied, ns.
            sensors: beside the impacts.
            encoders: of a robot.
        """
        self.law, self.test, self.epoch = law, test, epoch
        self.sensors, self.encoders = sensors, encoders
        self.timeline: Timeline | None = None
        self.numbers = SequenceNumbers()
        self._first_entry, self._history = first_entry, history
        self._system = law.system
        self._mechanism = mechanism_of(law.system)
        self._names = self._system.contact_names
        self._sides = ImpactSides(law)
        self._issued = IssuedVerdicts(self._names)
        self._is_state_given = False
        self._earliest = 0

    def begin(self, stamp: int) -> None:
        """Have the initial state hold at ``stamp`` (ns)."""
        self.timeline = self._timeline_from(stamp)

    def _timeline_from(self, stamp: int) -> Timeline:
        """The initial state at a stamp (ns)."""
        return Timeline(self._first_entry(stamp), self.apply)

    def go_on_from(self, stamp: int) -> bool:
        """Forget the past before ``stamp`` (ns) if no event is later; returns whether so."""
        timeline = self.timeline
        if timeline is None or timeline.entries[-1].since >= stamp:
            return False
        entry = timeline.entries[-1]
        belief = self.prediction(entry).belief(seconds_between(entry.since, stamp))
        timeline.go_on_from(stamp, belief)
        self._is_state_given = True
        return True

    def rerun(self, stamp: int) -> None:
        """Take note that live signals have changed from ``stamp`` (ns) on."""
        timeline = self.timeline
        if timeline is None:
            return
        start = timeline.start.stamp
        if stamp <= start and timeline.is_complete and not self._is_state_given:
            timeline.restart(self._first_entry(start))
        else:
            timeline.rerun(stamp)

    def restart(self, first: Entry) -> None:
        """Go on from another state, which holds after all events of its stamp."""
        assert self.timeline is not None, "it has begun"
        self.timeline.restart(first, after=True)
        self._is_state_given = True

    @property
    def last_event(self) -> int:
        """Stamp of the latest event applied, ns; 0 before the first."""
        return self.timeline.entries[-1].last[0] if self.timeline else 0

    def require_epoch(self) -> None:
        """Raise UsageError where the forcing depends on time and its epoch is unknown."""
        require_epoch(self._system, self.epoch)

    def too_old(self, stamp: int) -> Refusal | None:
        """Why an event at ``stamp`` (ns) is too late to be applied; None if not too late."""
        timeline = self.timeline
        if timeline is not None:
            last = timeline.entries[-1]
            if timeline.newest.stamp <= stamp < last.since:
                return Ruling.TOO_LATE, _before(last.since), Remark.TOO_LATE
        if timeline is None or stamp >= self._earliest:
            return None
        start = self.last_event - self._history
        if stamp >= start:
            return None
        return Ruling.TOO_LATE, _before(max(start, timeline.start.stamp)), Remark.TOO_LATE

    def timeline_from_start(self, stamp: int) -> Timeline:
        """The timeline, begun at the start by all events so far and an event at ``stamp``."""
        if stamp < self._earliest or not self._earliest:
            self._earliest = stamp
        epoch = self.epoch
        is_first_received = self.numbers.first <= 1
        start = epoch if epoch and is_first_received else self._earliest
        if self.encoders is not None:
            start = self.encoders.stamp
        timeline = self.timeline
        if timeline is None:
            timeline = self.timeline = self._timeline_from(start)
        elif timeline.start.stamp != start and timeline.is_complete and not self._is_state_given:
            timeline.restart(self._first_entry(start))
        return timeline

    def verdicts(
        self, received: Sequence[tuple[tuple[Verdict, ...], Insertion]]
    ) -> tuple[list[tuple[Verdict, ...]], tuple[Verdict, ...]]:
        """The verdicts on inserted events, and on others; too old entries are forgotten.

        The events are ``received`` in order of their stamps, each with its verdicts.
        """
        timeline = self.timeline
        assert timeline is not None, "events were inserted"
        first = received[0][1].entry.key.stamp
        self._forget(timeline)
        # Verdicts on forgotten events are final, even if the inserted event is late.
        return self._issued.complete(received, max(first - self._history, timeline.start.stamp))

    def _forget(self, timeline: Timeline) -> None:
        """Forget entries that are older than the history."""
        most = MOST_EVENTS + MOST_MEASURED if self.sensors else MOST_EVENTS
        if timeline.forget_before(timeline.newest.stamp - self._history, most):
            self._issued.forget_before(timeline.start.stamp)

    def measure(
        self, keys: Iterable[EventKey]
    ) -> tuple[list[tuple[EventKey, SampleOutcome]], tuple[Verdict, ...]]:
        """Put samples into their places; late samples together, so that events run again once.

        Returns:
            The outcome of each; and verdicts on events that samples have changed.
        """
        ordered = sorted(set(keys))
        timeline = self.timeline_from_start(ordered[0].stamp)
        first, last = ordered[0].stamp, ordered[-1].stamp
        if timeline.newest.stamp < first == last and len({e.sensor for e in ordered}) == len(
            ordered
        ):
            return self._measure_next(timeline, ordered)
        refused, new = list[tuple[EventKey, SampleOutcome]](), list[EventKey]()
        for key in ordered:
            reason = ""
            if not timeline.accepts(key):
                reason = f"too late: {_before(timeline.start.stamp)}"
            elif timeline.has_sample(*key[:2]) or (new and new[-1][:2] == key[:2]):
                reason = "the sensor has another sample of the same stamp"
            if reason:
                refused.append((key, SampleOutcome(0.0, -1.0, False, reason)))
            else:
                new.append(key)
        result = outcome(timeline.inserting(new))
        refused += [(k, SampleOutcome(0.0, -1.0, False, str(e))) for k, e in result.failed.items()]
        self._forget(timeline)
        made = result.insertions
        outcomes = [(m.entry.key, m.entry.outcome) for m in made if m.entry.outcome is not None]
        return [*refused, *outcomes], self._revisions(made[-1]) if made else ()

    def _measure_next(
        self, timeline: Timeline, keys: Sequence[EventKey]
    ) -> tuple[list[tuple[EventKey, SampleOutcome]], tuple[Verdict, ...]]:
        """Append samples of a stamp that is later than all entries: the usual case."""
        try:
            entries = self._measured(timeline.entries[-1], keys)
        except ImpactObserverError as error:
            return [(key, SampleOutcome(0.0, -1.0, False, str(error))) for key in keys], ()
        timeline.entries += entries
        self._forget(timeline)
        outcomes = [(e.key, e.outcome) for e in entries if e.outcome is not None]
        return outcomes, self._revisions(Insertion(entries[-1]))

    def _revisions(self, insertion: Insertion) -> tuple[Verdict, ...]:
        """Verdicts on events, where samples have made another account of them the likeliest."""
        timeline = self.timeline
        assert timeline is not None, "samples were inserted"
        if self._issued.are_of(timeline.entries[-1]):
            return ()
        start = max(insertion.entry.key.stamp - self._history, timeline.start.stamp)
        return self._issued.complete([((), insertion)], start)[1]

    def impact(self, verdict: Verdict) -> ImpactEstimate | None:
        """See ``Observer.impact``."""
        timeline, names = self.timeline, self._names
        contacts = verdict.contact, verdict.hit_contact
        if timeline is None or not {*contacts} <= {*names}:
            return None
        reported, hit = map(names.index, contacts)
        if verdict.ruling is Ruling.INSERTED:
            before, entry = timeline.entry_at(verdict.stamp), None
            stamp, hits = verdict.stamp, {hit}
            held = self.prediction(before).closed(seconds_between(before.since, stamp))
            closed = before.closed if held is None else held
        elif (found := timeline.around(verdict.stamp, verdict.sequence, reported)) is not None:
            before, entry = found
            stamp, closed, kinds = entry.since, before.closed, entry.key.switches
            hits = {hit if i == reported else i for i, kind in kinds if kind is not Kind.OPEN}
        else:
            return None
        if hit not in hits or (entry is None and hit in closed):  # a release
            return None
        change = ContactChange(
            Elapsed(stamp - (self.epoch or stamp)),
            closed,
            tuple(sorted(hits)),
            closed,
            verdict.stamp,
            verdict.sequence,
            seconds_between(before.since, stamp),
        )
        after, prediction = None if entry is None else entry.belief, self.prediction(before)
        balance = self.law.impact_balance(change, before.belief, prediction, after)
        own, stamp = balance.rows[change.hit.index(hit)], stamp - from_seconds(balance.early)
        return ImpactEstimate(stamp, names[hit], verdict.ruling, verdict.sequence, *own.tolist())

    def estimate(self, stamp: int) -> Estimate:
        """See ``Observer.estimate``."""
        law, entry = self.law, self._entry(stamp)
        belief, prediction = entry.belief, self.prediction(entry)
        n, s = self._system.n, seconds_between(entry.since, stamp)
        x, root = (prediction.state(s), prediction.root(s)) if s > 0 else (belief.x, belief.root)
        if root is None and law.has_covariance:  # the root after a sample is found on request
            root = prediction.root(0.0)
        closed, silence = prediction.closed(s), prediction.silence(s)
        covariance = NO_COVARIANCE
        if root is not None:
            both, sizes = self._both_sides(entry, s, x, root, closed), self._mechanism.sizes(x, s)
            covariance = law.uncertainty.published_covariance(both, x, sizes)
        if self._system.frame is not None:
            x = self._from_frame(np.array([stamp]), x[None])[0]
        return Estimate(
            stamp=stamp,
            law=law.name,
            q=x[:n],
            u=x[n:],
            covariance=covariance,
            closed=tuple([self._names[i] for i in (entry.closed if closed is None else closed)]),
            convergence=entry.synchronization.convergence,
            synchronized=law.uses_events and not silence and self._is_synchronized(entry, root),
            bound=-1.0 if belief.bound is None else belief.bound,
            inconsistent=belief.inconsistent,
            misfit=belief.misfit or silence,
            clock_offset=belief.clock_offset,
            parameters=belief.parameters,
            last_sequence=entry.last[1],
            last_event=entry.last[0],
        )

    def _is_synchronized(self, entry: Entry, root: Matrix | None) -> bool:
        """Whether an estimate some time after an entry is, which has a ``root`` if any."""
        doubt = None if root is None else self.law.doubt(entry.belief, root)
        return self.test.is_synchronized(entry.synchronization) if doubt is None else not doubt

    def _entry(self, stamp: int) -> Entry:
        """The last entry up to ``stamp`` (ns).

        Raises:
            UsageError: as ``Observer.estimate``.
        """
        timeline = self.timeline
        if timeline is None or stamp < timeline.start.stamp:
            past = "no event has come"
            if timeline is not None:
                past = f"the history starts at {text(timeline.start.stamp)} s"
            raise UsageError(f"estimate at {text(stamp)} s: {past}")
        self.require_epoch()
        return timeline.entry_at(stamp)

    def obstacle(self, stamp: int) -> str:
        """See ``Observer.obstacle``."""
        entry, law = self._entry(stamp), self.law
        if not law.uses_events:
            return f"{law.name} uses no events"
        if law.has_covariance:
            after = max(seconds_between(entry.since, stamp), 0.0)
            prediction = self.prediction(entry)
            if prediction.silence(after):
                return "predicted impacts are not reported"
            root = prediction.root(after)
            if root is not None and (doubt := law.doubt(entry.belief, root)) is not None:
                return doubt
        return self.test.obstacle(entry.synchronization)

    def silence(self, stamp: int) -> str:
        """See ``Observer.silence``."""
        entry = self._entry(stamp)
        return self.prediction(entry).silence(seconds_between(entry.since, stamp))

    def _both_sides(
        self, entry: Entry, s: float, x: Vector, root: Matrix, closed: Contacts | None
    ) -> Matrix:
        """``root``; near an uncertain impact with the errors of ``x`` on the other side."""
        belief, closed = entry.belief, entry.closed if closed is None else closed
        near = Near(belief.clock_deviation, belief.onset, belief.x, self._start_of(entry) + s)
        errors = self._sides.errors(near, x, root, s, closed)
        return np.column_stack([root, *errors]) if errors else root

    def estimates(self, stamps: Stamps, *, replicas: bool) -> Iterator[Estimates]:
        """See ``Observer.estimates``."""
        while stamps.size:
            first = self.estimate(int(stamps[0]))
            assert self.timeline is not None, "there is an estimate"
            x, count = np.concatenate([first.q, first.u])[None], 1
            entry, end = self.timeline.interval(first.stamp)
            if (prediction := self.prediction(entry)).is_plain or replicas:
                count = stamps.size if end is None else int(np.searchsorted(stamps, end))
            if replicas:
                here = stamps[:count]
                every = self._replicas(prediction, entry, here)
                yield Estimates(first, here, every[0], every)
                stamps = stamps[count:]
                continue
            if count > 1:
                s = np.array([seconds_between(entry.since, at) for at in stamps[1:count].tolist()])
                states = prediction.states(s)
                later = self._from_frame(stamps[1:count], states)
                x = np.concatenate([x, np.where(s[:, None] > 0, later, x)])
            yield Estimates(first, stamps[:count], x)
            stamps = stamps[count:]

    def _replicas(self, prediction: Prediction, entry: Entry, stamps: Stamps) -> Matrix:
        """States of the replicas at ``stamps`` (ns) after an entry, shape (N, samples, 2n)."""
        s = (stamps - entry.since) / NS_PER_S
        every = prediction.replicas(np.maximum(s, 0.0))
        every[:, s <= 0] = entry.belief.replicas[: len(every), None]
        return self._from_frame(stamps, every)

    def _from_frame(self, stamps: Stamps, x: Matrix) -> Matrix:
        """States (q, u) at ``stamps`` (ns) from states in the frame, (..., samples, 2n)."""
        if self._system.frame is None:
            return x
        return self._system.from_frame(stamps - self.epoch, x)

    def apply(self, previous: Entry, event: EventKey, superseding: Superseding) -> Entry:
        """The entry of ``event``, an event or a sample, from the ``previous`` entry.

        Raises:
            ImpactLawError: the impact law has no solution.
            DynamicsError: the loads of closed contacts cannot be found, or the estimate is not
                finite.
        """
        give_turn()
        if event.sample:
            return self._measured(previous, [event])[0]
        last = event.stamp, event.sequence
        meaning = interpret(event, previous.closed, previous.latest, superseding)
        if not meaning.switches:
            latest, overruled = meaning.latest, meaning.overruled
            return replace(
                previous, key=event, latest=latest, overruled=overruled, last=last, outcome=None
            )
        stamp = event.stamp
        s = max(seconds_between(previous.since, stamp), 0.0)
        change = ContactChange.of(
            Elapsed(stamp - (self.epoch or stamp)),
            previous.closed,
            meaning.switches,
            stamp=event.stamp,
            sequence=event.sequence,
            flown=s,
        )
        try:
            posterior, x = self._corrected(previous, change)
        except ImpactLawError as error:
            raise ImpactLawError(f"at {text(stamp)} s: {error}") from None
        result = self.test.after_event(previous.synchronization, change, x, posterior)
        if not isfinite(result.energy):
            raise DynamicsError(f"at {text(stamp)} s: the estimate is not finite any more")
        return Entry(
            event,
            stamp,
            posterior,
            result,
            change.closed,
            meaning.latest,
            meaning.overruled,
            last,
            stamp if change.hit else previous.impact,
            rejected=previous.rejected,
        )

    def _corrected(self, previous: Entry, change: ContactChange) -> tuple[Belief, Vector]:
        """The belief after a change of contacts, and the estimate just before it, shape (2n,)."""
        s, belief = change.flown, previous.belief
        if s > 0:
            belief = self.prediction(previous).belief(s)
        return self.law.correct(change, belief), belief.x

    def _measured(self, previous: Entry, events: Sequence[EventKey]) -> list[Entry]:
        """The entries of samples of one stamp; all have the posterior after the last of them.

        Samples that are not used leave the motion unchanged.

        Raises:
            DynamicsError: the estimate is not finite.
        """
        stamp, readings = events[0].stamp, [self._reading(previous, each) for each in events]
        used = [each for each in readings if not each.is_blanked]
        s = seconds_between(previous.since, stamp)
        belief, made = None, list[SampleOutcome]()
        if used:
            prediction = self.prediction(previous)
            belief, made = self.law.measure(used, previous.belief, prediction, s)
        outcomes = dict(zip([each.sensor.index for each in used], made, strict=True))
        rejected = _rejected_after(previous, outcomes)
        base = replace(previous, key=events[0], overruled=(), rejected=rejected)
        if belief is not None:
            if not isfinite(belief.x.dot(belief.x)):
                raise DynamicsError(f"at {text(stamp)} s: the estimate is not finite any more")
            base = replace(base, since=stamp, belief=belief, prediction=None)
        each = zip(events, readings, strict=True)
        return [
            replace(base, key=event, outcome=outcomes.get(event.sensor) or _blanked(reading))
            for event, reading in each
        ]

    def _reading(self, previous: Entry, event: EventKey) -> Reading:
        """A sample, after the ``previous`` entry."""
        (value,), stamp, index, impact = event.sample, event.stamp, event.sensor, previous.impact
        ns = stamp - (self.epoch or stamp)
        return Reading(
            self.sensors[index],
            value,
            Elapsed(ns),
            ns,
            seconds_between(impact, stamp) if impact else math.inf,
            previous.closed,
            previous.rejected.get(index, 0),
        )

    def prediction(self, entry: Entry) -> Prediction:
        """The prediction from the belief of ``entry``, made at the first call."""
        if entry.prediction is None:
            entry.prediction = self.law.predict(self._start_of(entry), entry.belief, entry.closed)
        return entry.prediction

    def _start_of(self, entry: Entry) -> Elapsed:
        """When an entry begins, s since the epoch."""
        return Elapsed(entry.since - (self.epoch or entry.since))


def misplaced(key: EventKey, timeline: Timeline) -> Refusal | None:
    """Why a late event is refused a place among those applied; None if it is not."""
    if timeline.accepts(key):
        return None
    return Ruling.TOO_LATE, _before(timeline.start.stamp), Remark.TOO_LATE


def _before(start: int) -> str:
    return f"before {text(start)} s, the start of the history"


def _blanked(reading: Reading) -> SampleOutcome:
    ago, blanking = reading.since_impact, reading.sensor.measurement.blanking
    reason = f"blanking: an impact was {ago:.3g} s ago; {blanking:g} s are left out"
    return SampleOutcome(0.0, -1.0, False, reason)


def _rejected_after(previous: Entry, outcomes: Mapping[int, SampleOutcome]) -> Mapping[int, int]:
    """How many samples in a row of each sensor were rejected, after ``outcomes`` by sensor.

    A sample without an innovation in deviations says nothing.
    """
    rejected = dict(previous.rejected)
    for sensor, each in outcomes.items():
        if each.accepted:
            rejected.pop(sensor, None)
        elif each.normalized >= 0:
            rejected[sensor] = rejected.get(sensor, 0) + 1
    return rejected
