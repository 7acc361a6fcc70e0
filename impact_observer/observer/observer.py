"""The observer: events in, estimates out. The node and the offline command run this object."""

from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from math import isfinite

import numpy as np
from numpy.typing import ArrayLike

from impact_observer.errors import DynamicsError, ImpactLawError, ImpactObserverError, UsageError
from impact_observer.estimation.contact_change import ContactChange
from impact_observer.estimation.uncertainty import covariance_root, spread
from impact_observer.events import Contacts, ImpactEvent, Kind, Remark, Ruling, Verdict
from impact_observer.model import System
from impact_observer.observer.belief import Prediction
from impact_observer.observer.event_order import EventKey, Interpretation, LatestSequences
from impact_observer.observer.laws.law import Law
from impact_observer.observer.sequence_numbers import SequenceNumbers
from impact_observer.observer.synchronization import AGREED, REQUIRED_EVENTS, SynchronizationTest
from impact_observer.observer.timeline import Entry, Insertion, Timeline, initial_entry
from impact_observer.observer.verdicts import Notes, Rulings, because, judged
from impact_observer.stamps import NS_PER_S, from_seconds, seconds_between, text
from impact_observer.states import (
    NO_COVARIANCE,
    Estimate,
    Estimates,
    Matrix,
    Stamps,
    Vector,
    frozen,
)

DEFAULT_HISTORY = 10.0
"""How late an event may be and still be applied, s."""
DEFAULT_ENSEMBLE = 10
"""Replicas that are run together."""
MOST_NUMBERS = 100_000
"""Numbers of events that are remembered, where none of them can be applied."""
_SOON = NS_PER_S // 1000
"""After a rehearsed event an estimate is made of so long afterwards, ns."""


class Observer:
    """Replicas of ``system``, switched by events only; the first of them is the estimate.

    The others begin elsewhere, spread over the initial uncertainty that its law was told: whether
    they come together is what an observer can know of its own error. The estimate does not
    depend on them.

    Its initial state holds at the epoch, or, when the observer hears of the plant only later
    (the lowest sequence number that it sees is not 1), at the first stamp it sees.

    Attributes:
        system: the system that plant and replica share.
        law: what the replica does at an event.
        remarks: how often the stream was not as it should be, and how.
    """

    def __init__(
        self,
        system: System,
        law: Law,
        position: Vector,
        velocity: Vector,
        *,
        epoch: int = 0,
        history: float = DEFAULT_HISTORY,
        ensemble: int = DEFAULT_ENSEMBLE,
        agreed: float = AGREED,
    ) -> None:
        """Make an observer that has seen nothing yet.

        Args:
            system: the system.
            law: a law for the same system.
            position: initial coordinates, shape (n,), m or rad.
            velocity: initial velocities, shape (n,).
            epoch: stamp of ``t = 0`` of the forcing, ns; 0 to learn it from the events.
            history: how late an event may be and still be applied, s.
            ensemble: how many replicas are run together, at least one.
            agreed: V distance at which they count as synchronized, relative to the energy of the
                estimated motion.

        Raises:
            UsageError: a state of the wrong size, a history or an agreement that is not positive,
                or an ensemble of none.
        """
        for name, value in (("history", history), ("agreed", agreed), ("ensemble", ensemble)):
            if not value > 0:
                raise UsageError(f"{name}: {value:g} found; expected a positive number")
        q, u = system.checked_state(position, velocity)
        self.system = system
        self.law = law
        self._initial = np.concatenate([q, u])
        self._root = law.uncertainty.root(system.n)
        self._ensemble = ensemble
        self._agreeing = SynchronizationTest(system, agreed)
        self._history = from_seconds(history)
        self._names = system.contact_names
        self._index = {name: i for i, name in enumerate(self._names)}
        self._timed = system.forcing.depends_on_time
        self._given_epoch = epoch
        self.remarks: Counter[Remark] = Counter()
        self._news: list[str] = []
        self.restart()

    def restart(self, reason: str = "") -> None:
        """Forget everything, as if just made: for a clock that jumped back, or a new plant.

        Args:
            reason: why, for the next verdict.
        """
        if reason:
            self._news = [*self._news, f"{reason}: everything begins again"]
        self._epoch = self._given_epoch
        self._episode: int | None = None
        self._timeline: Timeline | None = None
        self._placed = False
        self._numbers = SequenceNumbers()
        self._rulings = Rulings()
        self._earliest = 0
        if self._epoch:
            self._timeline = Timeline(self._beginning(self._epoch))

    def set_state(
        self,
        stamp: int,
        position: ArrayLike,
        velocity: ArrayLike,
        covariance: ArrayLike | None = None,
    ) -> None:
        """Forget the past: from ``stamp`` (ns) on the replica moves from the given state.

        It holds after the known events of its stamp; those that are known to have come later
        act on it. Before anything is known of the plant, it becomes the initial state.

        Args:
            stamp: ns.
            position: coordinates, shape (n,), m or rad.
            velocity: velocities, shape (n,).
            covariance: of the state, shape (2n, 2n) or its rows one after the other; None for the
                initial one.

        Raises:
            UsageError: a state or covariance of the wrong size or one that is not finite.
            ImpactLawError: contacts are closed and their law has no solution for that state.
        """
        x = np.concatenate(self.system.checked_state(position, velocity))
        root = self._root if covariance is None else covariance_root(covariance, self.system.n)
        if self._timeline is None:
            self._initial, self._root = x, root
        else:
            stamp = max(stamp, self._timeline.start.stamp)
            now = self._timeline.at(stamp)
            first = self._about(x, root, stamp, now.closed, now.spoken)
            self._timeline.begin_after(first, self._step)
            self._placed = True

    def _beginning(self, stamp: int) -> Entry:
        """Replicas at ``stamp`` (ns) about the initial state, before any event."""
        return self._about(self._initial, self._root, stamp)

    def _about(
        self,
        x: Vector,
        root: Matrix,
        stamp: int,
        closed: Contacts = (),
        spoken: LatestSequences | None = None,
    ) -> Entry:
        """Replicas at ``stamp`` (ns) about ``x``, before any other event."""
        belief = self.law.begin(spread(x, root, self._ensemble), root, closed)
        return initial_entry(stamp, belief, self._agreeing.at_first(belief), closed, spoken)

    @property
    def start(self) -> int | None:
        """The earliest stamp that can be asked for, ns; None before anything is known."""
        return None if self._timeline is None else self._timeline.start.stamp

    @property
    def epoch(self) -> int:
        """Stamp of ``t = 0`` of the forcing, ns; 0 while unknown."""
        return self._epoch

    @property
    def last_event(self) -> int:
        """Stamp of the latest event applied, ns; 0 before the first."""
        newest = self._timeline.newest if self._timeline else None
        return newest.stamp if newest and newest.switches else 0

    @property
    def missing(self) -> int:
        """Events that the sender numbered and that have not come in time, since the first seen."""
        return self._numbers.missing

    @property
    def restarts(self) -> int:
        """How often a new episode or epoch made the replica begin again."""
        return self.remarks[Remark.EPISODE] + self.remarks[Remark.EPOCH]

    def receive(self, event: ImpactEvent) -> tuple[Verdict, ...]:
        """Apply ``event`` at its own stamp, whenever it arrives.

        Returns:
            One verdict a switch, or one on the whole event; then what the law has inserted, and
            what it now thinks otherwise of earlier events.

        Raises:
            ImpactLawError: the impact law has no solution; the event is not applied.
            DynamicsError: the loads of closed contacts cannot be found; likewise.
            UsageError: the forcing depends on time and nobody has said when it began.
        """
        if event.episode != self._episode or event.epoch != self._epoch:
            if (reason := self._outdated(event)) is not None:
                return self._refused(event, Ruling.REJECTED, reason, Remark.PAST)
            self._meet(event)
        self._require_epoch()
        if event.sequence in self._numbers:
            reason = "this sequence number was seen"
            return self._refused(event, Ruling.DUPLICATE, reason, Remark.DUPLICATE)
        verdicts, switches = self._sorted_out(event)
        news = self._news
        self._remember(event)
        try:
            timeline = self._begun()
            key = EventKey(event.stamp, event.sequence, switches)
            if not switches:
                self._numbers.keep(MOST_NUMBERS)  # no stamp of its own may decide what is over
                return self._with_news(verdicts)
            if timeline.newest.stamp >= key.stamp and (why := _misplaced(key, timeline)):
                return self._refused(event, *why)
            placed = timeline.insert(key, self._step)
        except ImpactObserverError:
            self._numbers.undo(event.sequence)
            self._news = news
            raise
        self._forget(timeline)
        return self._judged(verdicts, placed)

    def estimate(self, stamp: int) -> Estimate:
        """The state at ``stamp`` (ns) after all known events at or before it.

        Raises:
            UsageError: ``stamp`` lies before the known past, or nothing is known yet, or the
                forcing depends on time and nobody has said when it began.
        """
        entry = self._reaching(stamp).at(stamp)
        self._require_epoch()
        return self._estimated(entry, stamp)

    def _estimated(self, entry: Entry, stamp: int) -> Estimate:
        """The state at ``stamp`` (ns) after the event of ``entry`` and no other."""
        n, s = self.system.n, seconds_between(entry.since, stamp)
        course = self._course(entry)
        x, root = entry.belief.x, entry.belief.root
        if s > 0:
            x, root = course.state(s), course.root(s)
        closed = course.closed(s)
        closed = entry.closed if closed is None else closed
        bound, agreement = entry.belief.bound, entry.agreement
        applied = bool(entry.key.switches)
        return Estimate(
            stamp=stamp,
            law=self.law.name,
            q=x[:n],
            u=x[n:],
            covariance=NO_COVARIANCE if root is None else frozen(root @ root.T),
            closed=tuple([self._names[i] for i in closed]),
            convergence=agreement.convergence,
            synchronized=self.law.uses_events
            and agreement.held >= REQUIRED_EVENTS
            and (root is None or self._agreeing.allows(agreement, root)),
            bound=-1.0 if bound is None else bound,
            inconsistent=entry.belief.inconsistent,
            clock_offset=entry.belief.clock_offset,
            parameters=entry.belief.parameters,
            last_sequence=entry.key.sequence if applied else 0,
            last_event=entry.key.stamp if applied else 0,
        )

    def estimates(self, stamps: Stamps) -> Iterator[Estimates]:
        """``estimate`` at each of ``stamps`` in every bit, many at a time.

        Args:
            stamps: ns, ascending, shape (samples,).

        Raises:
            UsageError: as ``estimate``.
        """
        while stamps.size:
            first = self.estimate(int(stamps[0]))
            x, count = np.concatenate([first.q, first.u])[None], 1
            entry, end = self._reaching(first.stamp).around(first.stamp)
            if (course := self._course(entry)).is_plain:
                count = stamps.size if end is None else int(np.searchsorted(stamps, end))
            if count > 1:
                s = np.array([seconds_between(entry.since, at) for at in stamps[1:count].tolist()])
                x = np.concatenate([x, np.where(s[:, None] > 0, course.states(s), x)])
            yield Estimates(first, stamps[:count], x)
            stamps = stamps[count:]

    def rehearse(self) -> None:
        """Run the last event again, and an estimate after it, and forget both.

        Nothing that is said later depends on it. But what was just run is in the processor's
        caches, so that whoever hears an event now and then is answered in half the time.
        """
        if self._timeline is None:
            return
        with suppress(ImpactObserverError):  # who asks for that estimate will hear of it
            if (entry := self._timeline.rehearsed(self._step)) is not None:
                self._estimated(entry, entry.key.stamp + _SOON)

    def _reaching(self, stamp: int) -> Timeline:
        """The timeline, if ``stamp`` (ns) is in it."""
        if self._timeline is None or stamp < self._timeline.start.stamp:
            known = (
                "no event has come"
                if self._timeline is None
                else (f"the known past begins at {text(self._timeline.start.stamp)} s")
            )
            raise UsageError(f"estimate at {text(stamp)} s: {known}")
        return self._timeline

    def _outdated(self, event: ImpactEvent) -> str | None:
        """Why ``event`` is of a past that is over; None if it is not.

        The epoch decides; a plant that is started anew counts its episodes from 0 again.
        """
        if event.epoch and self._epoch and event.epoch != self._epoch:
            return (
                f"its epoch {text(event.epoch)} s is before the one in use, {text(self._epoch)} s"
                if event.epoch < self._epoch
                else None
            )
        if self._episode is not None and event.episode < self._episode:
            return f"episode {event.episode} is over"
        return None

    def _meet(self, event: ImpactEvent) -> None:
        """Notice a new episode or epoch: the plant began again, and so does the replica."""
        moved = bool(event.epoch and self._epoch and event.epoch != self._epoch)
        newer = self._episode is not None and event.episode > self._episode
        if moved or newer:
            name = f"episode {event.episode}" if newer else f"epoch {text(event.epoch)} s"
            self.restart(f"{name} is new")
            self.remarks[Remark.EPISODE if newer else Remark.EPOCH] += 1
            self._timeline = None
        self._episode = event.episode
        self._epoch = event.epoch or self._epoch

    def _sorted_out(
        self, event: ImpactEvent
    ) -> tuple[tuple[Verdict, ...], tuple[tuple[int, Kind], ...]]:
        """A verdict for each switch, and the switches to apply: of one contact, OPEN last."""
        if not event.switches:
            return (self._verdict(event, Ruling.REJECTED, "it names no contact"),), ()
        verdicts: list[Verdict] = []
        switches: set[tuple[int, Kind]] = set()
        for switch in event.switches:
            verdict = Verdict(event.stamp, Ruling.APPLIED, event.sequence, switch.contact)
            index = self._index.get(switch.contact)
            if index is not None:
                switches.add((index, switch.kind))
            else:
                self.remarks[Remark.UNKNOWN_CONTACT] += 1
                reason = f"the model's contacts are {', '.join(self._index) or 'none'}"
                verdict = verdict._replace(ruling=Ruling.UNKNOWN_CONTACT, reason=reason)
            verdicts.append(verdict)
        return tuple(verdicts), tuple(sorted(switches) if len(switches) > 1 else switches)

    def _require_epoch(self) -> None:
        if self._timed and not self._epoch:
            raise UsageError(
                f"epoch: the forcing of {self.system.name} depends on time and the events do not"
                " say when it began; give the epoch"
            )

    def _begun(self) -> Timeline:
        """The timeline, begun where all events seen so far, in any order, say it begins."""
        start = self._epoch if self._epoch and self._numbers.first <= 1 else self._earliest
        if self._timeline is None:
            self._timeline = Timeline(self._beginning(start))
        elif self._timeline.start.stamp != start and self._timeline.whole and not self._placed:
            self._timeline.begin(self._beginning(start), self._step)
        return self._timeline

    def _remember(self, event: ImpactEvent) -> None:
        """Note an event, to know it when it comes twice and to miss the others."""
        if event.stamp < self._earliest or not self._earliest:
            self._earliest = event.stamp
        if gap := self._numbers.gap(event.sequence):
            self.remarks[Remark.GAP] += 1
            self._news = [*self._news, gap]
        self._numbers.note(event.sequence, event.stamp)

    def _forget(self, timeline: Timeline) -> None:
        """Keep the past bounded: what is older than the history is too late anyway."""
        if not timeline.forget_before(timeline.newest.stamp - self._history):
            return
        start = timeline.start.stamp
        self._rulings.forget_before(start)
        self._numbers.forget_before(start)

    def _refused(
        self, event: ImpactEvent, ruling: Ruling, reason: str, remark: Remark
    ) -> tuple[Verdict, ...]:
        """The verdict on a whole event."""
        self.remarks[remark] += 1
        return self._with_news((self._verdict(event, ruling, reason),))

    @staticmethod
    def _verdict(event: ImpactEvent, ruling: Ruling, reason: str) -> Verdict:
        return Verdict(event.stamp, ruling, event.sequence, reason=reason)

    def _with_news(self, verdicts: tuple[Verdict, ...]) -> tuple[Verdict, ...]:
        """``verdicts``, the first of them with what there is to say of the stream."""
        if not self._news:
            return verdicts
        news, self._news = self._news, []
        first, *others = verdicts
        return (because(first, news), *others)

    def _judged(self, verdicts: tuple[Verdict, ...], placed: Insertion) -> tuple[Verdict, ...]:
        """``verdicts`` with what became of each switch."""
        sequence, again = placed.entry.key.sequence, placed.again
        own, others = placed.entry.overruled, placed.overrules
        if again or 0 < sequence < self._numbers.highest:
            self.remarks[Remark.LATE] += 1
            late = f"late: {again} event{'s' * (again != 1)} run again"
            self._news = [*self._news, late]
        if own or others:
            superseded = [each.is_superseded for each in (*own, *(each for _, each in others))]
            self.remarks[Remark.SUPERSEDED] += sum(superseded)
            self.remarks[Remark.DISORDER] += not all(superseded)
        belief = placed.entry.belief
        if not (own or others or belief.hypotheses or belief.innovations):
            return self._with_news(verdicts)
        believed: Notes = {}
        revised: tuple[Verdict, ...] = ()
        if belief.hypotheses:
            assert self._timeline is not None, "the event is in it"
            # What is forgotten is settled, also where the event itself is late.
            start = max(placed.entry.key.stamp - self._history, self._timeline.start.stamp)
            believed, revised = self._rulings.after(placed, start, self._names)
        if revised:
            self.remarks[Remark.SECOND_THOUGHT] += sum(verdict.revises for verdict in revised)
        index = self._index
        told = [judged(each, index.get(each.contact, -1), placed, believed) for each in verdicts]
        return (*self._with_news(tuple(told)), *revised)

    def _step(self, previous: Entry, event: EventKey, reading: Interpretation) -> Entry:
        """The entry of ``event``, from the one before it."""
        s = seconds_between(previous.since, event.stamp)
        before = self._course(previous).belief(s) if s > 0 else previous.belief
        t = seconds_between(self._epoch or event.stamp, event.stamp)
        change = ContactChange.of(
            t,
            previous.closed,
            reading.switches,
            stamp=event.stamp,
            sequence=event.sequence,
        )
        try:
            belief = self.law.correct(change, before)
        except ImpactLawError as error:
            raise ImpactLawError(f"at {text(event.stamp)} s: {error}") from None
        agreement = self._agreeing.after(previous.agreement, change, before, belief)
        if not isfinite(agreement.energy):
            raise DynamicsError(
                f"at {text(event.stamp)} s: the estimate is not finite any more; is what was"
                " declared of its uncertainty too large, or the model another one?"
            )
        return Entry(
            event,
            event.stamp,
            belief,
            agreement,
            change.closed,
            reading.spoken,
            reading.overruled,
        )

    def _course(self, entry: Entry) -> Prediction:
        """How the belief of ``entry`` goes on: one exact motion from just after it."""
        if entry.prediction is None:
            t = seconds_between(self._epoch or entry.since, entry.since)
            entry.prediction = self.law.predict(t, entry.belief, entry.closed)
        return entry.prediction


def _misplaced(key: EventKey, timeline: Timeline) -> tuple[Ruling, str, Remark] | None:
    """Why an event cannot be put in its place; None if it can."""
    if not timeline.reaches(key):
        reason = f"older than {text(timeline.start.stamp)} s, where the known past begins"
        return Ruling.TOO_LATE, reason, Remark.TOO_LATE
    if key in timeline:
        return Ruling.DUPLICATE, "the same event was seen", Remark.DUPLICATE
    return None
