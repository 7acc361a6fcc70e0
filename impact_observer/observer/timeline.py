# SPDX-License-Identifier: Apache-2.0
"""The observer's past: every event and sample in its place, and the belief after each.

A late event is put in its place, and the events after it are applied again (``docs/nodes.md``).
"""

import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from operator import attrgetter

from impact_observer.errors import DynamicsError, ImpactLawError, ImpactObserverError
from impact_observer.events import Contacts
from impact_observer.observer.belief import Belief, Prediction
from impact_observer.observer.contact_change import ContactChange
from impact_observer.observer.event_order import (
    AFTER_ALL,
    BEFORE_ALL,
    EventKey,
    LastSwitches,
    Switches,
    acting,
)
from impact_observer.observer.laws.law import Law
from impact_observer.observer.samples import DeclaredSensor, Reading, SampleOutcome
from impact_observer.observer.synchronization import Synchronization, SynchronizationTest
from impact_observer.stamps import Elapsed, seconds_between, text
from impact_observer.states import Matrix

MOST_EVENTS = 5000
"""Events of the history that are kept, whatever its length."""
MOST_MEASURED = 20_000
"""Samples of sensors that are kept beside the events."""
_STAMP = attrgetter("key.stamp")


@dataclass(slots=True, eq=False)
class Entry:
    """The posterior of one event or sample.

    Attributes:
        key: the event or sample; at the start of the past, a key without either.
        since: stamp at which ``belief`` holds, ns: an earlier one where ``key`` has no effect.
        belief: just after it.
        synchronization: of the replicas just after it.
        closed: contacts with ``chi = 1`` after it.
        last: stamp (ns) and sequence of the last event so far; zeros before the first.
        impact: stamp of the last impact so far, ns; 0 before the first.
        replaced: contacts of the event whose switches do not act, see ``acting``.
        last_switches: the numbers of ``acting`` after it.
        error: why the event has no effect; None if it is applied.
        outcome: of a sample; None for an event.
        rejected: by index of a sensor, how many of its latest samples in a row were rejected.
        prediction: from ``since`` on; None until the first request.
    """

    key: EventKey
    since: int
    belief: Belief = field(repr=False)
    synchronization: Synchronization
    closed: Contacts = ()
    last: tuple[int, int] = (0, 0)
    impact: int = 0
    replaced: Contacts = ()
    last_switches: LastSwitches = field(default_factory=dict)
    error: ImpactObserverError | None = None
    outcome: SampleOutcome | None = None
    rejected: Mapping[int, int] = field(default_factory=dict)
    prediction: Prediction | None = field(default=None, repr=False)

    @property
    def event(self) -> tuple[int, int]:
        """Stamp (ns) and sequence of the event, or those of a sample."""
        return self.key[:2]


class Timeline:
    """Events and samples in order with the beliefs after them, back to a bounded past.

    Attributes:
        entries: the entry at the start of the past, then one entry an event or sample.
        zero: stamp of ``t = 0`` of the forcing, ns; the start where it does not matter.
    """

    def __init__(
        self,
        law: Law,
        test: SynchronizationTest,
        history: int,
        sensors: Sequence[DeclaredSensor] = (),
    ) -> None:
        """Prepare to ``begin``; an event that is later than ``history`` (ns) is not applied."""
        self.entries = list[Entry]()
        self.zero = 0
        self._law, self._test, self._history = law, test, history
        self._sensors = sensors

    def begin(
        self, replicas: Matrix, root: Matrix, stamp: int, zero: int, keys: Iterable[EventKey] = ()
    ) -> None:
        """Begin with ``replicas`` (q, u), shape (N, 2n), before all events of a ``stamp`` (ns).

        The events and samples so far, and other ``keys`` in any order, are applied after it. The
        ``root`` is one of the estimate's covariance, shape (2n, 2n).
        """
        known = sorted([*(entry.key for entry in self.entries[1:]), *keys])
        self.zero = zero
        belief = self._law.begin(replicas, root, ())
        first = Entry(EventKey(stamp, BEFORE_ALL), stamp, belief, self._test.initial(belief))
        self.entries = [first]
        self._apply(1, [key for key in known if key > first.key])

    def set_state(self, replicas: Matrix, root: Matrix, stamp: int) -> None:
        """Forget the past: ``replicas`` are the state after all events of a ``stamp`` (ns).

        Raises:
            ImpactLawError: contacts are closed and their law has no solution for that state.
        """
        now, key = self.entry_at(stamp), EventKey(stamp, AFTER_ALL)
        belief = self._law.begin(replicas, root, now.closed)
        test, numbers = self._test.initial(belief), now.last_switches
        later = [entry.key for entry in self.entries if entry.key.stamp > stamp]
        self.entries = [Entry(key, stamp, belief, test, now.closed, last_switches=numbers)]
        self._apply(1, later)

    def go_on_from(self, stamp: int) -> bool:
        """Forget the past before a ``stamp`` (ns) if nothing is later; returns whether so."""
        last = self.entries[-1]
        if last.key.stamp >= stamp:
            return False
        belief = self.prediction(last).belief(seconds_between(last.since, stamp))
        key = EventKey(stamp, AFTER_ALL)
        self.entries = [replace(last, key=key, since=stamp, belief=belief, prediction=None)]
        return True

    @property
    def start(self) -> int:
        """The earliest stamp at which an estimate can still be made, ns."""
        return self.entries[0].key.stamp

    @property
    def newest(self) -> int:
        """The latest stamp, ns."""
        return self.entries[-1].key.stamp

    @property
    def is_complete(self) -> bool:
        """Whether nothing has been forgotten yet."""
        return self.entries[0].key.sequence == BEFORE_ALL

    @property
    def earliest(self) -> int:
        """The earliest stamp of an event that is still applied, ns."""
        return max(self.start, self.newest - self._history)

    def accepts(self, key: EventKey) -> bool:
        """Whether an event or sample is not too late."""
        return key > self.entries[0].key and key.stamp >= self.earliest

    def __contains__(self, key: EventKey) -> bool:
        """Whether the timeline has the same event, or a sample of the same sensor and stamp."""
        at = bisect_left(self.entries, key[:2], key=attrgetter("event"))
        for entry in self.entries[at:]:
            if entry.event != key[:2]:
                break
            if key.sample or entry.key == key:
                return True
        return False

    def inserting(self, keys: Iterable[EventKey]) -> Iterator[Sequence[Entry]]:
        """Put events and samples that it ``accepts`` in place; apply later ones again, once.

        Yields:
            Nothing after those of each stamp; at last the entries from the first stamp of ``keys``
            on. The entries change then only, and until then no other call may change them.
        """
        new = [*keys]
        first = bisect_left(self.entries, min(new).stamp, lo=1, key=_STAMP)
        made = [self.entries[first - 1]]
        every = sorted([*(entry.key for entry in self.entries[first:]), *new])
        for _, of_stamp in groupby(every, key=attrgetter("stamp")):
            made += self._after(made[-1], [*of_stamp])
            yield ()
        self.entries[first:] = made[1:]
        self._forget()
        yield made[1:]

    def rerun(self, stamp: int) -> None:
        """Apply the events after ``stamp`` (ns) again with changed samples of forces."""
        first = max(bisect_right(self.entries, stamp, key=_STAMP), 1)
        previous = self.entries[first - 1]
        if previous.prediction is not None and not previous.prediction.follows_samples:
            previous.prediction = None
        self._apply(first, [entry.key for entry in self.entries[first:]])

    def _apply(self, first: int, keys: Iterable[EventKey]) -> None:
        """Replace the entries from number ``first`` on by those of ``keys``, in order."""
        made = [self.entries[first - 1]]
        for _, of_stamp in groupby(keys, key=attrgetter("stamp")):
            made += self._after(made[-1], [*of_stamp])
        self.entries[first:] = made[1:]

    def _forget(self) -> None:
        """Drop the entries that are older than the history, or too many, but the last of them."""
        entries, until = self.entries, self.newest - self._history
        most = MOST_EVENTS + MOST_MEASURED if self._sensors else MOST_EVENTS
        old = max(len(entries) - most, 0)
        until = max(until, entries[old].key.stamp if old else until)
        while old + 1 < len(entries) and entries[old + 1].key.stamp <= until:
            old += 1  # rarely more than one
        if old:
            oldest = entries[old]
            entries[: old + 1] = [replace(oldest, key=EventKey(oldest.key.stamp, AFTER_ALL))]

    def entry_at(self, stamp: int) -> Entry:
        """The last entry at or before ``stamp`` (ns)."""
        return self.interval(stamp)[0]

    def interval(self, stamp: int) -> tuple[Entry, int | None]:
        """The ``entry_at`` a stamp (ns), and the stamp of the next entry, None for the last."""
        after = max(bisect_right(self.entries, stamp, key=_STAMP), 1)
        is_last = after == len(self.entries)
        return self.entries[after - 1], None if is_last else self.entries[after].key.stamp

    def around(self, stamp: int, sequence: int, contact: int) -> tuple[Entry, Entry] | None:
        """The entry before the event of a contact, and that of the event; None if not known.

        The event has this ``stamp`` (ns) and ``sequence``.
        """
        at = bisect_right(self.entries, (stamp, sequence), key=attrgetter("event"))
        while at > 1 and self.entries[at - 1].event == (stamp, sequence):
            at -= 1
            if any(i == contact for i, _ in self.entries[at].key.switches):
                return self.entries[at - 1], self.entries[at]
        return None

    def prediction(self, entry: Entry) -> Prediction:
        """The prediction from the belief of ``entry``, made at the first call."""
        if entry.prediction is None:
            start = Elapsed(entry.since - self.zero)
            entry.prediction = self._law.predict(start, entry.belief, entry.closed)
        return entry.prediction

    def _after(self, previous: Entry, keys: Sequence[EventKey]) -> list[Entry]:
        """The entries of the events, then of the samples, of one stamp."""
        entries, events = [previous], [each for each in keys if not each.sample]
        for event, switches, numbers in acting(events, previous.last_switches):
            before = entries[-1]
            try:
                entry = self._after_event(before, event, switches)
            except ImpactObserverError as error:
                entry = replace(before, key=event, error=error, replaced=(), outcome=None)
            entries.append(replace(entry, last_switches=numbers))
        if samples := keys[len(events) :]:
            entries += self._after_samples(entries[-1], samples)
        return entries[1:]

    def _after_event(self, previous: Entry, event: EventKey, switches: Switches) -> Entry:
        """The entry of an event of which these ``switches`` act.

        Raises:
            DynamicsError: as ``Law.correct``, or the estimate is not finite.
        """
        stamp = event.stamp
        replaced = tuple(sorted({i for i, _ in event.switches} - {i for i, _ in switches}))
        base = replace(
            previous, key=event, last=event[:2], replaced=replaced, error=None, outcome=None
        )
        if not switches:
            return base
        s = seconds_between(previous.since, stamp)
        change = ContactChange.of(
            Elapsed(stamp - self.zero),
            previous.closed,
            switches,
            stamp=stamp,
            sequence=event.sequence,
            flown=s,
        )
        prior = self.prediction(previous).belief(s) if s > 0 else previous.belief
        try:
            posterior = self._law.correct(change, prior)
        except ImpactLawError as error:
            raise ImpactLawError(f"at {text(stamp)} s: {error}") from None
        result = self._test.after_event(previous.synchronization, change, prior.x, posterior)
        if not math.isfinite(result.energy):
            raise DynamicsError(f"at {text(stamp)} s: the estimate is not finite any more")
        return replace(
            base,
            since=stamp,
            belief=posterior,
            synchronization=result,
            closed=change.closed,
            impact=stamp if change.hit else previous.impact,
            prediction=None,
        )

    def _after_samples(self, previous: Entry, keys: Sequence[EventKey]) -> list[Entry]:
        """The entries of samples of one stamp; all have the posterior after the last of them.

        Samples that are not used leave the motion unchanged.
        """
        stamp, base = keys[0].stamp, replace(previous, replaced=(), error=None)
        outcomes, used = dict[int, SampleOutcome](), list[Reading]()
        for reading in (self._reading(previous, each) for each in keys):
            ago, blanking = reading.since_impact, reading.sensor.measurement.blanking
            if ago < blanking:
                reason = f"blanking: an impact was {ago:.3g} s ago; {blanking:g} s are left out"
                outcomes[reading.sensor.index] = SampleOutcome.unused(reason)
            else:
                used.append(reading)
        if used:
            s, prediction = seconds_between(previous.since, stamp), self.prediction(previous)
            try:
                belief, made = self._law.measure(used, previous.belief, prediction, s)
                if belief is not None and not math.isfinite(belief.x.dot(belief.x)):
                    raise DynamicsError(f"at {text(stamp)} s: the estimate is not finite any more")
            except ImpactObserverError as error:
                belief, made = None, [SampleOutcome.unused(str(error)) for _ in used]
            outcomes |= {r.sensor.index: found for r, found in zip(used, made, strict=True)}
            base.rejected = _rejected_after(previous, outcomes)
            if belief is not None:
                base = replace(base, since=stamp, belief=belief, prediction=None)
        return [replace(base, key=each, outcome=outcomes[each.sensor]) for each in keys]

    def _reading(self, previous: Entry, key: EventKey) -> Reading:
        """A sample, after the ``previous`` entry."""
        (value,), impact = key.sample, previous.impact
        return Reading(
            self._sensors[key.sensor],
            value,
            key.stamp - self.zero,
            seconds_between(impact, key.stamp) if impact else math.inf,
            previous.closed,
            previous.rejected.get(key.sensor, 0),
        )


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
