# SPDX-License-Identifier: Apache-2.0
"""Gives the events that a node receives to its observer, a few milliseconds of work at a time."""

import time
from collections import Counter, deque
from collections.abc import Iterator
from itertools import chain, islice
from typing import NamedTuple

from impact_observer.events import REVISED, ImpactEvent, Ruling, Verdict
from impact_observer.observer import Observer
from impact_observer.observer.verdicts import Judged
from impact_observer.stamps import NS_PER_S

MOST_WAITING = 2000
"""Events that wait to be applied: the depth of the topic."""
PATIENCE = 30 * NS_PER_S
"""How long an event may wait for an observer that cannot keep up, ns."""
_SLICE = 5_000_000
"""How long events are applied before estimates, timers and services have their turn, ns."""
_BEHIND = 0.5
"""How long an event waits until the observer counts as behind, s."""


class WaitingEvent(NamedTuple):
    """An event that waits to be applied.

    Attributes:
        event: the event.
        since: when the event came, on the monotonic clock, ns.
        was_ahead: whether the event was ahead of the clock, and was rejected before.
    """

    event: ImpactEvent
    since: int
    was_ahead: bool


class EventIntake:
    """Takes events, and applies them to an observer.

    - Events that wait together are given to the observer in one batch, so that late events cost
      one run of the observer.
    - An event that has waited for longer than ``PATIENCE`` is rejected, so that an observer that
      cannot keep up does not fall behind further and further.
    - Where ``MOST_WAITING`` events wait and another one comes, every second one is dropped, and of
      those that come every second one, until the observer takes the others. So these are in the
      order in which they came, and evenly spread.

    Attributes:
        counts: ``dropped`` events, and those that ``waited too long``.
    """

    def __init__(self, observer: Observer, counts: Counter[str]) -> None:
        """Apply events to ``observer``, and add to ``counts``."""
        self._observer = observer
        self.counts = counts
        self._waiting: deque[WaitingEvent] = deque()
        self._come, self._stride = 0, 1
        self._batch: list[WaitingEvent] = []
        self._refused: deque[Judged] = deque()
        self._work: Iterator[list[Judged]] | None = None

    @property
    def is_busy(self) -> bool:
        """Whether ``apply_waiting`` has work."""
        return bool(self._work is not None or self._waiting or self._refused)

    def backlog(self) -> tuple[int, float]:
        """Number of events that are not applied yet, and waiting time of the oldest, s."""
        batch = self._batch if self._work is not None else []
        oldest = next(chain(batch, self._waiting), None)
        if oldest is None:
            return 0, 0.0
        waited = (time.monotonic_ns() - oldest.since) / NS_PER_S
        return len(batch) + len(self._waiting), waited

    @property
    def is_behind(self) -> bool:
        """Whether an event has waited for long."""
        return self.backlog()[1] > _BEHIND

    def take(self, event: ImpactEvent, *, was_ahead: bool = False) -> None:
        """Let an event wait for the next slice of work; where too many wait, thin them evenly.

        Args:
            event: the event.
            was_ahead: whether the event was rejected before, as it was ahead of the clock.
        """
        if len(self._waiting) >= MOST_WAITING:
            kept = deque(islice(self._waiting, 0, None, 2))
            self.counts["dropped"] += len(self._waiting) - len(kept)
            self._waiting = kept
            self._stride *= 2
        self._come += 1
        if self._come % self._stride:
            self.counts["dropped"] += 1
        else:
            self._waiting.append(WaitingEvent(event, time.monotonic_ns(), was_ahead))

    def clear(self) -> None:
        """Forget all events that wait, as after a jump of the clock."""
        self._waiting.clear()
        self._work = None

    def finish(self) -> Iterator[Judged]:
        """Finish the batch that is begun, so that the observer may be changed otherwise."""
        if self._work is not None:
            yield from (self._finished(*each) for each in chain.from_iterable(self._work))
            self._work = None

    def apply_waiting(self) -> Iterator[Judged]:
        """Apply events for some milliseconds; yields each event with its verdicts."""
        end = time.monotonic_ns() + _SLICE
        self._refuse_what_waited()
        while self._refused:
            yield self._refused.popleft()
        while time.monotonic_ns() < end:
            if self._work is None:
                if not self._waiting:
                    return
                self._work = self._begin_batch()
            for together in self._work:
                yield from [self._finished(*each) for each in together]
                if time.monotonic_ns() >= end:
                    return
            self._work = None

    def _begin_batch(self) -> Iterator[list[Judged]]:
        """Give all events that wait to the observer."""
        self._batch = [*self._waiting]
        self._waiting.clear()
        self._stride = 1
        return self._observer.receiving([each.event for each in self._batch])

    def _finished(self, event: ImpactEvent, verdicts: tuple[Verdict, ...]) -> Judged:
        """Remove an applied event from the batch.

        The verdict on an event that was ahead of the clock says that it revises an earlier one.
        """
        (place,) = (k for k, each in enumerate(self._batch) if each.event is event)
        if self._batch.pop(place).was_ahead:
            first, *others = verdicts
            reason = f"{REVISED}{first.reason or 'as reported'}"
            verdicts = (first._replace(reason=reason), *others)
        return event, verdicts

    def _refuse_what_waited(self) -> None:
        """Refuse the events that have waited for too long, also of the batch."""
        latest = time.monotonic_ns() - PATIENCE
        if self._work is not None and self._batch and self._batch[0].since < latest:
            self._work = None
            self._waiting.extendleft(reversed(self._batch))
        while self._waiting and self._waiting[0].since < latest:
            self.counts["waited too long"] += 1
            limit = f"waited for more than {PATIENCE // NS_PER_S} s"
            self.reject(self._waiting.popleft().event, f"{limit}: the observer cannot keep up")

    def reject(self, event: ImpactEvent, reason: str) -> None:
        """Keep the rejection of an event, to be returned by the next slice of work."""
        verdict = Verdict(event.stamp, Ruling.REJECTED, event.sequence, reason=reason)
        self._refused.append((event, (verdict,)))
