# SPDX-License-Identifier: Apache-2.0
"""Which run of the sender an observer follows: no single message decides (docs/nodes.md).

A run is what a sender publishes from one reset to the next: all events of one epoch and episode.
"""

from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

from impact_observer.events import ImpactEvent, Remark
from impact_observer.observer.event_order import NEAR_NUMBERS
from impact_observer.stamps import NS_PER_S, text

CONFIRMING = 2
"""Events in agreement, one received after the other, with which a later run takes effect."""
RETURNING = 10
"""Events with which an earlier run takes effect again, once a confirmed one has gone silent."""
_MOST_STEP = 3600 * NS_PER_S
"""Largest difference of the stamps of two events that confirm each other, ns.

An event stamped later than all others by more than this must be confirmed, too."""
_MOST_RUNS, _MOST_HELD = 256, 64
"""Runs that are not in use, and events of each, that are kept."""


class SenderRun(NamedTuple):
    """A run of the sender; as a tuple ordered by epoch, then by episode.

    Attributes:
        epoch: stamp of ``t = 0`` of the forcing, ns; 0 while unknown.
        episode: episode of the sender.
    """

    epoch: int
    episode: int

    def is_later_than(self, other: "SenderRun") -> bool:
        """Whether this run has begun after ``other``, by epoch and episode.

        The epoch decides: a plant that is started again counts its episodes from 0.
        """
        if self.epoch and other.epoch and self.epoch != other.epoch:
            return self.epoch > other.epoch
        return self.episode >= other.episode

    def goes_on_as(self, other: "SenderRun") -> bool:
        """Whether ``other`` is the same run, with its epoch known by now."""
        return not self.epoch and self.episode == other.episode


class Weighed(NamedTuple):
    """The decision on an event.

    Attributes:
        reason: why the event has no effect for now; empty for an event of the run in use.
        remark: the remark that counts an event without effect.
        previous: the run in use until now, if the event has brought another run into use.
        released: earlier events of the same run, held until now, in order of reception.
        replaces: whether ``released`` replaces the single event of the run in effect so far.
    """

    reason: str = ""
    remark: Remark = Remark.PAST
    previous: SenderRun | None = None
    released: tuple[ImpactEvent, ...] = ()
    replaces: bool = False


_FOLLOWED = Weighed()


@dataclass(slots=True)
class _Held:
    """Events of a run that is not in use.

    Attributes:
        events: the events kept, in order of reception.
        confirming: the latest events in agreement, without an event of the run in use between.
    """

    events: list[ImpactEvent] = field(default_factory=list)
    confirming: list[ImpactEvent] = field(default_factory=list)


class SenderRuns:
    """The run in use, and the events of others.

    The first event received begins a run. Another run takes effect with ``CONFIRMING`` events in
    agreement. To replace a confirmed run, an earlier run needs ``RETURNING`` events, stamped
    after all events of the run in use.

    Attributes:
        in_use: the run in use; None before the first event.
    """

    def __init__(self, epoch: int = 0) -> None:
        """Follow the run that the first event begins; 0 for an ``epoch`` (ns) not known yet."""
        self.in_use: SenderRun | None = None
        self._epoch = epoch
        self._first: ImpactEvent | None = None
        self._newest = 0
        self._held: OrderedDict[SenderRun, _Held] = OrderedDict()
        self._is_confirmed = self._is_any_confirming = False

    def weigh(self, event: ImpactEvent) -> Weighed:
        """Take the next event received."""
        if self.in_use is None:
            self.in_use, self._first = SenderRun(event.epoch or self._epoch, event.episode), event
            if not self._epoch or self.in_use.epoch == self._epoch:
                self._newest = event.stamp
                return _FOLLOWED
            self.in_use, self._first = SenderRun(self._epoch, event.episode), None
            self._is_confirmed = True  # by the user
        run = SenderRun(event.epoch or self.in_use.epoch, event.episode)
        if run != self.in_use or (event.stamp - self._newest > _MOST_STEP and self._newest):
            return self._hold(run, event)
        self._newest = max(self._newest, event.stamp)
        if not self._is_confirmed:
            is_known = event.epoch or not run.epoch or run.epoch == self._epoch
            self._is_confirmed = bool(is_known) and event != self._first
        if self._is_any_confirming:
            self._is_any_confirming = False
            for each in self._held.values():
                each.confirming.clear()
        return _FOLLOWED

    def _hold(self, run: SenderRun, event: ImpactEvent) -> Weighed:
        """Keep an event of another run, and bring the run into use once confirmed."""
        assert self.in_use is not None, "there was an event"
        held = self._held.setdefault(run, _Held())
        self._held.move_to_end(run)
        if len(self._held) > _MOST_RUNS:
            self._held.popitem(last=False)
        is_later = run.is_later_than(self.in_use)
        if event not in held.events:
            held.events = [*held.events, event][-_MOST_HELD:]
            agrees = not held.confirming or _agree(held.confirming[-1], event)
            counts = is_later or not self._is_confirmed or event.stamp > self._newest
            held.confirming = [*(held.confirming if agrees else ()), *([event] if counts else ())]
            self._is_any_confirming = True
        wanted = RETURNING if self._is_confirmed and not is_later else CONFIRMING
        if len(held.confirming) >= wanted:
            return self._change_to(run, event)
        return Weighed(*self._reason(run, wanted, is_later=is_later))

    def _change_to(self, run: SenderRun, event: ImpactEvent) -> Weighed:
        assert self.in_use is not None, "there was an event"
        previous, held = self.in_use, self._held.pop(run)
        events = [
            each for each in held.events if any(_are_near(each, near) for near in held.confirming)
        ]
        released = tuple(each for each in events if each != event)
        self._newest = max(each.stamp for each in events)
        if previous == run:
            was_confirmed, self._is_confirmed = self._is_confirmed, True
            return Weighed(released=released, replaces=not was_confirmed)
        if not self._is_confirmed and self._first is not None:
            self._held[previous] = _Held([self._first])
        self.in_use, self._first = run, events[0]
        self._is_confirmed = len(events) > 1
        return Weighed(previous=previous, released=released)

    def _reason(self, run: SenderRun, wanted: int, *, is_later: bool) -> tuple[str, Remark]:
        """Why an event of a run has no effect."""
        assert self.in_use is not None, "there was an event"
        needed = f"it takes effect with {wanted} events in agreement"
        if run == self.in_use:
            return f"stamped long after all others: {needed}", Remark.UNCONFIRMED
        is_other_epoch = run.epoch != self.in_use.epoch
        name = f"epoch {text(run.epoch)} s" if is_other_epoch else f"episode {run.episode}"
        if is_later:
            return f"{name} is new: {needed}", Remark.UNCONFIRMED
        if is_other_epoch:
            used = f"the one in use, {text(self.in_use.epoch)} s"
            return f"its epoch {text(run.epoch)} s is before {used}", Remark.PAST
        return f"{name} is over", Remark.PAST


def _agree(one: ImpactEvent, other: ImpactEvent) -> bool:
    """Whether two events of a run are as near as two events of a sender are."""
    if bool(one.sequence) != bool(other.sequence):
        return False
    if one.sequence and not 0 < abs(one.sequence - other.sequence) <= NEAR_NUMBERS:
        return False
    return _are_near(one, other)


def _are_near(one: ImpactEvent, other: ImpactEvent) -> bool:
    """Whether two events are stamped within an hour."""
    return abs(one.stamp - other.stamp) <= _MOST_STEP


class Placed(NamedTuple):
    """An event of a recording.

    Attributes:
        event: the event.
        period: number of the period in which its run is in use, from 0; -1 without effect.
        since: stamp of the first event that takes effect together with this event, ns.
        why: the decision on the event.
    """

    event: ImpactEvent
    period: int
    since: int
    why: Weighed = _FOLLOWED


def placed(events: Iterable[ImpactEvent], epoch: int = 0) -> list[Placed]:
    """The events of a recording with the periods in which their runs are in use.

    Args:
        events: in order of reception.
        epoch: given epoch of the observer, ns; 0 to take the epoch from the events.
    """
    runs, period, places = SenderRuns(epoch), 0, list[Placed]()
    of: dict[ImpactEvent, list[int]] = {}
    for event in events:
        weighed = runs.weigh(event)
        if weighed.reason:
            of.setdefault(event, []).append(len(places))
            places.append(Placed(event, -1, event.stamp, weighed))
            continue
        if weighed.previous is not None:
            period += 1
        for each in weighed.released:
            for at in of.pop(each, ()):
                places[at] = Placed(each, period, each.stamp)
        since = min(each.stamp for each in (*weighed.released, event))
        places.append(Placed(event, period, since))
    return places


def in_order(events: Iterable[ImpactEvent]) -> list[ImpactEvent]:
    """Sort a recording by run, stamp and sequence, without a change of its effect.

    An event without effect stays behind its predecessor. ``events`` are in order of reception.
    """
    keys, last = list[tuple[int, int, int, int]](), (0, 0, 0)
    every = placed(events)
    for i, each in enumerate(every):
        if each.period >= 0:
            last = (each.period, each.event.stamp, each.event.sequence)
        keys.append((*last, i))
    return [every[i].event for *_, i in sorted(keys)]
