"""A whole recording through an observer."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from impact_observer.events import ImpactEvent, Verdict
from impact_observer.observer.observer import Observer
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Estimate, Estimates, Stamps

MOST = 4096
"""Estimates that are made together."""

_DISORDER = NS_PER_S
"""By which stamps may disagree with the order of sending and still be fed in that order, ns: more
than a sensor's jitter, less than any history, so that nothing comes too late by it."""


def replay(
    observer: Observer, events: Sequence[ImpactEvent], stamps: Stamps
) -> Iterator[Estimate | Verdict]:
    """Estimates at ``stamps``, each after all events at or before it, with all verdicts.

    Events are fed in the order of their stamps, but of their numbers where these disagree: so a
    verdict says of a stamp that is off what it would say live, and names no gap that is none.

    Args:
        observer: has seen nothing yet.
        events: in order of episode, stamp and sequence.
        stamps: where to estimate, ns, ascending, shape (samples,). Those before the observer
            can know anything are passed over.

    Yields:
        Verdicts and estimates, in the order in which they come about.

    Raises:
        ImpactLawError, UsageError: as ``Observer.receive``.
    """
    for item in replay_batches(observer, events, stamps):
        if isinstance(item, Estimates):
            yield from item
        else:
            yield item


def replay_batches(
    observer: Observer, events: Sequence[ImpactEvent], stamps: Stamps
) -> Iterator[Estimates | Verdict]:
    """``replay`` with the estimates between two events together, at most ``MOST`` of them."""
    pending = _as_sent(events)[::-1]
    while stamps.size:
        while pending and _due(pending[-1], observer) <= stamps[0]:
            yield from observer.receive(pending.pop().event)
        end = min(stamps.size, MOST)
        if pending:
            end = min(int(np.searchsorted(stamps, _due(pending[-1], observer))), end)
        here, stamps = stamps[:end], stamps[end:]
        if observer.start is not None:
            yield from observer.estimates(here[np.searchsorted(here, observer.start) :])
    while pending:
        yield from observer.receive(pending.pop().event)


class _Sent(NamedTuple):
    """An event of a recording.

    Attributes:
        event: the event.
        needed: stamp from which on it must be known: its own, or that of one sent after it, ns.
    """

    event: ImpactEvent
    needed: int


def _as_sent(events: Sequence[ImpactEvent]) -> list[_Sent]:
    """By number where stamps disagree: nothing is missing that comes in the next message."""
    ordered: list[ImpactEvent] = []
    for event in events:
        at = len(ordered)
        while at and _was_sent_before(event, ordered[at - 1]):
            at -= 1
        ordered.insert(at, event)
    sent: list[_Sent] = []
    for event in reversed(ordered):
        needed = event.stamp
        if sent and _is_of_run(event, sent[-1].event):
            needed = min(needed, sent[-1].needed)
        sent.append(_Sent(event, needed))
    return sent[::-1]


def _was_sent_before(event: ImpactEvent, other: ImpactEvent) -> bool:
    """Whether ``event``, which is stamped later, was sent before ``other``."""
    near = event.stamp - other.stamp <= _DISORDER
    return near and _is_of_run(event, other) and 0 < event.sequence < other.sequence


def _is_of_run(event: ImpactEvent, other: ImpactEvent) -> bool:
    return (event.episode, event.epoch) == (other.episode, other.epoch)


def _due(sent: _Sent, observer: Observer) -> int:
    """From which stamp on an event bears on the state, ns: by its instant, or by a new epoch."""
    epoch = sent.event.epoch
    return sent.needed if epoch == observer.epoch else min(sent.needed, epoch)
