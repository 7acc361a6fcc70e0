"""A whole recording through an observer."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from impact_observer.events import ImpactEvent, Verdict
from impact_observer.observer.observer import Observer
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Estimate, Estimates, Stamps

_BATCH = 4096
"""Most estimates that are made together."""

_DISORDER = NS_PER_S
"""Largest difference of stamps against sequence numbers that is put in order, ns: more than the
jitter of a sensor, less than any history, so that no event becomes too late by it."""


def replay(
    observer: Observer, events: Sequence[ImpactEvent], stamps: Stamps
) -> Iterator[Estimate | Verdict]:
    """Verdicts, and estimates at ``stamps``, each after all events at or before it.

    Events are received in the order of their stamps, but of their numbers where these disagree. So
    a verdict says the same of a misplaced stamp as it does live, and reports only real gaps.

    Args:
        observer: has received nothing yet.
        events: in order of episode, stamp and sequence.
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
    only_states: bool = False,
) -> Iterator[Estimates | Verdict]:
    """``replay`` with the estimates between two events in batches.

    See ``Observer.estimates`` for ``only_states``.
    """
    pending = _in_order_of_sending(events)[::-1]
    while stamps.size:
        while pending and _due(pending[-1], observer) <= stamps[0]:
            yield from observer.receive(pending.pop().event)
        end = min(stamps.size, _BATCH)
        if pending:
            end = min(int(np.searchsorted(stamps, _due(pending[-1], observer))), end)
        here, stamps = stamps[:end], stamps[end:]
        if observer.start is not None:
            known = here[np.searchsorted(here, observer.start) :]
            yield from observer.estimates(known, only_states=only_states)
    while pending:
        yield from observer.receive(pending.pop().event)


class _Pending(NamedTuple):
    """An event of a recording.

    Attributes:
        event: the event.
        needed: stamp of the first estimate that needs it, ns: its own, or that of an event which
            was sent after it.
    """

    event: ImpactEvent
    needed: int


def _in_order_of_sending(events: Sequence[ImpactEvent]) -> list[_Pending]:
    """``events`` by stamp, and by sequence number where stamps disagree."""
    ordered: list[ImpactEvent] = []
    for event in events:
        at = len(ordered)
        while at and _was_sent_before(event, ordered[at - 1]):
            at -= 1
        ordered.insert(at, event)
    pending: list[_Pending] = []
    for event in reversed(ordered):
        needed = event.stamp
        if pending and _is_same_run(event, pending[-1].event):
            needed = min(needed, pending[-1].needed)
        pending.append(_Pending(event, needed))
    return pending[::-1]


def _was_sent_before(event: ImpactEvent, other: ImpactEvent) -> bool:
    near = event.stamp - other.stamp <= _DISORDER
    return near and _is_same_run(event, other) and 0 < event.sequence < other.sequence


def _is_same_run(event: ImpactEvent, other: ImpactEvent) -> bool:
    return (event.episode, event.epoch) == (other.episode, other.epoch)


def _due(pending: _Pending, observer: Observer) -> int:
    """From which stamp on an event matters, ns: its own, or that of its new epoch."""
    epoch = pending.event.epoch
    return pending.needed if epoch == observer.epoch else min(pending.needed, epoch)
