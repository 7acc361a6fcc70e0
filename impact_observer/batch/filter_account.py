# SPDX-License-Identifier: Apache-2.0
"""The account of a recording: the meaning of each event, by the likeliest hypothesis at the end.

The observer runs through the recording first. A hypothesis keeps its latest decisions only; those
on older events are the ones of the last hypothesis that still had them.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from impact_observer.events import Contacts, ImpactEvent, Kind, Ruling, Verdict
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.ledger import Note
from impact_observer.filter.model_error import NO_ERROR, LearnedError
from impact_observer.filter.readings import Reading, SampleOutcome
from impact_observer.observer import Observer, replay_batches
from impact_observer.observer.belief import Belief
from impact_observer.observer.laws.minimum_variance import MinimumVariance
from impact_observer.observer.samples import SensorSample
from impact_observer.observer.verdicts import verdict_of
from impact_observer.stamps import NS_PER_S, Elapsed, seconds_between

_SETTLED = 16
"""Events after which a hypothesis has learned the errors of clock and model at an event."""
FLIGHTS = 8.0
"""Longest flight of a chattering sequence that is left out, in deviations of stamps."""


class AccountMoment(NamedTuple):
    """An instant at which contacts switch, by an account.

    Attributes:
        change: the change of the contacts, at the reported stamp.
        clock: standard deviation of the stamp, s; without meaning for an inserted moment.
        error: error of the model in the flight before the moment, and at the impact.
        is_inserted: whether the moment is a missed detection: only the motion gives the instant.
        until: stamp until which further impacts of the contact, which chatters until it stays
            closed, are left out, ns; 0 without chatter.
    """

    change: ContactChange
    clock: float
    error: LearnedError = NO_ERROR
    is_inserted: bool = False
    until: int = 0


class EventAccount(NamedTuple):
    """The meaning of each event of a recording.

    Attributes:
        moments: true and inserted moments, in order.
        verdicts: the final verdicts, in order.
        reported: the moments if all events are as reported, without missed detections.
    """

    moments: tuple[AccountMoment, ...]
    verdicts: tuple[Verdict, ...]
    reported: tuple[AccountMoment, ...] = ()


class _Trace(NamedTuple):
    """The meaning of an event, and the likeliest hypothesis just after the event.

    Attributes:
        change: the reported change.
        notes: of the hypothesis on the latest events.
        clock: standard deviation of a stamp, s.
        error: of the model.
    """

    change: ContactChange
    notes: tuple[Note, ...]
    clock: float
    error: LearnedError


class TracedLaw(MinimumVariance):
    """The law of least variance that keeps its decisions after each event.

    Attributes:
        traces: by stamp and sequence number of the event.
        last: the belief after the last event.
        rejected: sensor and instant (ns since the epoch) of samples that their gates rejected.
        unexplained: events after which the model did not explain the impacts, as ``traces`` has
            them.
    """

    tries_steps = False
    traces: dict[tuple[int, int], _Trace]
    last: Belief | None
    rejected: set[tuple[int, int]]
    unexplained: set[tuple[int, int]]

    def forget(self) -> None:
        """Forget all traces, before a recording begins."""
        self.traces, self.last, self.rejected, self.unexplained = {}, None, set(), set()

    def measure(self, reading: Reading, prior: Belief) -> tuple[Belief, SampleOutcome]:
        """As the law does."""
        result = super().measure(reading, prior)
        self._note(reading, result[1])
        return result

    def followed(
        self, readings: Sequence[Reading], posterior: Belief, since: float, s: float
    ) -> tuple[Belief, list[SampleOutcome]] | None:
        """As the law does."""
        result = super().followed(readings, posterior, since, s)
        for each in zip(readings, result[1] if result is not None else (), strict=False):
            self._note(*each)
        return result

    def _note(self, reading: Reading, outcome: SampleOutcome) -> None:
        if not outcome.accepted:
            self.rejected.add((reading.sensor.index, reading.instant))

    def correct(self, change: ContactChange, belief: Belief) -> Belief:
        """As the law does."""
        posterior = super().correct(change, belief)
        best = posterior.hypotheses[0] if posterior.hypotheses else None
        event = change.stamp, change.sequence
        self.unexplained.discard(event)
        if posterior.fit.uncontradicted.is_misfit:
            self.unexplained.add(event)
        self.traces[event] = (
            _Trace(change, (), self.clocks[0], NO_ERROR)
            if best is None
            else _Trace(change, best.ledger.notes, best.clock, best.error)
        )
        self.last = posterior
        return posterior


def account_of(
    observer: Observer,
    law: TracedLaw,
    events: Sequence[ImpactEvent],
    samples: Sequence[SensorSample] = (),
    progress: Callable[[int], None] = lambda _: None,
) -> EventAccount:
    """The account of ``events`` by an ``observer`` with this ``law`` that has received none yet.

    ``samples`` are those of its sensors. ``progress`` is called with the number of events done.

    Raises:
        ImpactLawError, UsageError: as ``Observer.receive``.
    """
    law.forget()
    received = []
    nothing = np.empty(0, dtype=np.int64)
    made = replay_batches(observer, events, nothing, rejects=True, by_stamps=True, samples=samples)
    for each in made:
        assert isinstance(each, Verdict), "no estimates are asked for"
        received.append(each)
        progress(len(law.traces))
    traces = dict(sorted(law.traces.items()))
    decided: dict[tuple[int, int], list[Note]] = {}
    for trace in traces.values():
        decided |= _by_event(trace.notes)
    names = observer.system.contact_names
    verdicts = [each for each in received if (each.stamp, each.sequence) not in traces]
    verdicts = [v for v in verdicts if v.ruling is not Ruling.INSERTED and not v.revises]
    verdicts += [verdict_of(note, names) for notes in decided.values() for note in notes]
    epoch = observer.epoch or min(each.stamp for each in events)
    moments = tuple(_merged([*_moments(traces, decided, epoch)]))
    reported = tuple(_merged([*_moments(traces, {}, epoch)]))
    verdicts = sorted(_explained(verdicts, moments, names), key=lambda v: (v.stamp, v.sequence))
    return EventAccount(moments, tuple(verdicts), reported)


def _by_event(notes: Iterable[Note]) -> dict[tuple[int, int], list[Note]]:
    notes_of: dict[tuple[int, int], list[Note]] = {}
    for note in notes:
        notes_of.setdefault(note.event, []).append(note)
    return notes_of


def _moments(
    traces: Mapping[tuple[int, int], _Trace],
    decided: Mapping[tuple[int, int], Sequence[Note]],
    epoch: int,
) -> Iterator[AccountMoment]:
    """The moments of the decisions on each event, in order; all contacts are open at first."""
    closed: Contacts = ()
    since, later = 0, [*traces.values()]
    for k, (key, trace) in enumerate(traces.items()):
        notes = decided.get(key, ())
        _, _, clock, error = later[min(k + _SETTLED, len(later) - 1)]
        for note in notes:
            if note.is_inserted:
                switch = [(note.switched, note.kind)]
                change = _change(closed, switch, (note.stamp, 0), epoch, since)
                if change.is_nothing:
                    continue
                yield AccountMoment(change, 0.0, error, is_inserted=True)
                closed, since = change.closed, note.stamp
        own = [note for note in notes if not note.is_inserted]
        if own and own[0].ruling is not Ruling.APPLIED:
            continue
        noted = {note.contact: note for note in own}
        switches = [_switch(i, kind, noted.get(i)) for i, kind in trace.change.switches]
        change = _change(closed, switches, key, epoch, since)
        if not change.is_nothing:
            yield AccountMoment(change, clock, error)
            closed, since = change.closed, change.stamp


def _switch(contact: int, kind: Kind, note: Note | None) -> tuple[int, Kind]:
    """The contact that switched, and how, by the ``note`` on a reported ``contact``."""
    if note is None:
        return contact, kind
    settles = kind is Kind.IMPACT and note.kind is Kind.CLOSE
    return note.switched, Kind.CLOSE if settles else kind


def _merged(moments: Sequence[AccountMoment]) -> Iterator[AccountMoment]:
    """The moments, with the end of a chattering sequence as one moment that closes the contact.

    The flights of that end are as short as the errors of stamps: order and number of its impacts
    say no more than the first impact.
    """
    k, since = 0, 0
    while k < len(moments):
        first, end = moments[k], k + 1
        while end < len(moments) and _chatters(moments[end - 1], moments[end]):
            end += 1
        change, last = first.change, moments[end - 1]
        if end > k + 1 and last.change.closed != change.before:
            change = change._replace(closed=last.change.closed)
            until = last.change.stamp + round(FLIGHTS * last.clock * NS_PER_S)
            first = first._replace(until=until)
        else:
            end = k + 1
        flown = seconds_between(since or change.stamp, change.stamp)
        yield first._replace(change=change._replace(flown=flown))
        k, since = end, change.stamp


def _explained(
    verdicts: Iterable[Verdict], moments: Sequence[AccountMoment], names: Sequence[str]
) -> Iterator[Verdict]:
    """The ``verdicts``; impacts that ``_merged`` leaves out are not spurious."""
    spans = [(names[m.change.hit[0]], m.change.stamp, m.until) for m in moments if m.until]
    for each in verdicts:
        is_left_out = each.ruling is Ruling.REJECTED and any(
            each.contact == name and first <= each.stamp <= until for name, first, until in spans
        )
        yield each._replace(ruling=Ruling.APPLIED, reason="") if is_left_out else each


def _chatters(moment: AccountMoment, after: AccountMoment) -> bool:
    """Whether the same contact hits again within the errors of the stamps."""
    flight = seconds_between(moment.change.stamp, after.change.stamp)
    hit, before = moment.change.hit, moment.change.before
    return (
        len(hit) == 1
        and hit == after.change.hit == after.change.contacts
        and {*after.change.before} - {*hit} == {*before} - {*hit}
        and flight <= FLIGHTS * max(moment.clock, after.clock)
    )


def _change(
    closed: Contacts,
    switches: Sequence[tuple[int, Kind]],
    event: tuple[int, int],
    epoch: int,
    since: int,
) -> ContactChange:
    """Returns the change by ``switches`` at ``event`` (stamp, sequence) with ``closed`` closed."""
    stamp, sequence = event
    t, flown = Elapsed(stamp - epoch), seconds_between(since or stamp, stamp)
    return ContactChange.of(t, closed, switches, stamp=stamp, sequence=sequence, flown=flown)
