# SPDX-License-Identifier: Apache-2.0
"""The observer: events in, estimates out. The node and the offline command run this object."""

from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from itertools import pairwise
from typing import NamedTuple, TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike

from impact_observer.arrays_of_states import StateArrays
from impact_observer.errors import DynamicsError, ImpactObserverError, UsageError
from impact_observer.events import (
    REVISED,
    Contacts,
    ImpactEstimate,
    ImpactEvent,
    Kind,
    Remark,
    Ruling,
    Verdict,
    epoch_before,
    events_at,
)
from impact_observer.model import System
from impact_observer.model.live_signals import LiveSignals, refused
from impact_observer.model.measurement import Measurement
from impact_observer.model.model_file import ModelSource, model_of
from impact_observer.model.multibody import is_multibody
from impact_observer.observer.encoder_start import EncoderStart
from impact_observer.observer.event_order import NEAR_STAMPS, EventKey, LatestSequences
from impact_observer.observer.laws.law import Law
from impact_observer.observer.readings import sensors_of
from impact_observer.observer.run_history import RunHistory, misplaced
from impact_observer.observer.samples import SampleStream, SensorSample
from impact_observer.observer.sender_runs import SenderRun, SenderRuns
from impact_observer.observer.synchronization import SynchronizationTest
from impact_observer.observer.timeline import Entry, Insertion, Timeline, initial_entry
from impact_observer.observer.uncertainty import covariance_root, spread
from impact_observer.observer.verdicts import with_reasons
from impact_observer.options import Options
from impact_observer.robots.robot import Robot
from impact_observer.stamps import NS_PER_S, from_seconds, text, whole_stamp, whole_stamps
from impact_observer.states import (
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


class _Waiting(NamedTuple):
    """A late event that is not applied yet.

    Attributes:
        event: the event.
        verdicts: verdicts on the switches of the event.
        is_overtaken: whether an event with a higher number was received earlier.
        notices: notices about the sequence number.
    """

    event: ImpactEvent
    verdicts: tuple[Verdict, ...]
    is_overtaken: bool
    notices: Sequence[str] = ()


_Late: TypeAlias = dict[RunHistory, dict[EventKey, _Waiting]]
"""Late events that are not applied yet, by the run of the sender to which they belong."""


class Observer:
    """Replicas of ``system``, switched by events only; the first of them is the estimate.

    The others have different initial states, drawn from the declared uncertainty: their distance
    indicates the observer's own error. The estimate does not depend on them.

    The initial state holds at the epoch. When the observer joins later, so that the lowest
    sequence number it receives is not 1, it holds at the first stamp received. A robot may start
    at the first samples of its encoders instead, whose stamp is its epoch if nothing says it.

    Attributes:
        system: the system that plant and replica share.
        law: the law that corrects the replicas at an event.
        ensemble: how many replicas are run together.
        given_epoch: the epoch that was given, ns; 0 for none.
        remarks: how often the stream of events was irregular, by kind.
        live: signals to which samples may be added at any time; None where the system has none.
        robot: the robot; None of a linear system.
        encoders: where the next run of a robot starts; None for its initial state.
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
        self.live = live
        self.robot = cast(Robot, system) if system.has_encoders else None
        self.encoders = encoders
        self.samples = SampleStream(sensors_of(measurements, system))
        self._revised: list[Verdict] = []
        self._is_inserting = False
        self.system: System = system  # type: ignore[assignment]
        self.law = law
        self._initial = np.concatenate([q, u])
        self._root = law.uncertainty.root(system.n)
        self.ensemble = ensemble
        self._starts: Matrix | None = None
        self._test = SynchronizationTest(system)
        self._history = from_seconds(history)
        self._names = system.contact_names
        self._index = {name: i for i, name in enumerate(self._names)}
        self.given_epoch = whole_stamp(epoch, "epoch")
        self.remarks: Counter[Remark] = Counter()
        self.restarts = 0
        self._notices: list[str] = []
        self.restart()

    def __repr__(self) -> str:
        return (
            f"<Observer of {self.system.name}: law {self.law.name}, {self.ensemble} replicas,"
            f" last event {self.last_event} ns>"
        )

    def restart(self, reason: str = "") -> None:
        """Forget all events and samples; the next verdict names the ``reason``, if any."""
        if reason:
            self._notices = [*self._notices, f"{reason}: the observer is reset"]
        self._runs = SenderRuns(self.given_epoch)
        self._without_epoch: deque[ImpactEvent] = deque(maxlen=MOST_WAITING)
        self._assumed_epoch = 0
        self.samples.clear()
        self._begin_run(self.given_epoch)

    def take_pulse(self, stamp: int) -> None:
        """The phase of the drive is zero at ``stamp`` (ns).

        The first pulse is the epoch unless the events or the caller give the epoch.
        """
        self._assumed_epoch = self._assumed_epoch or stamp
        if not self.epoch:
            self._run.epoch = self._assumed_epoch

    def _begin_run(self, epoch: int) -> None:
        """Start with a run of the sender whose ``epoch`` (ns) is known, or 0."""
        epoch = epoch or self._assumed_epoch
        encoders = None if self.encoders is None else self.encoders.anew()
        self._run = RunHistory(
            self.law,
            self._test,
            epoch,
            first_entry=self._first_entry,
            history=self._history,
            sensors=self.samples.sensors,
            encoders=encoders,
        )
        if self.live is not None and epoch:
            self.live.follow(epoch)
        if self.given_epoch and epoch == self.given_epoch and self.encoders is None:
            self._run.begin(epoch)

    def receive(self, event: ImpactEvent) -> tuple[Verdict, ...]:
        """Apply ``event`` at its own stamp, whenever it arrives.

        An event of another run of the sender is kept until the next one confirms it.

        Returns:
            One verdict a switch, or one on the whole event; then those on inserted impacts, and
            on earlier events whose verdict has changed.

        Raises:
            ImpactLawError: the impact law has no solution; the event is not applied.
            DynamicsError: the loads of closed contacts cannot be found; the event is not applied.
            UsageError: the forcing depends on time and its epoch is unknown.
        """
        return self._take(event)

    def _take(self, event: ImpactEvent, waiting: _Late | None = None) -> tuple[Verdict, ...]:
        """``receive`` an event; a late event is put into ``waiting``, if given."""
        if event.epoch - event.stamp > NEAR_STAMPS:
            reason = f"stamped before its own epoch, {text(event.epoch)} s"
            return self._refuse(event, Ruling.REJECTED, reason, Remark.BEFORE_EPOCH)
        weighed = self._runs.weigh(event)
        if weighed.reason:
            return self.refuse(event, weighed.reason)
        if weighed.previous is not None:
            self._change_run(weighed.previous)
            self.samples.again(self.epoch or event.stamp)
        elif self._runs.in_use is not None:
            self._adopt(self._runs.in_use.epoch)
        released = weighed.released
        if self._without_epoch and self.epoch and not self.lacking:
            released = (*self._without_epoch, *released)
            self._without_epoch.clear()
        if released:
            return self._receive_again(released, event)
        return self._receive(event, waiting)

    def _adopt(self, epoch: int) -> None:
        """Take the ``epoch`` (ns) of the run in use, if the epoch is unknown or assumed.

        A robot that started at its encoders after the epoch needs no other one.
        """
        is_assumed = self.epoch == self._assumed_epoch and not self.given_epoch
        is_fine = epoch <= self.epoch if self._run.encoders is not None else epoch == self.epoch
        if not epoch or is_fine or not is_assumed:
            return
        if self.epoch and self._run.timeline is not None:
            self._begin_run(epoch)
            self.samples.again(epoch)
        else:
            self._run.epoch = epoch

    def _receive_again(
        self, released: Iterable[ImpactEvent], event: ImpactEvent
    ) -> tuple[Verdict, ...]:
        """``receive`` an event, and apply the ``released`` events that were refused so far."""
        notices, self._notices = self._notices, []
        again: list[Verdict] = []
        for each in released:
            with suppress(DynamicsError):  # its first verdict stays
                again += self._receive(each)
        self._notices = [*notices, *self._notices]
        revised = [
            each._replace(reason=f"{REVISED}{each.reason or 'as reported'}", revises=True)
            for each in again
        ]
        return (*self._receive(event), *revised)

    def _receive(self, event: ImpactEvent, waiting: _Late | None = None) -> tuple[Verdict, ...]:
        """``_take`` an event of the run in use."""
        self._follow()
        try:
            self.require_start()
            self._run.require_epoch()
        except UsageError:
            self._without_epoch.append(event)
            raise
        verdicts, switches = self._resolve_contacts(event)
        key = EventKey(event.stamp, event.sequence, switches)
        late = {} if waiting is None else waiting.setdefault(self._run, {})
        if switches and (key in late or (self.timeline is not None and key in self.timeline)):
            return self._refuse(event, Ruling.DUPLICATE, "it was seen", Remark.DUPLICATE)
        notices, numbers = self._notices, self._run.numbers
        is_overtaken = 0 < event.sequence < numbers.highest
        if irregularity := numbers.note(event.sequence):
            self.remarks[irregularity[0]] += 1
            self._notices = [*notices, irregularity[1]]
        try:
            if why := self._run.too_old(event.stamp):
                return self._refuse(event, *why)
            timeline = self._run.timeline_from_start(event.stamp)
            if not switches:  # its stamp must not shorten the past
                return self._with_notices(verdicts)
            if timeline.newest.stamp >= key.stamp:
                if why := misplaced(key, timeline):
                    return self._refuse(event, *why)
                if waiting is not None:
                    late[key] = _Waiting(event, verdicts, is_overtaken, self._notices)
                    self._notices = []
                    return ()
            insertion = timeline.insert(key)
        except ImpactObserverError:
            numbers.discard(event.sequence)
            self._notices = notices
            raise
        ((own,), others) = self._inserted(
            self._run, [(_Waiting(event, verdicts, is_overtaken), insertion)]
        )
        return (*own, *others)

    def receiving(
        self, events: Sequence[ImpactEvent]
    ) -> Iterator[tuple[ImpactEvent, tuple[Verdict, ...]] | None]:
        """``receive`` several events; late events together, so that later events run again once.

        An error that ``receive`` would raise becomes the reason of a rejection. An estimate
        contains the late events once their verdicts are yielded; until then no other call may
        change the observer. A caller that closes the generator may give the events again that had
        no verdict.

        Yields:
            Each event with its verdicts; None after each step of work in between.
        """
        if len(events) == 1 and not self._is_late(events[0]):  # as nearly always
            yield events[0], self._receive_or_reject(events[0])
            return
        late, others = list[ImpactEvent](), list[ImpactEvent]()
        for event in events:
            (late if self._is_late(event) else others).append(event)
        if len({(each.epoch, each.episode) for each in others}) == 1:
            others.sort(key=_order)
        for some in (sorted(late, key=_order), others):
            waiting: _Late = {}
            try:
                for event in some:
                    verdicts = self._receive_or_reject(event, waiting)
                    yield (event, verdicts) if verdicts else None
                for run, of_run in waiting.items():
                    yield from self._receive_waiting(run, of_run)
            except GeneratorExit:  # whoever stops here may give the late events again
                for run, of_run in waiting.items():
                    for key in of_run:
                        run.numbers.discard(key.sequence)
                raise

    def _follow(self) -> None:
        """Use the samples received, except while events are inserted."""
        if self._is_inserting:
            return
        waiting = self.samples.waiting
        if waiting and self.robot is not None:
            self._start_at(waiting)
        if self.live is not None and self.epoch:
            changed = self.live.follow(self.epoch)
            if changed is not None:
                self._run.rerun(changed)
        if waiting and not self.lacking and (self.epoch or not self.system.depends_on_time):
            outcomes, revised = self._run.measure(waiting)
            waiting.clear()
            for each in outcomes:
                self.samples.judge(*each)
            self.remarks[Remark.REVISED] += sum(verdict.revises for verdict in revised)
            self._revised += revised
            if self.live is not None and (timeline := self._run.timeline) is not None:
                self.live.forget_before(timeline.start.stamp)

    def _start_at(self, waiting: Sequence[EventKey]) -> None:
        """Find where a robot starts, and an epoch if none is known, by samples that wait."""
        first, encoders = waiting[0].stamp, self._run.encoders
        if encoders is not None:
            changed = encoders.note(each for each in waiting if each.stamp >= self.epoch)
            if encoders.lacking:
                return
            first = encoders.stamp
            if changed:
                self._run.rerun(0)
        if not self.epoch:
            self._assumed_epoch = self._run.epoch = first

    @property
    def lacking(self) -> tuple[str, ...]:
        """Names of the joints of a robot by whose encoders the start is not known yet."""
        return () if self._run.encoders is None else self._run.encoders.lacking

    def require_start(self) -> None:
        """Raise UsageError if the start is not known yet."""
        if lacking := self.lacking:
            raise UsageError(
                f"initial state: no sample of an encoder of the joint {lacking[0]!r} found;"
                " expected one first, or an initial state"
            )

    def measure(self, samples: Iterable[SensorSample]) -> tuple[Verdict, ...]:
        """Use samples of sensors, each at its own stamp, whenever they arrive.

        Verdicts on samples are in ``samples``. Samples wait until the epoch of the forcing is
        known.

        Returns:
            Verdicts on earlier events that have changed.
        """
        self.samples.add_samples(samples)
        self._follow()
        revised, self._revised = tuple(self._revised), []
        return revised

    def forget_silence(self, now: int) -> None:
        """Bound the memory while samples arrive for long without any event.

        Of more than ``MOST_LIVE_SAMPLES`` samples, those before ``now`` (ns) minus the history are
        forgotten, and the estimate goes on from there. That of a robot does so anyway, as each
        estimate costs the more the longer its encoders are silent. Only a node needs the bound: a
        recording ends.
        """
        live = self.live
        if live is not None and self._run.timeline is None:
            live.keep_waiting(MOST_LIVE_SAMPLES)
        is_many = live is not None and live.samples.time.size > MOST_LIVE_SAMPLES
        if not is_many and self.robot is None:
            return
        self._follow()
        goes_on = not self._is_inserting and self._run.go_on_from(now - self._history)
        if goes_on and live is not None:
            live.forget_before(now - self._history)

    @contextmanager
    def without_new_samples(self) -> Iterator[None]:
        """Within the block, estimates do not use samples that have just come.

        So estimates may be asked for while an event is being applied (``turns``).
        """
        before, self._is_inserting = self._is_inserting, True
        try:
            yield
        finally:
            self._is_inserting = before

    def _is_late(self, event: ImpactEvent) -> bool:
        """Whether an event is of the run in use, and events after it have been applied."""
        run, timeline = self._runs.in_use, self._run.timeline
        return (
            timeline is not None
            and run is not None
            and event.episode == run.episode
            and event.epoch in {0, run.epoch}
            and event.stamp <= timeline.newest.stamp
        )

    def _receive_or_reject(
        self, event: ImpactEvent, waiting: _Late | None = None
    ) -> tuple[Verdict, ...]:
        try:
            return self.receive(event) if waiting is None else self._take(event, waiting)
        except ImpactObserverError as error:
            return (_verdict(event, Ruling.REJECTED, str(error)),)

    def _receive_waiting(
        self, run: RunHistory, waiting: Mapping[EventKey, _Waiting]
    ) -> Iterator[tuple[ImpactEvent, tuple[Verdict, ...]] | None]:
        """Apply late events of a run together."""
        timeline = run.timeline
        assert timeline is not None, "they are late"
        without_place = {key: why for key in waiting if (why := misplaced(key, timeline))}
        for key, why in without_place.items():  # the past was shortened since
            yield waiting[key].event, self._refuse(waiting[key].event, *why)
        self._is_inserting = True
        try:
            made = yield from timeline.inserting(
                [key for key in waiting if key not in without_place]
            )
        finally:
            self._is_inserting = False
        for key, error in made.failed.items():
            run.numbers.discard(key.sequence)
            yield (
                waiting[key].event,
                (_verdict(waiting[key].event, Ruling.REJECTED, str(error)),),
            )
        inserted = [(waiting[each.entry.key], each) for each in made.insertions]
        if inserted:
            owns, others = self._inserted(run, inserted)
            for (each, _), own in zip(inserted, owns, strict=True):
                yield each.event, (*own, *others)
                others = ()

    def _inserted(
        self, run: RunHistory, received: Sequence[tuple[_Waiting, Insertion]]
    ) -> tuple[list[tuple[Verdict, ...]], tuple[Verdict, ...]]:
        """Note events that were ``received`` and inserted; return their verdicts and others."""
        for _, insertion in received:
            if insertion.entry.belief.misfit:
                self.remarks[Remark.MISFIT] += 1
        owns, others = run.verdicts([(each.verdicts, made) for each, made in received])
        if self.live is not None and run.timeline is not None:
            self.live.forget_before(run.timeline.start.stamp)
        if others:
            self.remarks[Remark.REVISED] += sum(verdict.revises for verdict in others)
        complete = []
        for own, (event, insertion) in zip(owns, received, strict=True):
            if event.notices:
                self._notices = [*self._notices, *event.notices]
            self._note_disorder(insertion, is_overtaken=event.is_overtaken)
            complete.append(self._with_notices(own))
        return complete, others

    def estimate(self, stamp: int) -> Estimate:
        """The state at ``stamp`` (ns) after all events received with stamps up to it.

        Raises:
            UsageError: ``stamp`` lies before the past that is kept, or no event has come, or the
                forcing depends on time and its epoch is unknown.
        """
        self._follow()
        return self._run.estimate(whole_stamp(stamp))

    def impact(self, verdict: Verdict) -> ImpactEstimate | None:
        """The estimate of an impact that a ``verdict`` just received applies or inserts.

        Returns None for a release, and where the event is in the past that is kept no longer.

        Raises:
            ImpactLawError: the impact law has no solution.
        """
        return self._run.impact(verdict)

    def silence(self, stamp: int) -> str:
        """The warning that predicted impacts have not come up to ``stamp`` (ns), or nothing.

        Raises:
            UsageError: as ``estimate``.
        """
        self._follow()
        return self._run.silence(stamp)

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
        found = [np.diag(self._run.estimate((a + b) // 2).covariance) for a, b in pairs]
        return np.asarray(np.sqrt(np.median(found, axis=0)))

    def obstacle(self, stamp: int) -> str:
        """Why the estimate at ``stamp`` (ns) is not synchronized; empty where it is.

        Raises:
            UsageError: as ``estimate``.
        """
        self._follow()
        return self._run.obstacle(whole_stamp(stamp))

    def estimates(self, stamps: Stamps, *, replicas: bool = False) -> Iterator[Estimates]:
        """``estimate`` at each of ``stamps`` (ns, ascending, shape (samples,)), many at a time.

        The states equal those of ``estimate`` in every bit. With ``replicas`` the states of all
        replicas that move by themselves are given, too, and all other values, such as a
        covariance, are those of the first of many stamps.

        Raises:
            UsageError: as ``estimate``.
        """
        self._follow()
        return self._run.estimates(whole_stamps(stamps), replicas=replicas)

    def run(self, times: Mapping[str, ArrayLike], seconds: ArrayLike) -> StateArrays:
        """The states after all impacts up to each of ``seconds``, of an observer without events.

        Args:
            times: of the impacts of each contact, s since the epoch.
            seconds: since the epoch, ascending, s.

        Raises:
            ImpactLawError, UsageError: as ``receive``.
        """
        epoch, made = self.given_epoch or epoch_before(times), list[Estimates]()
        stamps = epoch + np.round(np.asarray(seconds, dtype=float) * NS_PER_S).astype(np.int64)
        for event in (*events_at(times, epoch), None):
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

        The state, shape (n,) each, holds after the events received with this stamp; later ones act
        on it. Before any event or epoch is received, it becomes the initial state. The
        ``covariance`` has shape (2n, 2n), or is a list of its rows; None for the initial one.

        Raises:
            UsageError: a state or covariance of the wrong size or one that is not finite.
            ImpactLawError: contacts are closed and their law has no solution for that state.
        """
        x = np.concatenate(self.system.checked_state(position, velocity))
        root = self._root if covariance is None else covariance_root(covariance, self.system.n)
        self._follow()
        if (timeline := self._run.timeline) is None:
            self._initial, self._root, self._starts = x, root, None
            self.encoders = self._run.encoders = None
        else:
            stamp = max(whole_stamp(stamp), timeline.start.stamp)
            now = timeline.entry_at(stamp)
            replicas = spread(x, root, self.ensemble)
            first = self._entry_of(replicas, root, stamp, now.closed, now.latest)
            self._run.restart(first)

    def start_from(self, replicas: Matrix) -> None:
        """Run ``replicas`` (q, u), shape (N, 2n), the estimate first, instead of the ensemble.

        All that was received is forgotten.
        """
        self._initial, self.ensemble, self._starts = replicas[0], len(replicas), replicas
        self.restart()

    @property
    def start(self) -> int | None:
        """The earliest stamp of an estimate, ns; None before an epoch or event is received."""
        return None if self._run.timeline is None else self._run.timeline.start.stamp

    @property
    def epoch(self) -> int:
        """Stamp of ``t = 0`` of the forcing, ns; 0 while unknown."""
        return self._run.epoch

    @property
    def timeline(self) -> Timeline | None:
        """The events that are kept, each with the belief after it; None before the first stamp."""
        return self._run.timeline

    @property
    def last_event(self) -> int:
        """Stamp of the latest event applied, ns; 0 before the first."""
        return self._run.last_event

    @property
    def missing(self) -> int:
        """How many sequence numbers are missing since the first received."""
        return self._run.numbers.missing

    def _first_entry(self, stamp: int) -> Entry:
        encoders = self._run.encoders
        initial = self._initial if encoders is None else encoders.state
        replicas = self._starts
        if replicas is None:
            replicas = spread(initial, self._root, self.ensemble)
        return self._entry_of(replicas, self._root, stamp)

    def _entry_of(
        self,
        replicas: Matrix,
        root: Matrix,
        stamp: int,
        closed: Contacts = (),
        latest: LatestSequences | None = None,
    ) -> Entry:
        """Replicas, shape (N, 2n), at ``stamp`` (ns), before any other event."""
        if self.system.frame is not None:
            at = np.full(len(replicas), stamp - self.epoch)
            replicas = self.system.to_frame(at, replicas)
        belief = self.law.begin(replicas, root, closed)
        return initial_entry(stamp, belief, self._test.initial(belief), closed, latest)

    def _change_run(self, previous: SenderRun) -> None:
        """Follow the new run of the sender after the ``previous`` one."""
        run = self._runs.in_use
        assert run is not None, "it has changed"
        if previous.goes_on_as(run):
            self._adopt(run.epoch)
            return
        self._begin_run(run.epoch or self.given_epoch)
        is_epoch = run.epoch != previous.epoch and run.episode <= previous.episode
        name = f"epoch {text(run.epoch)} s" if is_epoch else f"episode {run.episode}"
        self._notices = [*self._notices, f"{name} is new: the observer is reset"]
        self.remarks[Remark.EPOCH if is_epoch else Remark.EPISODE] += 1
        self.restarts += 1

    def _resolve_contacts(
        self, event: ImpactEvent
    ) -> tuple[tuple[Verdict, ...], tuple[tuple[int, Kind], ...]]:
        """A verdict for each switch, and the switches to apply; OPEN last for each contact."""
        if not event.switches:
            return (_verdict(event, Ruling.REJECTED, "it names no contact"),), ()
        verdicts: list[Verdict] = []
        switches: list[tuple[int, Kind]] = []
        for switch in event.switches:
            verdict = Verdict(event.stamp, Ruling.APPLIED, event.sequence, switch.contact)
            index = self._index.get(switch.contact)
            if index is not None:
                switches.append((index, switch.kind))
            else:
                self.remarks[Remark.UNKNOWN_CONTACT] += 1
                reason = f"the model's contacts are {', '.join(self._index) or 'none'}"
                verdict = verdict._replace(ruling=Ruling.UNKNOWN_CONTACT, reason=reason)
            verdicts.append(verdict)
        return tuple(verdicts), tuple(sorted(set(switches)) if len(switches) > 1 else switches)

    def refuse(self, event: ImpactEvent, reason: str) -> tuple[Verdict, ...]:
        """Reject an event of another run of the sender than the one in use."""
        return self._refuse(event, Ruling.REJECTED, reason, Remark.UNCONFIRMED)

    def _refuse(
        self, event: ImpactEvent, ruling: Ruling, reason: str, remark: Remark
    ) -> tuple[Verdict, ...]:
        self.remarks[remark] += 1
        return self._with_notices((_verdict(event, ruling, reason),))

    def _with_notices(self, verdicts: tuple[Verdict, ...]) -> tuple[Verdict, ...]:
        """``verdicts``, the first of them with the pending notices about the stream."""
        if not self._notices:
            return verdicts
        notices, self._notices = self._notices, []
        first, *others = verdicts
        return (with_reasons(first, notices), *others)

    def _note_disorder(self, insertion: Insertion, *, is_overtaken: bool) -> None:
        """Count irregularities in the order of an event that was inserted."""
        entry, again = insertion.entry, insertion.again
        if again or is_overtaken:
            self.remarks[Remark.LATE] += 1
            late = f"late: {again} event{'s' * (again != 1)} run again"
            self._notices = [*self._notices, late]
        if entry.overruled or insertion.overrules:
            overruled = [*entry.overruled, *(each for _, each in insertion.overrules)]
            superseded = [each.is_superseded for each in overruled]
            self.remarks[Remark.SUPERSEDED] += sum(superseded)
            self.remarks[Remark.DISORDER] += not all(superseded)


def _order(event: ImpactEvent) -> tuple[int, int]:
    return event.stamp, event.sequence


def _verdict(event: ImpactEvent, ruling: Ruling, reason: str) -> Verdict:
    return Verdict(event.stamp, ruling, event.sequence, reason=reason)
