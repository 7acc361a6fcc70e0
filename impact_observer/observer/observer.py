# SPDX-License-Identifier: Apache-2.0
"""The observer: events in, estimates out. The node and the offline command run this object."""

from bisect import bisect_right
from collections import Counter, deque
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import chain, groupby, pairwise
from operator import attrgetter
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from impact_observer.arrays_of_states import StateArrays
from impact_observer.bank.balance import ImpactState
from impact_observer.dynamics import mechanism_of
from impact_observer.dynamics.contact.impact_balance import ImpactBalance
from impact_observer.errors import UsageError
from impact_observer.events import (
    REVISED,
    ImpactEstimate,
    ImpactEvent,
    Kind,
    Remark,
    Ruling,
    Verdict,
    events_at,
)
from impact_observer.model import System
from impact_observer.model.live_signals import LiveSignals, refused
from impact_observer.model.measurement import Measurement
from impact_observer.model.model_file import ModelSource, model_of
from impact_observer.model.multibody import is_multibody
from impact_observer.observer.belief import Prediction
from impact_observer.observer.contact_change import ContactChange
from impact_observer.observer.encoder_start import EncoderStart
from impact_observer.observer.event_order import EventKey
from impact_observer.observer.impact_sides import ImpactSides
from impact_observer.observer.laws.law import Law
from impact_observer.observer.samples import (
    SampleOutcome,
    SampleStream,
    SensorSample,
    sensors_of,
)
from impact_observer.observer.sender_runs import SenderRun, SequenceNumbers
from impact_observer.observer.synchronization import SynchronizationTest
from impact_observer.observer.timeline import Entry, Timeline
from impact_observer.observer.uncertainty import covariance_root, spread
from impact_observer.observer.verdicts import EventVerdicts, Judged, rejection
from impact_observer.options import Options
from impact_observer.robots.robot import Robot
from impact_observer.square_roots import lengths_of
from impact_observer.stamps import (
    NS_PER_S,
    Elapsed,
    from_seconds,
    nanoseconds,
    seconds_between,
    text,
    whole_stamp,
    whole_stamps,
)
from impact_observer.states import (
    NO_COVARIANCE,
    Estimate,
    Estimates,
    Matrix,
    Stamps,
    Vector,
)

MOST_LIVE_SAMPLES = 100_000
"""Samples of live signals that are kept while there is no event: those of 100 s at 1 kHz."""
MOST_FLIGHTS = 8
"""Flights in which sources of deviations are looked for."""
MOST_WAITING = 1000
"""Events that are kept until their epoch is known."""
BEFORE_EPOCH = NS_PER_S
"""How long before its own epoch an event may be stamped, ns: above jitter."""


class Observer:
    """Replicas of ``system``, switched by events only; the first of them is the estimate.

    The others have different initial states, drawn from the declared uncertainty: their distance
    indicates the observer's own error. The estimate does not depend on them.

    An estimate is a function of the events and samples known, which a ``Timeline`` has in order,
    and of its stamp. The initial state holds at the epoch, or at the first stamp received where
    the lowest sequence number is not 1. A robot may start at the first samples of its encoders
    instead, whose stamp is its epoch if nothing says it.

    Attributes:
        system: the system that plant and replica share.
        law: the law that corrects the replicas at an event.
        ensemble: how many replicas are run together.
        given_epoch: the epoch that was given, ns; 0 for none.
        epoch: stamp of ``t = 0`` of the forcing, ns; 0 while unknown.
        timeline: the events and samples that are kept; None before the start is known.
        live: signals to which samples may be added at any time; None where the system has none.
        robot: the robot; None of a linear system.
        encoders: where a robot starts; None for its initial state.
        samples: samples of the sensors beside the impacts, and verdicts on samples.
        restarts: how often a new episode or epoch has restarted the replica.
    """

    def __init__(
        self,
        system: ModelSource | Robot,
        law: Law,
        position: Vector,
        velocity: Vector,
        *,
        epoch: int = 0,
        history: float = Options.history,
        ensemble: int = Options.ensemble,
        live: LiveSignals | None = None,
        measurements: Sequence[Measurement] = (),
        encoders: EncoderStart | None = None,
    ) -> None:
        """Make an observer that has received nothing yet.

        Args:
            system: the system or robot; a model or the path of a model file names its system.
            law: a law for the same system.
            position: initial coordinates, shape (n,), m or rad.
            velocity: initial velocities, shape (n,).
            epoch: stamp of ``t = 0`` of the forcing, ns; 0 to take it from the events.
            history: how late an event may be and still be applied, s.
            ensemble: how many replicas are run together, at least one.
            live: the signals of ``system``, where it has live ones.
            measurements: what is measured beside the impacts.
            encoders: their first samples take the place of ``position`` and ``velocity``.

        Raises:
            UsageError: no system or law, a wrong state, or a number that is not positive.
            ModelError: the model file is wrong.
        """
        if not is_multibody(system):
            system = model_of(cast(ModelSource, system), "Observer").system
        if not isinstance(law, Law):
            raise UsageError(f"Observer: {law!r} found; expected law_named(NAME)(system)")
        for name, value in (("history", history), ("ensemble", ensemble)):
            if not value > 0:
                raise UsageError(f"{name}: {value:g} found; expected a positive number")
        q, u = system.checked_state(position, velocity)
        if live is None:
            refused(cast(System, system), "an observer without signals")
        self.live, self.encoders = live, encoders
        self.robot = cast(Robot, system) if system.has_encoders else None
        self.samples = SampleStream(sensors_of(measurements, cast(System, system)))
        self.system: System = system  # type: ignore[assignment]
        self.law = law
        self._initial = np.concatenate([q, u])
        self._root = law.uncertainty.root(system.n)
        self.ensemble = ensemble
        self._starts: Matrix | None = None
        self._mechanism = mechanism_of(self.system)
        self._test = SynchronizationTest(self.system, self._mechanism)
        self._sides = ImpactSides(law, self._mechanism)
        self._history = from_seconds(history)
        self._names = system.contact_names
        self.given_epoch = whole_stamp(epoch, "epoch")
        self.restarts = 0
        self._verdicts = EventVerdicts(system.contact_names)
        self.restart()

    def __repr__(self) -> str:
        return (
            f"<Observer of {self.system.name}: law {self.law.name}, {self.ensemble} replicas,"
            f" last event {self.last_event} ns>"
        )

    def restart(self, reason: str = "") -> None:
        """Forget all events and samples; the next verdict names the ``reason``, if any."""
        if reason:
            self._verdicts.notice = f"{reason}: the observer is reset"
        self._run: SenderRun | None = None
        self._first_pulse = 0
        self._is_inserting = False
        self.samples.clear()
        self._revised: list[Verdict] = []
        self._begin_run(self.given_epoch)
        if self.given_epoch and self.encoders is None:
            self._begin(self.given_epoch)

    def _begin_run(self, epoch: int, samples: Sequence[EventKey] = ()) -> None:
        """Forget all but some ``samples``; the ``epoch`` (ns) is 0 while unknown."""
        self.epoch = epoch
        if self.live is not None and epoch:
            self.live.follow(epoch)
        self._without_start: deque[ImpactEvent] = deque(maxlen=MOST_WAITING)
        self._verdicts.begin_run()
        self._numbers = SequenceNumbers()
        self._earliest = 0
        self.timeline: Timeline | None = None
        self._carried = samples
        if self.encoders is not None:
            self.encoders.forget()
            self.encoders.note(samples)
        if samples and not self._without:
            self._timeline_with(samples[0].stamp)

    def take_pulse(self, stamp: int) -> None:
        """The phase of the drive is zero at ``stamp`` (ns).

        The first pulse is the epoch unless the events or the caller give the epoch.
        """
        self._first_pulse = self._first_pulse or stamp
        self.epoch = self.epoch or stamp

    def receive(self, event: ImpactEvent) -> tuple[Verdict, ...]:
        """Apply ``event`` at its own stamp, whenever it arrives.

        Returns:
            One verdict a switch, or one on the whole event; then those on inserted impacts, and
            on earlier events whose verdict has changed.

        Raises:
            ImpactLawError: the impact law has no solution; the event is not applied.
            DynamicsError: the loads of closed contacts cannot be found; the event is not applied.
            UsageError: the forcing depends on time and its epoch is unknown.
        """
        *_, ((_, verdicts),) = self._receiving([event], raises=True)
        return verdicts

    def receiving(self, events: Iterable[ImpactEvent]) -> Iterator[list[Judged]]:
        """``receive`` several events; late events together, so that later events run again once.

        An error that ``receive`` would raise becomes the reason of a rejection. An estimate
        contains the late events once their verdicts are yielded; until then no other call may
        change the observer. A caller that closes the generator may give the events again that had
        no verdict.

        Yields:
            Events that were applied together, each with its verdicts; none after each step of work
            in between.
        """
        for _, members in groupby(events, key=attrgetter("epoch", "episode")):
            ordered = sorted(members, key=attrgetter("stamp", "sequence"))
            late = bisect_right(ordered, self.newest, key=attrgetter("stamp"))
            if late:
                yield from self._receiving(ordered[:late])
            for each in ordered[late:]:
                yield from self._receiving([each])

    def _receiving(
        self, events: Iterable[ImpactEvent], *, raises: bool = False
    ) -> Iterator[list[Judged]]:
        """Apply ``events`` together; their errors are raised, or become rejections."""
        accepted: dict[EventKey, Judged] = {}
        judged = list[Judged]()
        for each in events:
            try:
                key, verdicts = self._admit(each, accepted)
            except UsageError as error:
                if raises:
                    raise
                key, verdicts = None, (rejection(each, str(error)),)
            if key is None:
                judged.append((each, verdicts))
            else:
                accepted[key] = each, verdicts
        if accepted:
            entries: Sequence[Entry] = ()
            for entries in self._inserting(accepted):
                if not entries:
                    yield []
            for entry in entries if raises else ():
                if entry.key in accepted and entry.error is not None:
                    raise entry.error
            judged += self._verdicts.on_applied(accepted, entries, self._final(entries))
        yield [(event, (*verdicts, *self._taken_revised())) for event, verdicts in judged]

    def _admit(
        self, event: ImpactEvent, accepted: Collection[EventKey]
    ) -> tuple[EventKey | None, tuple[Verdict, ...]]:
        """The place of an event, None if it is refused, and verdicts on its switches.

        Raises:
            UsageError: the start is not known yet; the event is kept until it is.
        """
        refused, verdict = self._verdicts.refused, rejection(event, "")
        if event.epoch - event.stamp > BEFORE_EPOCH:
            reason = f"stamped before its own epoch, {text(event.epoch)} s"
            return None, refused(verdict._replace(reason=reason), Remark.BEFORE_EPOCH)
        if reason := self._followed(event):
            return None, refused(verdict._replace(reason=reason), Remark.OLD_RUN)
        self._follow()
        if why := self._without:
            self._without_start.append(event)
            raise UsageError(why)
        verdicts, switches = self._verdicts.on_switches(event)
        key = EventKey(event.stamp, event.sequence, switches)
        if switches and (key in accepted or (self.timeline is not None and key in self.timeline)):
            verdict = verdict._replace(ruling=Ruling.DUPLICATE, reason="it was seen")
            return None, refused(verdict, Remark.DUPLICATE)
        self._numbers.note(event.sequence)
        timeline = self._timeline_with(event.stamp)
        if not timeline.accepts(key):
            reason = f"before {text(timeline.earliest)} s, the start of the history"
            verdict = verdict._replace(ruling=Ruling.TOO_LATE, reason=reason)
            return None, refused(verdict, Remark.TOO_LATE)
        return (key, verdicts) if switches else (None, self._verdicts.with_notice(verdicts))

    def _followed(self, event: ImpactEvent) -> str:
        """Follow the run of the sender to which an event belongs; why not, or nothing.

        A robot that started at its encoders after the epoch needs no earlier one.
        """
        before = self._run
        after = SenderRun.of(event) if before is None else before.after(event)
        if after is None:
            assert before is not None, "the first run is followed"
            return f"{SenderRun.of(event).name} is older than {before.name}"
        self._run = after
        if before is None or before.has(event):
            epoch = event.epoch
            is_late = epoch <= self.epoch and self.encoders is not None
            if not epoch or epoch == self.epoch or is_late:
                return ""
            if not self.epoch or self.timeline is None:
                self.epoch = epoch
                return ""
        since = event.epoch or event.stamp
        entries = [] if self.timeline is None else self.timeline.entries
        keys = (*self._carried, *(entry.key for entry in entries))
        samples = [key for key in keys if key.sample and key.stamp >= since]
        self._begin_run(event.epoch or self.given_epoch or self._first_pulse, samples)
        self._verdicts.notice = f"{after.name} is new: the observer is reset"
        self.restarts += 1
        return ""

    def _timeline_with(self, stamp: int) -> Timeline:
        """The timeline, whose start may be moved by an event or a sample at ``stamp`` (ns)."""
        timeline = self.timeline
        if timeline is not None and stamp < timeline.newest - self._history:
            return timeline
        self._earliest = min(self._earliest or stamp, stamp)
        start = self.epoch if self.epoch and self._numbers.lowest <= 1 else self._earliest
        if self.encoders is not None:
            start = self.encoders.stamp
        if timeline is None or (timeline.is_complete and timeline.start != start):
            timeline = self._begin(start)
        return timeline

    def _begin(self, stamp: int) -> Timeline:
        """Have the initial state hold at ``stamp`` (ns)."""
        initial = self._initial if self.encoders is None else self.encoders.state
        replicas = self._replicas_at(stamp, initial, self._root)
        if self.timeline is None:
            self.timeline = Timeline(self.law, self._test, self._history, self.samples.sensors)
        self.timeline.begin(replicas, self._root, stamp, self.epoch or stamp, self._carried)
        self._carried = ()
        return self.timeline

    @property
    def _past(self) -> Timeline:
        """The timeline, once the start is known."""
        assert self.timeline is not None, "the start is known"
        return self.timeline

    def _inserting(self, keys: Iterable[EventKey]) -> Iterator[Sequence[Entry]]:
        """``Timeline.inserting``; meanwhile estimates are those of before."""
        self._is_inserting = True
        try:
            yield from self._past.inserting(keys)
        finally:
            self._is_inserting = False
        self._verdicts.forget_before(self._past.start)
        if self.live is not None:
            self.live.forget_before(self._past.start)

    def _final(self, entries: Sequence[Entry]) -> int:
        """The stamp before which verdicts are final once ``entries`` are made, ns."""
        return max(entries[0].key.stamp - self._history, self._past.start)

    def _taken_revised(self) -> tuple[Verdict, ...]:
        """The verdicts on earlier events that have changed since the last call."""
        revised, self._revised = tuple(self._revised), []
        return revised

    def measure(self, samples: Iterable[SensorSample]) -> tuple[Verdict, ...]:
        """Use samples of sensors, each at its own stamp, whenever they arrive.

        Verdicts on samples are in ``samples``. Samples wait until the epoch of the forcing is
        known.

        Returns:
            Verdicts on earlier events that have changed.
        """
        self.samples.add_samples(samples)
        self._follow()
        return self._taken_revised()

    def _follow(self) -> None:
        """Use samples and events that wait, except while events are inserted."""
        if self._is_inserting:
            return
        waiting = self.samples.waiting
        if waiting and self.system.has_encoders:
            self._start_at(waiting)
        if self.live is not None and self.epoch:
            changed = self.live.follow(self.epoch)
            if changed is not None and self.timeline is not None:
                self.timeline.rerun(changed)
        if self._without:
            return
        if waiting:
            keys = {*waiting}
            waiting.clear()
            self._use_samples(keys)
        if early := [*self._without_start]:
            self._without_start.clear()
            for _, verdicts in chain.from_iterable(self.receiving(early)):
                for each in verdicts:
                    reason = f"{REVISED}{each.reason or 'as reported'}"
                    self._revised.append(each._replace(reason=reason, revises=True))

    def _start_at(self, waiting: Sequence[EventKey]) -> None:
        """Find where a robot starts, and an epoch if none is known, by samples that wait."""
        first = waiting[0].stamp
        if self.encoders is not None:
            is_moved = self.encoders.note(each for each in waiting if each.stamp >= self.epoch)
            if self.encoders.lacking:
                return
            first = self.encoders.stamp
            if is_moved and self.timeline is not None and self.timeline.is_complete:
                self._begin(first)
        if not self.epoch:
            self.epoch = first

    def _use_samples(self, keys: Iterable[EventKey]) -> None:
        """Put samples into their places; late samples together, so that events run again once."""
        ordered, new = sorted(keys), list[EventKey]()
        timeline = self._timeline_with(ordered[0].stamp)
        for key in ordered:
            reason = ""
            if not timeline.accepts(key):
                reason = f"too late: before {text(timeline.earliest)} s, the start of the history"
            elif key in timeline or (new and new[-1][:2] == key[:2]):
                reason = "the sensor has another sample of the same stamp"
            if reason:
                self.samples.judge(key, SampleOutcome.unused(reason))
            else:
                new.append(key)
        if not new:
            return
        *_, entries = self._inserting(new)
        own = {*new}
        for entry in entries:
            if entry.outcome is not None and entry.key in own:
                self.samples.judge(entry.key, entry.outcome)
        self._revised += self._verdicts.changed(entries, self._final(entries))[1]

    @property
    def lacking(self) -> tuple[str, ...]:
        """Names of the joints of a robot by whose encoders the start is not known yet."""
        return () if self.encoders is None else self.encoders.lacking

    @property
    def _without(self) -> str:
        """What is missing to know when the initial state holds; empty once it is known."""
        if lacking := self.lacking:
            return (
                f"initial state: no sample of an encoder of the joint {lacking[0]!r} found;"
                " expected one first, or an initial state"
            )
        return _without_epoch(self.system, self.epoch)

    def require_start(self) -> None:
        """Raise UsageError if the encoders by which a robot starts have had no sample."""
        if self.lacking:
            raise UsageError(self._without)

    def forget_silence(self, now: int) -> None:
        """Bound the memory while samples arrive for long without any event.

        Of more than ``MOST_LIVE_SAMPLES`` samples, those before ``now`` (ns) minus the history are
        forgotten, and the estimate goes on from there. That of a robot does so anyway, as each
        estimate costs the more the longer its encoders are silent. Only a node needs the bound: a
        recording ends.
        """
        live = self.live
        if live is not None and self.timeline is None:
            live.keep_waiting(MOST_LIVE_SAMPLES)
        is_many = live is not None and live.samples.time.size > MOST_LIVE_SAMPLES
        if not is_many and not self.system.has_encoders:
            return
        self._follow()
        if self._is_inserting or self.timeline is None:
            return
        if self.timeline.go_on_from(now - self._history) and live is not None:
            live.forget_before(now - self._history)

    def estimate(self, stamp: int) -> Estimate:
        """The state at ``stamp`` (ns) after all events received with stamps up to it.

        Raises:
            UsageError: ``stamp`` lies before the past that is kept, or no event has come, or the
                forcing depends on time and its epoch is unknown.
        """
        stamp = whole_stamp(stamp)
        entry, prediction, s = self._at(stamp)
        law, belief, n = self.law, entry.belief, self.system.n
        x, root = (prediction.state(s), prediction.root(s)) if s > 0 else (belief.x, belief.root)
        grounds = prediction.of_grounds(stamp - self.epoch, s)
        if law.has_covariance and (root is None or grounds is not None):
            root = prediction.root(s)  # found on request after a sample; its columns are known
        held, silence = prediction.closed(s), prediction.silence(s)
        closed = entry.closed if held is None else held
        if grounds is None:
            seen = self._from_frame(np.array([stamp]), x[None])[0]
        else:
            seen = x + grounds[0]
        covariance = NO_COVARIANCE
        if root is not None:
            t = Elapsed(entry.since - self._past.zero) + s
            others = self._sides.errors(belief, t, x, root, s, closed=closed)
            if grounds is not None:
                root = _with_first(root, grounds[1])
            both = np.column_stack([root, *others]) if others else root
            covariance = law.uncertainty.published_covariance(both, x, self._mechanism.sizes(x, s))
        return Estimate(
            stamp=stamp,
            law=law.name,
            q=seen[:n],
            u=seen[n:],
            covariance=covariance,
            closed=tuple([self._names[i] for i in closed]),
            convergence=entry.synchronization.convergence,
            synchronized=law.uses_events and not (silence or self._doubt(entry, x, root, s)),
            bound=-1.0 if belief.bound is None else belief.bound,
            inconsistent=belief.inconsistent,
            misfit=belief.misfit or silence,
            clock_offset=belief.clock_offset,
            parameters=belief.learned(),
            last_sequence=entry.last[1],
            last_event=entry.last[0],
        )

    def _at(self, stamp: int) -> tuple[Entry, Prediction, float]:
        """The last entry up to ``stamp`` (ns), its prediction, and how many seconds before it is.

        Raises:
            UsageError: as ``estimate``.
        """
        self._follow()
        timeline = self.timeline
        if timeline is None or stamp < timeline.start:
            past = "no event has come"
            if timeline is not None:
                past = f"the history starts at {text(timeline.start)} s"
            raise UsageError(f"estimate at {text(stamp)} s: {past}")
        require_epoch(self.system, self.epoch)
        entry = timeline.entry_at(stamp)
        return entry, timeline.prediction(entry), seconds_between(entry.since, stamp)

    def _doubt(self, entry: Entry, x: Vector, root: Matrix | None, s: float) -> str:
        """Why the state ``x``, ``s`` seconds after an entry, is not synchronized; or nothing."""
        doubt = None
        if root is not None:
            least = self.law.uncertainty.least_deviations(x, self._mechanism.sizes(x, s))
            doubt = self.law.doubt(entry.belief, np.hypot(lengths_of(root), least))
        return self._test.obstacle(entry.synchronization) if doubt is None else doubt

    def estimates(self, stamps: Stamps, *, replicas: bool = False) -> Iterator[Estimates]:
        """``estimate`` at each of ``stamps`` (ns, ascending, shape (samples,)), many at a time.

        The states equal those of ``estimate`` in every bit. With ``replicas`` the states of all
        replicas that move by themselves are given, too, and all other values, such as a
        covariance, are those of the first of many stamps.

        Raises:
            UsageError: as ``estimate``.
        """
        stamps = whole_stamps(stamps)
        while stamps.size:
            first = self.estimate(int(stamps[0]))
            entry, end = self._past.interval(first.stamp)
            prediction, count = self._past.prediction(entry), 1
            if prediction.is_plain or replicas:
                count = stamps.size if end is None else int(np.searchsorted(stamps, end))
            here, stamps = stamps[:count], stamps[count:]
            if replicas:
                every = self._replicas(prediction, entry, here)
                yield Estimates(first, here, every[0], every)
                continue
            x = np.concatenate([first.q, first.u])[None]
            if count > 1:
                s = np.array([seconds_between(entry.since, at) for at in here[1:].tolist()])
                x = np.concatenate([x, self._from_frame(here[1:], prediction.states(s))])
            yield Estimates(first, here, x)

    def _replicas(self, prediction: Prediction, entry: Entry, stamps: Stamps) -> Matrix:
        """States of the replicas at ``stamps`` (ns) after an entry, shape (N, samples, 2n)."""
        s = (stamps - entry.since) / NS_PER_S
        every = prediction.replicas(s)
        every[:, s <= 0] = entry.belief.replicas[: len(every), None]
        if self.system.frame is None:
            return every
        pairs = zip((stamps - self.epoch).tolist(), s.clip(0.0).tolist(), strict=True)
        found = (prediction.of_grounds(*pair) for pair in pairs)
        if learned := [each[0] for each in found if each is not None]:
            return np.asarray(every + np.array(learned))
        return self._from_frame(stamps, every)

    def _from_frame(self, stamps: Stamps, x: Matrix) -> Matrix:
        """States (q, u) at ``stamps`` (ns) from states in the frame, (..., samples, 2n)."""
        return self.system.from_frame(stamps - self.epoch, x)

    def _replicas_at(self, stamp: int, x: Vector, root: Matrix) -> Matrix:
        """States in the frame about (q, u) at ``stamp`` (ns) of all replicas, shape (N, 2n)."""
        replicas = spread(x, root, self.ensemble) if self._starts is None else self._starts
        return self.system.to_frame(np.full(len(replicas), stamp - self.epoch), replicas)

    def impact(self, verdict: Verdict) -> ImpactEstimate | None:
        """The estimate of an impact that a ``verdict`` just received applies or inserts.

        That of a rejected event, or of an inserted impact that was none, has no numbers. Returns
        None for a release, where the event is in the past that is kept no longer, and where the
        verdict is outdated.

        Raises:
            ImpactLawError: the impact law has no solution.
        """
        timeline, names = self.timeline, self._names
        contacts = verdict.contact, verdict.hit_contact
        if timeline is None or not {*contacts} <= {*names}:
            return None
        reported, hit = map(names.index, contacts)
        stamp = verdict.stamp
        found = timeline.around(stamp, verdict.sequence, reported)
        switches = ((reported, Kind.IMPACT),) if found is None else found[1].key.switches
        if verdict.ruling is Ruling.REJECTED:
            if all(i != reported or kind is Kind.OPEN for i, kind in switches):
                return None
            return ImpactEstimate(stamp, verdict.contact, verdict.ruling, verdict.sequence)
        if verdict.ruling is Ruling.INSERTED:
            missed = self._verdicts.missed(stamp, hit)
            return None if missed is None else self._inserted(stamp, missed, timeline)
        hits = {hit if i == reported else i for i, kind in switches if kind is not Kind.OPEN}
        if found is None or hit not in hits:  # a release
            return None
        before = found[0]
        change = ContactChange(
            Elapsed(stamp - timeline.zero),
            before.closed,
            tuple(sorted(hits)),
            before.closed,
            stamp,
            verdict.sequence,
            seconds_between(before.since, stamp),
        )
        prediction = timeline.prediction(before)
        made = self.law.impact_balance(change, before.belief, prediction, found[1].belief)
        return None if made is None else _applied(verdict, names[hit], change.hit.index(hit), made)

    def _inserted(self, stamp: int, missed: ImpactState, timeline: Timeline) -> ImpactEstimate:
        """The estimate of an impact that was inserted at ``stamp`` (ns)."""
        (own,) = self.law.known_balance(missed, timeline.entry_at(stamp).belief).rows.tolist()
        name = self._names[missed.contacts[0]]
        return ImpactEstimate(stamp, name, Ruling.INSERTED, 0, *own)

    def silence(self, stamp: int) -> str:
        """The warning that predicted impacts have not come up to ``stamp`` (ns), or nothing.

        Raises:
            UsageError: as ``estimate``.
        """
        _, prediction, s = self._at(whole_stamp(stamp))
        return prediction.silence(s)

    def obstacle(self, stamp: int) -> str:
        """Why the estimate at ``stamp`` (ns) is not synchronized; empty where it is.

        Raises:
            UsageError: as ``estimate``.
        """
        entry, prediction, s = self._at(whole_stamp(stamp))
        if not self.law.uses_events:
            return f"{self.law.name} uses no events"
        if prediction.silence(s):
            return "predicted impacts are not reported"
        return self._doubt(entry, prediction.state(s), prediction.root(s), s)

    def last_deviations(self) -> Vector | None:
        """Deviations of (q, u) in the last flights, at most ``MOST_FLIGHTS``, shape (2n,).

        Medians of those in the middle of each flight. None before two events, or for a law that
        has no covariance.
        """
        self._follow()
        entries = self.timeline.entries[-MOST_FLIGHTS - 1 :] if self.timeline else []
        pairs = [(a.since, b.since) for a, b in pairwise(entries) if a.since < b.since]
        if not (pairs and self.law.has_covariance):
            return None
        found = [np.diag(self.estimate((a + b) // 2).covariance) for a, b in pairs]
        return np.asarray(np.sqrt(np.median(found, axis=0)))

    def run(self, times: Mapping[str, ArrayLike] | ArrayLike, seconds: ArrayLike) -> StateArrays:
        """The states after all impacts up to each of ``seconds``, of an observer without events.

        Args:
            times: of the impacts of each contact, s since the epoch; or of the only contact.
            seconds: since the epoch, ascending, s.

        Raises:
            ImpactLawError, UsageError: as ``receive``; an unknown contact, or no seconds.
        """
        epoch, events = events_at(times, self.system.contact_names, self.given_epoch)
        stamps, made = epoch + nanoseconds(seconds, "seconds"), list[Estimates]()
        for event in (*events, None):
            end = stamps.size if event is None else int(np.searchsorted(stamps, event.stamp))
            here, stamps = stamps[:end], stamps[end:]
            if here.size and self.start is not None:
                made += self.estimates(here[here >= self.start])
            if event is not None:
                self.receive(event)
        return StateArrays.of(self.system.state_names, made, epoch)

    def set_state(
        self,
        stamp: int,
        position: ArrayLike,
        velocity: ArrayLike,
        covariance: ArrayLike | None = None,
    ) -> None:
        """Forget the past: from ``stamp`` (ns) on the replica moves from the given state.

        The state, shape (n,) each, holds after all events with this stamp; later ones act on it.
        Before any event or epoch is received, it becomes the initial state. The ``covariance`` has
        shape (2n, 2n), or is a list of its rows; None for the initial one.

        Raises:
            UsageError: a state or covariance of the wrong size or one that is not finite.
            ImpactLawError: contacts are closed and their law has no solution for that state.
        """
        x = np.concatenate(self.system.checked_state(position, velocity))
        root = self._root if covariance is None else covariance_root(covariance, self.system.n)
        self._follow()
        self._starts = None
        if self.timeline is None:
            self._initial, self._root, self.encoders = x, root, None
            return
        stamp = max(whole_stamp(stamp), self.timeline.start)
        self.timeline.set_state(self._replicas_at(stamp, x, root), root, stamp)

    def start_from(self, replicas: Matrix) -> None:
        """Run ``replicas`` (q, u), shape (N, 2n), the estimate first, instead of the ensemble.

        All that was received is forgotten.
        """
        self._initial, self.ensemble, self._starts = replicas[0], len(replicas), replicas
        self.restart()

    @property
    def remarks(self) -> Counter[Remark]:
        """How often the stream of events was irregular, by kind."""
        return self._verdicts.remarks

    @property
    def start(self) -> int | None:
        """The earliest stamp of an estimate, ns; None before an epoch or event is received."""
        return None if self.timeline is None else self.timeline.start

    @property
    def last_event(self) -> int:
        """Stamp of the latest event applied, ns; 0 before the first."""
        return 0 if self.timeline is None else self.timeline.entries[-1].last[0]

    @property
    def newest(self) -> int:
        """The latest stamp of an event or a sample, ns; 0 before the first."""
        return 0 if self.timeline is None else self.timeline.newest

    @property
    def missing(self) -> int:
        """How many sequence numbers are missing since the first received."""
        return self._numbers.missing


def _applied(verdict: Verdict, contact: str, row: int, made: ImpactBalance) -> ImpactEstimate:
    """The estimate of an impact of a ``contact`` by a row of the balance of its event."""
    stamp, own = verdict.stamp - from_seconds(made.early), made.rows[row].tolist()
    return ImpactEstimate(stamp, contact, verdict.ruling, verdict.sequence, *own)


def require_epoch(system: System, epoch: int) -> None:
    """Raise UsageError where the forcing depends on time and its ``epoch`` (ns) is unknown, 0."""
    if why := _without_epoch(system, epoch):
        raise UsageError(why)


def _without_epoch(system: System, epoch: int) -> str:
    if epoch or not system.depends_on_time:
        return ""
    return (
        f"epoch: 0 found, which is none, and the forcing of {system.name} depends on time;"
        " expected its stamp of t = 0: --epoch S (epoch of nodes, ns), detect --pulses COLUMN,"
        " or import --time-zero S with S above 0"
    )


def _with_first(root: Matrix, errors: Matrix) -> Matrix:
    """A ``root`` with ``errors`` added to its first columns."""
    others = np.zeros((len(root), root.shape[1] - errors.shape[1]))
    return np.asarray(root + np.hstack([errors, others]))
