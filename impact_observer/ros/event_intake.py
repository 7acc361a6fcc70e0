# SPDX-License-Identifier: Apache-2.0
"""How an observer node takes in events: in slices of time, so that estimates go on meanwhile."""

import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from itertools import chain
from typing import NamedTuple

from impact_observer.events import REVISED, ImpactEvent, Ruling, Verdict
from impact_observer.io.messages import MessageError, MessageLimits
from impact_observer.observer import Observer
from impact_observer.ros.serialized import read_impact
from impact_observer.ros.subscribing import SLICE, Ahead
from impact_observer.stamps import NS_PER_S

MOST_WAITING = 2000
"""Events that wait to be applied, and as many that wait for the clock: the depth of the topic."""
PATIENCE = 30 * NS_PER_S
"""How long an event may wait for an observer that cannot keep up, ns."""
_FEW = 8
"""Events that are given to the observer together at first."""
_QUICK = NS_PER_S // 2
"""How long a batch may take for the next one to be larger, ns."""


class Waiting(NamedTuple):
    """An event that waits to be applied.

    Attributes:
        event: it.
        since: when it came, on the monotonic clock, ns.
        was_refused: whether it was ahead of the clock and has a verdict already.
    """

    event: ImpactEvent
    since: int
    was_refused: bool


class EventIntake:
    """Takes serialized events, and applies them in slices of time.

    Events that wait together are given to the observer together, so that late ones cost one run.
    Such a batch is twice as large after a quick one, half as large after a slow one. An event that
    has waited longer than ``PATIENCE`` is rejected, so that an observer that cannot keep up is
    never further behind. What is ahead of the clock is rejected, and taken once the clock has
    come near enough.

    Attributes:
        counts: ``future``: events ahead of the clock; ``invalid``: messages that are no event;
            ``overflow``: events for which there was no room; ``waited``: those that waited for
            too long.
        passed: a stamp that the clock has passed, ns; events up to it are compared with no clock.
    """

    def __init__(
        self,
        observer: Observer,
        now: Callable[[], int],
        future: int,
        limits: MessageLimits,
        counts: Counter[str],
    ) -> None:
        """Apply events to ``observer`` up to ``future`` (ns) ahead of ``now()`` (ns)."""
        self._observer = observer
        self._now, self._future = now, future
        self._limits = limits
        self.counts = counts
        self.passed = 0
        self._waiting: deque[Waiting] = deque()
        self._taken: list[Waiting] = []
        self._batch, self._begun = _FEW, 0
        self._ahead = Ahead[ImpactEvent](MOST_WAITING)
        self._refused: deque[tuple[ImpactEvent, tuple[Verdict, ...]]] = deque()
        self._work: Iterator[tuple[ImpactEvent, tuple[Verdict, ...]] | None] | None = None

    @property
    def room(self) -> int:
        """How many events it takes before the next slice."""
        return MOST_WAITING - len(self._waiting)

    @property
    def is_busy(self) -> bool:
        """Whether there is work for another slice."""
        return bool(self._work is not None or self._waiting or self._refused)

    @property
    def is_empty(self) -> bool:
        """Whether it has no event, not even one ahead of the clock."""
        return not (self.is_busy or self._ahead)

    def backlog(self) -> tuple[int, float]:
        """How many events are not applied yet, and how long the oldest has waited, s."""
        taken = self._taken if self._work is not None else []
        oldest = next(chain(taken, self._waiting), None)
        if oldest is None:
            return 0, 0.0
        since = (time.monotonic_ns() - oldest.since) / NS_PER_S
        return len(taken) + len(self._waiting), since

    def add(self, data: bytes) -> str:
        """Take a serialized event; in words why it cannot be used, empty where it can."""
        try:
            event = read_impact(data, self._limits)
        except MessageError as error:
            self.counts["invalid"] += 1
            return str(error)
        if reason := self._reason_to_wait(event):
            self.counts["future"] += 1
            self._ahead.add(max(event.stamp, event.epoch), event)
            verdict = Verdict(event.stamp, Ruling.REJECTED, event.sequence, reason=reason)
            self._refused.append((event, (verdict,)))
        elif self.room > 0:
            self._waiting.append(Waiting(event, time.monotonic_ns(), was_refused=False))
        else:
            self.counts["overflow"] += 1
        return ""

    def clear(self) -> None:
        """Forget all that waits, as when the clock has jumped back."""
        self.passed = 0
        self._waiting.clear()
        self._ahead.clear()
        self._work = None

    def finish(self) -> Iterator[tuple[ImpactEvent, tuple[Verdict, ...]]]:
        """Finish the work that is begun, so that the observer may be changed otherwise."""
        if self._work is not None:
            yield from (self._finished(*item) for item in self._work if item is not None)
            self._work = None

    def slice(self) -> Iterator[tuple[ImpactEvent, tuple[Verdict, ...]]]:
        """Work for some milliseconds: events with their verdicts, each when it is applied."""
        end = time.monotonic_ns() + SLICE
        if self._ahead:
            self._take_what_was_ahead()
        self._refuse_what_waited()
        while self._refused:
            yield self._refused.popleft()
        while time.monotonic_ns() < end:
            if self._work is None:
                if not self._waiting:
                    return
                self._work = self._begin()
            for item in self._work:
                if item is not None:
                    yield self._finished(*item)
                if time.monotonic_ns() >= end:
                    return
            self._work = None
            is_quick = time.monotonic_ns() - self._begun < _QUICK
            self._batch = min(2 * self._batch, MOST_WAITING) if is_quick else self._batch // 2 or 1

    def _begin(self) -> Iterator[tuple[ImpactEvent, tuple[Verdict, ...]] | None]:
        """Give the observer some of what waits."""
        self._begun = time.monotonic_ns()
        count = min(self._batch, len(self._waiting))
        self._taken = [self._waiting.popleft() for _ in range(count)]
        return self._observer.receiving([each.event for each in self._taken])

    def _finished(
        self, event: ImpactEvent, verdicts: tuple[Verdict, ...]
    ) -> tuple[ImpactEvent, tuple[Verdict, ...]]:
        """Strike an applied event off those that are not.

        The verdicts on one that was ahead of the clock say that they are not the first.
        """
        for i, each in enumerate(self._taken):
            if each.event is event:
                del self._taken[i]
                if each.was_refused:
                    first, *others = verdicts
                    reason = f"{REVISED}{first.reason or 'as reported'}"
                    verdicts = (first._replace(reason=reason), *others)
                break
        return event, verdicts

    def _refuse_what_waited(self) -> None:
        """Refuse the events that have waited for too long."""
        latest = time.monotonic_ns() - PATIENCE
        while self._waiting and self._waiting[0].since < latest:
            event = self._waiting.popleft().event
            self.counts["waited"] += 1
            reason = f"waited for more than {PATIENCE // NS_PER_S} s: the observer cannot keep up"
            verdict = Verdict(event.stamp, Ruling.REJECTED, event.sequence, reason=reason)
            self._refused.append((event, (verdict,)))

    def _take_what_was_ahead(self) -> None:
        latest = self._now() + self._future
        while self.room > 0 and (event := self._ahead.taken(latest)) is not None:
            self._waiting.append(Waiting(event, time.monotonic_ns(), was_refused=True))

    def _reason_to_wait(self, event: ImpactEvent) -> str:
        """Why an event is too far ahead of the clock; empty where it is not."""
        latest = max(event.stamp, event.epoch)
        if latest <= self.passed:
            return ""
        now = self._now()
        if not now:
            return "no /clock has come, by which to judge its stamp; it is taken then"
        if (ahead := latest - now) <= self._future:
            return ""
        what = "stamped" if event.stamp - now > self._future else "its epoch is"
        most = self._future / NS_PER_S
        return f"{what} {ahead / NS_PER_S:.3f} s after the clock; future allows {most:g} s"
