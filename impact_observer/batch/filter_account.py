# SPDX-License-Identifier: Apache-2.0
"""The moments of a recording by a filter: the decisions of the likeliest hypothesis at the end.

The observer runs through the recording first. A hypothesis keeps its latest decisions only; those
on older events are the ones of the last hypothesis that still had them.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from impact_observer.bank.notes import Note
from impact_observer.events import Contacts, ImpactEvent, Kind, Ruling
from impact_observer.observer import Observer, replay_batches
from impact_observer.observer.belief import Belief
from impact_observer.observer.contact_change import ContactChange
from impact_observer.observer.laws.minimum_variance import MinimumVariance
from impact_observer.stamps import Elapsed, seconds_between

_SETTLED = 16
"""Events after which a hypothesis has learned the error of the clock at an event."""
_FLIGHTS = 8.0
"""Longest flight of a chattering sequence that is left out, in deviations of stamps."""


class FilterMoment(NamedTuple):
    """An instant at which contacts switch, by a filter.

    Attributes:
        change: the change of the contacts, at the reported stamp.
        is_measured: whether the moment has a stamp; else it is a missed detection.
        clock: standard deviation of the stamp, s.
    """

    change: ContactChange
    is_measured: bool
    clock: float


class _Trace(NamedTuple):
    """A reported change, and notes and clock error of the likeliest hypothesis just after it."""

    change: ContactChange
    notes: tuple[Note, ...]
    clock: float


class TracedLaw(MinimumVariance):
    """The law of least variance that keeps its decisions after each event.

    Attributes:
        traces: by stamp and sequence number of the event.
    """

    traces: dict[tuple[int, int], _Trace]

    def correct(self, change: ContactChange, belief: Belief) -> Belief:
        """As the law does."""
        posterior = super().correct(change, belief)
        trace = _Trace(change, posterior.noted, posterior.clock_deviation)
        self.traces[change.stamp, change.sequence] = trace
        return posterior


def filter_moments(
    observer: Observer, events: Sequence[ImpactEvent], progress: Callable[[int], None]
) -> Iterator[FilterMoment]:
    """True and inserted moments by an observer of ``TracedLaw`` that has received no event yet.

    The end of a chattering sequence is one moment that closes the contact.

    Args:
        observer: with unknown parameters, if there are any.
        events: of one run of the sender.
        progress: called with the number of events done.

    Raises:
        ImpactLawError, UsageError: as ``Observer.receive``.
    """
    law = observer.law
    assert isinstance(law, TracedLaw), "as it was made"
    law.traces = {}
    nothing = np.empty(0, dtype=np.int64)
    for _ in replay_batches(observer, events, nothing, rejects=True):
        progress(len(law.traces))
    decided = dict[tuple[int, int], list[Note]]()
    for _, trace in sorted(law.traces.items()):
        of_trace = dict[tuple[int, int], list[Note]]()
        for note in trace.notes:
            of_trace.setdefault(note.event, []).append(note)
        decided |= of_trace
    epoch = observer.epoch or min(each.stamp for each in events)
    yield from _without_chatter([*_decided(law.traces, decided, epoch)])


def _decided(
    traces: Mapping[tuple[int, int], _Trace],
    decided: Mapping[tuple[int, int], Sequence[Note]],
    epoch: int,
) -> Iterator[FilterMoment]:
    """Yield the moments of the decisions on each event, in order; contacts are open at first."""
    closed: Contacts = ()
    keys = sorted(traces)
    for k, key in enumerate(keys):
        trace, notes = traces[key], decided.get(key, ())
        clock = traces[keys[min(k + _SETTLED, len(keys) - 1)]].clock
        own = [note for note in notes if not note.is_inserted]
        switched = {note.contact: note.switched for note in own}
        made = [
            ((note.stamp, 0), [(note.switched, Kind.IMPACT)], False)
            for note in notes
            if note.is_inserted
        ]
        if not own or own[0].ruling is Ruling.APPLIED:
            switches = [(switched.get(i, i), kind) for i, kind in trace.change.switches]
            made.append((key, switches, True))
        for (stamp, sequence), switches, is_measured in made:
            t = Elapsed(stamp - epoch)
            change = ContactChange.of(t, closed, switches, stamp=stamp, sequence=sequence)
            if not change.is_nothing:
                yield FilterMoment(change, is_measured, clock)
                closed = change.closed


def _without_chatter(moments: Sequence[FilterMoment]) -> Iterator[FilterMoment]:
    """Yield the moments, with the end of a chattering sequence as one that closes the contact.

    The flights of that end are as short as the errors of stamps: order and number of its impacts
    say no more than the first impact.
    """
    k = 0
    while k < len(moments):
        first, end = moments[k], k + 1
        while end < len(moments) and _chatters(moments[end - 1], moments[end]):
            end += 1
        change, closed = first.change, moments[end - 1].change.closed
        if end > k + 1 and closed != change.before:
            change = change._replace(closed=closed)
        else:
            end = k + 1
        yield first._replace(change=change)
        k = end


def _chatters(moment: FilterMoment, after: FilterMoment) -> bool:
    """Return whether the same contact hits again within the errors of the stamps."""
    flight = seconds_between(moment.change.stamp, after.change.stamp)
    hit, before = moment.change.hit, moment.change.before
    return (
        len(hit) == 1
        and hit == after.change.hit == after.change.contacts
        and {*after.change.before} - {*hit} == {*before} - {*hit}
        and flight <= _FLIGHTS * max(moment.clock, after.clock)
    )
