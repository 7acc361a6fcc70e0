# SPDX-License-Identifier: Apache-2.0
"""Which run of the sender an observer follows: no single message decides (docs/nodes.md).

A run is what a sender publishes from one reset to the next: all events of one epoch and episode.
"""

from collections.abc import Iterable
from typing import NamedTuple

from impact_observer.events import ImpactEvent
from impact_observer.stamps import text


class SenderRun(NamedTuple):
    """A run of the sender.

    Attributes:
        epoch: stamp of ``t = 0`` of the forcing, ns; 0 while unknown.
        episode: episode of the sender.
    """

    epoch: int
    episode: int

    def goes_on_as(self, other: "SenderRun") -> bool:
        """Whether ``other`` is the same run, with its epoch known by now."""
        return not self.epoch and self.episode == other.episode


class Weighed(NamedTuple):
    """The decision on an event.

    Attributes:
        reason: why the event has no effect for now; empty for an event of the run in use.
        previous: the run in use until now, if the event has brought another run into use.
        released: the event before, if it is of that other run and takes effect now.
    """

    reason: str = ""
    previous: SenderRun | None = None
    released: tuple[ImpactEvent, ...] = ()


_FOLLOWED = Weighed()


class SenderRuns:
    """The run in use: that of the first event, then any other of which two events come in a row.

    Attributes:
        in_use: the run in use; None before the first event.
    """

    def __init__(self, epoch: int = 0) -> None:
        """Follow the run that the first event begins; 0 for an ``epoch`` (ns) not known yet."""
        self.in_use: SenderRun | None = None
        self._epoch = epoch
        self._held: ImpactEvent | None = None

    def weigh(self, event: ImpactEvent) -> Weighed:
        """Take the next event received."""
        if self.in_use is None:
            self.in_use = SenderRun(self._epoch or event.epoch, event.episode)
        previous, run = self.in_use, SenderRun(event.epoch or self.in_use.epoch, event.episode)
        before, self._held = self._held, None if run == previous else event
        if run == previous:
            return _FOLLOWED
        if (
            before is None
            or before == event
            or (before.epoch or previous.epoch, before.episode) != run
        ):
            is_epoch = run.epoch != previous.epoch
            name = f"epoch {text(run.epoch)} s" if is_epoch else f"episode {run.episode}"
            return Weighed(f"{name} is not in use: it takes effect with two events in a row")
        self.in_use, self._held = run, None
        return Weighed(previous=previous, released=(before,))


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
    held = list[int]()
    for event in events:
        weighed = runs.weigh(event)
        if weighed.reason:
            held.append(len(places))
            places.append(Placed(event, -1, event.stamp, weighed))
            continue
        if weighed.previous is not None:
            period += 1
        for at in held:
            if places[at].event in weighed.released:
                places[at] = Placed(places[at].event, period, places[at].event.stamp)
        held.clear()
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
