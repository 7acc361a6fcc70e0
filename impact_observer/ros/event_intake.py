# SPDX-License-Identifier: Apache-2.0
"""Gives the events that a node receives to its observer, a few milliseconds of work at a time."""

import math
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from typing import Any, NamedTuple, TypeAlias

from impact_observer.events import REVISED, ImpactEvent, Ruling, Verdict
from impact_observer.io.messages import AnyMessage, MessageError, MessageLimits, read_event
from impact_observer.observer import Observer
from impact_observer.ros.ahead_of_clock import AheadOfClock
from impact_observer.ros.flood import FloodRule
from impact_observer.stamps import NS_PER_S

MOST_WAITING = 2000
"""Events that wait to be applied, and as many that wait for the clock: the depth of the topic."""
PATIENCE = 30 * NS_PER_S
"""How long an event may wait for an observer that cannot keep up, ns."""
_SLICE = 5_000_000
"""How long events are applied before estimates, timers and services have their turn, ns."""
_FIRST_BATCH = 8
"""Size of the first batch of events."""
_QUICK = NS_PER_S // 2
"""The next batch is larger if this one took less time, ns."""
_BEHIND = 0.5
"""How long an event waits, or after one was shed, until the observer counts as behind, s."""
_CALM, _HELD = NS_PER_S // 4, 2 * NS_PER_S
"""Time after the last event was shed until others are applied; how long one is held so, ns."""
_END: Any = object()
"""Stands for the end of a batch."""
Judged: TypeAlias = tuple[ImpactEvent, tuple[Verdict, ...]]
"""An event and the verdicts on its switches."""


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
    """Takes messages of events, and applies the events to an observer.

    - Events that wait together are given to the observer in one batch, so that late events cost
      one run of the observer. A quick batch doubles the size of the next one, a slow batch halves
      the size.
    - An event that has waited for longer than ``PATIENCE`` is rejected, so that an observer that
      cannot keep up does not fall behind further and further.
    - Events that are too many for the observer to apply are shed (``FloodRule``).
    - An event that is too far ahead of the clock is rejected, and applied once the clock is near:
      perhaps the clock is late.

    Attributes:
        counts: ``future``: events ahead of the clock; ``invalid``: messages without a valid
            event; ``overflow``: events without room; ``waited``: events that waited too long;
            ``shed``: events of a flood.
    """

    def __init__(
        self,
        observer: Observer,
        now: Callable[[], int],
        future: int,
        limits: MessageLimits,
        counts: Counter[str],
    ) -> None:
        """Apply events to ``observer`` that are at most ``future`` (ns) ahead of ``now()`` (ns).

        Args:
            observer: takes the events.
            now: time of the node's clock, ns; 0 while there is none.
            future: how far ahead of the clock a stamp may be, ns.
            limits: of the messages.
            counts: counter to add to.
        """
        self._observer = observer
        self._now, self._future = now, future
        self._limits = limits
        self.counts = counts
        self._waiting: deque[WaitingEvent] = deque()
        self._batch: list[WaitingEvent] = []
        self._batch_size, self._begun = _FIRST_BATCH, 0
        self._batch_work, self._batch_begun_with = 0, 1
        self._flood, self._is_flooded = FloodRule(), False
        self._shed_at = self._held_at = -math.inf
        self._ahead = AheadOfClock[ImpactEvent](MOST_WAITING)
        self._refused: deque[Judged] = deque()
        self._applied: deque[ImpactEvent] = deque(maxlen=MOST_WAITING)
        self._work: Iterator[Judged | None] | None = None

    @property
    def is_busy(self) -> bool:
        """Whether ``apply_waiting`` has work that does not depend on the clock."""
        waits = self._waiting and not self._holds
        return bool(self._work is not None or waits or self._refused)

    @property
    def is_empty(self) -> bool:
        """Whether no event is kept, not even one ahead of the clock."""
        return not (self.is_busy or self._waiting or self._ahead)

    @property
    def _holds(self) -> bool:
        """Whether what waits is held for a moment, as it may be of a flood that goes on."""
        now = time.monotonic_ns()
        since = self._waiting[0].since if self._waiting else now
        return now - self._held_at < _CALM and now - since < _HELD

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
        """Whether an event has waited for long, or has just been shed."""
        recent = (time.monotonic_ns() - self._shed_at) / NS_PER_S < _BEHIND
        return recent or self.backlog()[1] > _BEHIND

    def take_message(self, message: AnyMessage) -> str:
        """Keep the event of an ``ImpactEvent`` message for the next slice of work.

        Returns:
            Why the message cannot be used; empty if the event is kept.
        """
        try:
            event = read_event(message, self._limits)
        except MessageError as error:
            self.counts["invalid"] += 1
            return str(error)
        self._flood.note_event(event.stamp, self._now(), time.monotonic_ns())
        if self._flood.sheds(event.stamp):
            self._note_shed([event])
        elif reason := self._reason_to_wait(event):
            self.counts["future"] += 1
            self._refuse(event, reason)
            if self._ahead.keep(max(event.stamp, event.epoch), event) is not None:
                self.counts["overflow"] += 1
        elif len(self._waiting) < MOST_WAITING:
            self._waiting.append(WaitingEvent(event, time.monotonic_ns(), was_ahead=False))
            self._look_for_floods()
        else:
            self.counts["overflow"] += 1
        return ""

    def clear(self) -> None:
        """Forget all events that wait, as after a jump of the clock."""
        self._waiting.clear()
        self._ahead.clear()
        self._applied.clear()
        self._flood = FloodRule()
        self._work = None

    def finish(self) -> Iterator[Judged]:
        """Finish the batch that is begun, so that the observer may be changed otherwise."""
        if self._work is not None:
            yield from (self._finished(*item) for item in self._work if item is not None)
            self._work = None

    def apply_waiting(self) -> Iterator[Judged]:
        """Apply events for some milliseconds; yields each event with its verdicts."""
        end = time.monotonic_ns() + _SLICE
        self._take_what_was_ahead()
        self._refuse_what_waited()
        while self._refused:
            yield self._refused.popleft()
        while time.monotonic_ns() < end:
            if self._work is None:
                self._withdraw()
                if not self._waiting or self._holds:
                    return
                self._work = self._timed(self._begin_batch())
            for item in self._work:
                if item is not None:
                    yield self._finished(*item)
                if self._is_flooded:
                    break
                if time.monotonic_ns() >= end:
                    return
            if self._is_flooded:
                self._abandon_batch()
                self._withdraw()
                return
            self._work = None
            self._flood.note_cost(self._batch_work // self._batch_begun_with)
            quick = time.monotonic_ns() - self._begun < _QUICK
            size = 2 * self._batch_size if quick else self._batch_size // 2
            self._batch_size = min(max(size, 1), MOST_WAITING)

    def _begin_batch(self) -> Iterator[Judged | None]:
        """Give a batch to the observer."""
        self._begun = time.monotonic_ns()
        count = min(self._batch_size, len(self._waiting))
        self._batch = [self._waiting.popleft() for _ in range(count)]
        self._batch_work, self._batch_begun_with = 0, count
        return self._observer.receiving([each.event for each in self._batch])

    def _timed(self, work: Iterator[Judged | None]) -> Iterator[Judged | None]:
        """The steps of a batch; looks for floods after each."""
        while True:
            begin = time.monotonic_ns()
            item = next(work, _END)
            self._batch_work += time.monotonic_ns() - begin
            if item is _END:
                return
            self._look_for_floods()
            yield item

    def _look_for_floods(self) -> None:
        """Shed what waits of periods that have just become flooded."""
        batch = len(self._batch) if self._work is not None else 0
        cost = self._batch_work // self._batch_begun_with
        if self._flood.looks_for_floods(batch + len(self._waiting), cost):
            self._waiting = self._shed_of(self._waiting)
            flooded = chain((each.event for each in self._batch), self._applied)
            self._is_flooded = any(self._flood.is_dense(each.stamp) for each in flooded) or any(
                self._flood.sheds(each.event.stamp) for each in self._batch
            )

    def _note_shed(self, events: Iterable[ImpactEvent]) -> None:
        """Count events that are shed; what waits beside those of a flooded period is held."""
        for event in events:
            self.counts["shed"] += 1
            self._shed_at = time.monotonic_ns()
            if self._flood.is_dense(event.stamp):
                self._held_at = self._shed_at

    def _shed_of(self, waiting: Iterable[WaitingEvent]) -> deque[WaitingEvent]:
        """Shed the flooded ones of ``waiting`` events, and return the others."""
        kept, shed = deque[WaitingEvent](), list[ImpactEvent]()
        for each in waiting:
            if self._flood.sheds(each.event.stamp):
                shed.append(each.event)
            else:
                kept.append(each)
        self._note_shed(shed)
        return kept

    def _abandon_batch(self) -> None:
        """Let the events of a batch wait again that are not applied, and shed flooded ones."""
        self._work = None
        self._waiting.extendleft(reversed(self._shed_of(self._batch)))

    def _withdraw(self) -> None:
        """Withdraw the events of flooded periods that have been applied."""
        if not self._is_flooded:
            return
        self._is_flooded = False
        flooded = [each for each in self._applied if self._flood.is_dense(each.stamp)]
        if not flooded:
            return
        self._observer.withdraw(self._flood.is_dense)
        self._applied = deque(
            (each for each in self._applied if not self._flood.is_dense(each.stamp)), MOST_WAITING
        )
        self._note_shed(flooded)
        for event in flooded:
            self._refuse(event, f"{REVISED}of a flood", revises=True)

    def _finished(self, event: ImpactEvent, verdicts: tuple[Verdict, ...]) -> Judged:
        """Remove an applied event from the batch.

        The verdict on an event that was ahead of the clock says that it revises an earlier one.
        """
        self._applied.append(event)
        for i, each in enumerate(self._batch):
            if each.event is event:
                del self._batch[i]
                if each.was_ahead:
                    first, *others = verdicts
                    reason = f"{REVISED}{first.reason or 'as reported'}"
                    verdicts = (first._replace(reason=reason), *others)
                break
        return event, verdicts

    def _refuse_what_waited(self) -> None:
        """Refuse the events that have waited for too long."""
        latest = time.monotonic_ns() - PATIENCE
        while self._waiting and self._waiting[0].since < latest:
            self.counts["waited"] += 1
            limit = f"waited for more than {PATIENCE // NS_PER_S} s"
            self._refuse(self._waiting.popleft().event, f"{limit}: the observer cannot keep up")

    def _refuse(self, event: ImpactEvent, reason: str, *, revises: bool = False) -> None:
        """Keep a rejection, to be returned by the next slice of work."""
        verdict = Verdict(
            event.stamp, Ruling.REJECTED, event.sequence, reason=reason, revises=revises
        )
        self._refused.append((event, (verdict,)))

    def _take_what_was_ahead(self) -> None:
        """Let the events wait to be applied to which the clock has come near."""
        latest = self._now() + self._future if self._ahead else 0
        while len(self._waiting) < MOST_WAITING:
            if (event := self._ahead.take_next(latest)) is None:
                return
            if self._flood.sheds(event.stamp):
                self._note_shed([event])
                continue
            self._waiting.append(WaitingEvent(event, time.monotonic_ns(), was_ahead=True))

    def _reason_to_wait(self, event: ImpactEvent) -> str:
        """Why an event is too far ahead of the clock; empty if the event is not."""
        now = self._now()
        if not now:
            return "no /clock has come, by which to judge its stamp; it is taken then"
        if (ahead := max(event.stamp, event.epoch) - now) <= self._future:
            return ""
        what = "stamped" if event.stamp - now > self._future else "its epoch is"
        most = self._future / NS_PER_S
        return f"{what} {ahead / NS_PER_S:.3f} s after the clock; future allows {most:g} s"
