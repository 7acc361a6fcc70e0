# SPDX-License-Identifier: Apache-2.0
"""A whole recording through an observer."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby
from operator import attrgetter
from typing import NamedTuple, TypeAlias, TypeVar

import numpy as np

from impact_observer.errors import DynamicsError
from impact_observer.events import DECIDING, ImpactEstimate, ImpactEvent, Ruling, Verdict
from impact_observer.observer.event_order import NEAR_NUMBERS, NEAR_STAMPS
from impact_observer.observer.observer import Observer
from impact_observer.observer.samples import SensorSample
from impact_observer.observer.sender_runs import Placed, Weighed, placed
from impact_observer.stamps import MAX_STAMP, whole_stamps
from impact_observer.states import Estimate, Estimates, Stamps

_Item = TypeVar("_Item", bound=Estimates | Verdict)
_BATCH = 4096
"""Most estimates that are made together."""


def replay(
    observer: Observer, events: Sequence[ImpactEvent], stamps: Stamps
) -> Iterator[Estimate | Verdict]:
    """Verdicts, and estimates at ``stamps``, each after all events up to the stamp.

    Events are received in the order of their stamps, or of their numbers where stamps disagree. So
    a verdict on a misplaced stamp is the same as live, and reports only real gaps. The run of the
    sender in use follows from the order in which events are given.

    Args:
        observer: an observer that has received no event.
        events: in order of reception, or as ``sender_runs.in_order`` has them.
        stamps: ns, ascending, shape (samples,); those before the first estimate are skipped.

    Raises:
        ImpactLawError, UsageError: as ``Observer.receive``.
    """
    for item in replay_batches(observer, events, stamps):
        if isinstance(item, Estimates):
            yield from item
        else:
            yield item


def replay_batches(
    observer: Observer,
    events: Sequence[ImpactEvent],
    stamps: Stamps,
    *,
    replicas: bool = False,
    rejects: bool = False,
    by_stamps: bool = False,
    samples: Sequence[SensorSample] = (),
) -> Iterator[Estimates | Verdict]:
    """``replay`` with the estimates between two events in batches.

    See ``Observer.estimates`` for ``replicas``. An event to which the law has no solution is an
    error; with ``rejects`` the event is rejected, as by a node, and the error is raised only if no
    event was applied. With ``by_stamps`` no event is late: the replay is faster where stamps
    disagree with numbers, with the same final estimates, but verdicts may report numbers as
    missing. Verdicts on the ``samples`` of sensors, in order of stamps, are in
    ``observer.samples``.
    """
    stamps = whole_stamps(stamps)
    errors: list[DynamicsError] | None = [] if rejects else None
    pending = _in_order_of_sending(placed(events, observer.given_epoch), by_stamps)[::-1]
    waiting = [*samples][::-1]
    while stamps.size:
        while pending and _due(pending[-1], observer) <= stamps[0]:
            yield from _measured(observer, waiting, pending[-1].event.stamp)
            yield from _received(observer, pending.pop(), errors)
        yield from _measured(observer, waiting, int(stamps[0]) + 1)
        end = min(stamps.size, _BATCH)
        if pending:
            end = min(int(np.searchsorted(stamps, _due(pending[-1], observer))), end)
        if waiting:
            end = min(int(np.searchsorted(stamps, waiting[-1].stamp)), end)
        here, stamps = stamps[:end], stamps[end:]
        if observer.start is not None:
            known = here[np.searchsorted(here, observer.start) :]
            yield from observer.estimates(known, replicas=replicas)
    while pending:
        yield from _measured(observer, waiting, pending[-1].event.stamp)
        yield from _received(observer, pending.pop(), errors)
    yield from _measured(observer, waiting, MAX_STAMP)
    if errors and not observer.last_event:
        raise errors[0]


Impacts: TypeAlias = dict[tuple[int, int, str], ImpactEstimate]
"""Estimates of impacts, by the stamp (ns), sequence and contact of their verdicts."""


def noting_impacts(
    items: Iterable[_Item], observer: Observer, impacts: Impacts
) -> Iterator[_Item]:
    """``items`` of a replay of ``observer``; ``impacts`` become those of the verdicts so far."""
    for item in items:
        if isinstance(item, Verdict) and item.ruling in DECIDING:
            key = item.stamp, item.sequence, item.contact
            if item.ruling is Ruling.REJECTED:
                impacts.pop(key, None)
            elif found := observer.impact(item):
                impacts[key] = found
        yield item


def _measured(observer: Observer, waiting: list[SensorSample], before: int) -> Sequence[Verdict]:
    """Verdicts on events that change by the ``waiting`` samples ``before`` a stamp (ns)."""
    due = list[SensorSample]()
    while waiting and waiting[-1].stamp < before:
        due.append(waiting.pop())
    return observer.measure(due) if due else ()


def _received(
    observer: Observer, pending: "_Pending", errors: list[DynamicsError] | None
) -> Sequence[Verdict]:
    """The verdicts on an event; an error of the law is noted in ``errors``, if given."""
    event, why = pending.event, pending.why
    if why.reason:
        return observer.refuse(event, why.reason)
    try:
        return observer.receive(event)
    except DynamicsError as error:
        if errors is None:
            raise
        errors.append(error)
        return (Verdict(event.stamp, Ruling.REJECTED, event.sequence, reason=str(error)),)


class _Pending(NamedTuple):
    """An event of a recording.

    Attributes:
        event: the event.
        needed: stamp from which estimates need the event, ns: the least of its own and of the
            events that were sent later or take effect together.
        why: the decision on the event.
    """

    event: ImpactEvent
    needed: int
    why: Weighed


def _in_order_of_sending(events: Iterable[Placed], by_stamps: bool) -> list[_Pending]:
    """The events by period and stamp, and by sequence number where stamps disagree.

    If ``by_stamps``, only by period and stamp. Events without effect are put in by their stamps.
    """
    every = sorted(events, key=lambda each: (each.period, each.event.stamp, each.event.sequence))
    without = [
        _Pending(each.event, each.event.stamp, each.why) for each in every if each.period < 0
    ]
    pending: list[_Pending] = []
    for _, of_period in groupby(every[len(without) :], key=attrgetter("period")):
        ordered: list[Placed] = []
        for each in of_period:
            at = len(ordered)
            while at and not by_stamps and _was_sent_before(each.event, ordered[at - 1].event):
                at -= 1
            ordered.insert(at, each)
        needed, backwards = MAX_STAMP, list[_Pending]()
        for each in reversed(ordered):
            needed = min(needed, each.event.stamp, each.since)
            backwards.append(_Pending(each.event, needed, each.why))
        pending += backwards[::-1]
    return [*_among(without, pending)]


def _among(some: Sequence[_Pending], others: Sequence[_Pending]) -> Iterator[_Pending]:
    """``some``, in order, each before the first of the ``others`` that is needed later."""
    taken = 0
    for each in others:
        while taken < len(some) and some[taken].needed <= each.needed:
            yield some[taken]
            taken += 1
        yield each
    yield from some[taken:]


def _was_sent_before(event: ImpactEvent, other: ImpactEvent) -> bool:
    near = event.stamp - other.stamp <= NEAR_STAMPS
    return near and 0 < other.sequence - event.sequence <= NEAR_NUMBERS


def _due(pending: _Pending, observer: Observer) -> int:
    """The stamp from which an event matters, ns: its own, or a new epoch."""
    epoch = pending.event.epoch
    known = epoch in {0, observer.epoch} or bool(pending.why.reason)
    if observer.encoders is not None:  # an earlier epoch changes nothing
        known = epoch <= observer.epoch or not observer.epoch
    return pending.needed if known else min(pending.needed, epoch)
