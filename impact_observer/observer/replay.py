# SPDX-License-Identifier: Apache-2.0
"""A whole recording through an observer."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby
from operator import attrgetter
from typing import TypeAlias, TypeVar

import numpy as np

from impact_observer.errors import DynamicsError
from impact_observer.events import DECIDING, ImpactEstimate, ImpactEvent, Ruling, Verdict
from impact_observer.observer.observer import Observer
from impact_observer.observer.samples import SensorSample
from impact_observer.observer.sender_runs import in_order
from impact_observer.stamps import MAX_STAMP, whole_stamps
from impact_observer.states import Estimate, Estimates, Stamps

_Item = TypeVar("_Item", bound=Estimates | Verdict)
_BATCH = 4096
"""Most estimates that are made together."""


def replay(
    observer: Observer, events: Sequence[ImpactEvent], stamps: Stamps
) -> Iterator[Estimate | Verdict]:
    """Verdicts, and estimates at ``stamps``, each after all events up to the stamp.

    Args:
        observer: an observer that has received no event.
        events: in order of reception, or as ``sender_runs.in_order`` has them.
        stamps: ns, ascending, shape (samples,); those before the first estimate are skipped.

    Raises:
        ImpactLawError, UsageError: as ``Observer.receive``.
    """
    for item in replay_batches(observer, events, stamps):
        yield from item if isinstance(item, Estimates) else [item]


def replay_batches(
    observer: Observer,
    events: Sequence[ImpactEvent],
    stamps: Stamps,
    *,
    replicas: bool = False,
    rejects: bool = False,
    samples: Sequence[SensorSample] = (),
) -> Iterator[Estimates | Verdict]:
    """``replay`` with the estimates between two events in batches.

    See ``Observer.estimates`` for ``replicas``. An event to which the law has no solution is an
    error; with ``rejects`` the event is rejected, as by a node, and the error is raised only if no
    event was applied. Verdicts on the ``samples`` of sensors, in order of stamps, are in
    ``observer.samples``.
    """
    stamps = whole_stamps(stamps)
    errors: list[DynamicsError] | None = [] if rejects else None
    pending, waiting = [*_pending(events)][::-1], [*samples][::-1]
    while stamps.size or pending:
        while pending and (not stamps.size or _due(*pending[-1], observer) <= stamps[0]):
            yield from _measured(observer, waiting, pending[-1][1].stamp)
            yield from _received(observer, pending.pop()[1], errors)
        if not stamps.size:
            break
        yield from _measured(observer, waiting, int(stamps[0]) + 1)
        until = [stamps.size, _BATCH]
        if pending:
            until.append(int(np.searchsorted(stamps, _due(*pending[-1], observer))))
        if waiting:
            until.append(int(np.searchsorted(stamps, waiting[-1].stamp)))
        here, stamps = stamps[: min(until)], stamps[min(until) :]
        if observer.start is not None:
            known = here[np.searchsorted(here, observer.start) :]
            yield from observer.estimates(known, replicas=replicas)
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
    observer: Observer, event: ImpactEvent, errors: list[DynamicsError] | None
) -> Sequence[Verdict]:
    """The verdicts on an event; an error of the law is noted in ``errors``, if given."""
    try:
        return observer.receive(event)
    except DynamicsError as error:
        if errors is None:
            raise
        errors.append(error)
        return (Verdict(event.stamp, Ruling.REJECTED, event.sequence, reason=str(error)),)


def _pending(events: Iterable[ImpactEvent]) -> Iterator[tuple[int, ImpactEvent]]:
    """The events in order, each with the stamp from which estimates need it, ns.

    The lowest number of a run comes first, as it tells when the initial state holds.
    """
    for _, members in groupby(in_order(events), key=attrgetter("epoch", "episode")):
        run = [*members]
        first = min(run, key=attrgetter("sequence"))
        yield run[0].stamp, first
        yield from ((each.stamp, each) for each in run if each is not first)


def _due(stamp: int, event: ImpactEvent, observer: Observer) -> int:
    """The stamp from which an event matters, ns: that given, or a new epoch."""
    epoch = observer.epoch
    known = not event.epoch or event.epoch == epoch
    if observer.encoders is not None:  # an earlier epoch changes nothing
        known = not epoch or event.epoch <= epoch
    return stamp if known else min(stamp, event.epoch)
