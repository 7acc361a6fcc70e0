# SPDX-License-Identifier: Apache-2.0
"""Which run of the sender an observer follows: the newest.

A run is what a sender publishes from one reset to the next: all events of one epoch and episode.
"""

from collections.abc import Iterable, Iterator
from itertools import groupby
from operator import itemgetter
from typing import NamedTuple

from impact_observer.events import ImpactEvent
from impact_observer.stamps import NS_PER_S, text

BEGUN_AGAIN = 10 * NS_PER_S
"""How long after the newest stamp an event of an older run is one of a sender begun again, ns."""


class SenderRun(NamedTuple):
    """The run in use.

    Attributes:
        epoch: stamp of ``t = 0`` of the forcing, ns; 0 while unknown.
        episode: episode of the sender.
        latest: the newest stamp of its events, ns.
    """

    epoch: int
    episode: int
    latest: int

    @classmethod
    def of(cls, event: ImpactEvent) -> "SenderRun":
        """The run that an event begins."""
        return cls(event.epoch, event.episode, event.stamp)

    def has(self, event: ImpactEvent) -> bool:
        """Whether an event is of this run; an epoch that is unknown so far may become known."""
        is_epoch = event.epoch == self.epoch or not (event.epoch and self.epoch)
        return is_epoch and event.episode == self.episode

    def after(self, event: ImpactEvent) -> "SenderRun | None":
        """The run in use after an event; None if the event is of an older run.

        A run is newer by a later epoch, or by a higher episode with the same epoch.
        """
        own = (event.epoch or self.epoch, event.episode)
        if self.has(event):
            return SenderRun(*own, max(self.latest, event.stamp))
        is_newer = own > (self.epoch, self.episode)
        return SenderRun.of(event) if is_newer or event.stamp > self.latest + BEGUN_AGAIN else None

    @property
    def name(self) -> str:
        """The run in words."""
        return f"episode {self.episode}" + (
            f" of epoch {text(self.epoch)} s" if self.epoch else ""
        )


class SequenceNumbers:
    """Counts the events of a run by their numbers.

    Attributes:
        lowest: the lowest number; 0 before any.
        missing: how many numbers between the lowest and the highest have not come.
    """

    def __init__(self) -> None:
        """Start with no number."""
        self.lowest = self._highest = self._count = 0

    def note(self, sequence: int) -> None:
        """Count the event of a number, 0 for none."""
        if sequence:
            self.lowest = min(self.lowest or sequence, sequence)
            self._highest = max(self._highest, sequence)
            self._count += 1

    @property
    def missing(self) -> int:
        """See the class."""
        return max(self._highest - self.lowest + 1 - self._count, 0) if self._count else 0


def runs_of(events: Iterable[ImpactEvent]) -> list[list[ImpactEvent]]:
    """The events of each run in use, one run after the other; without events of older runs.

    Args:
        events: in order of reception, or as ``in_order`` has them.
    """
    used = ((number, event) for event, number, is_used in _placed(events) if is_used)
    return [[event for _, event in run] for _, run in groupby(used, key=itemgetter(0))]


def used_of(events: Iterable[ImpactEvent]) -> list[ImpactEvent]:
    """The events that an observer uses, run after run: ``runs_of`` as one list."""
    return [event for event, _, is_used in _placed(events) if is_used]


def in_order(events: Iterable[ImpactEvent]) -> list[ImpactEvent]:
    """Sort a recording by run in use, stamp and sequence; ``events`` are in order of reception."""
    ordered = sorted(_placed(events), key=lambda each: (each[1], each[0].stamp, each[0].sequence))
    return [event for event, *_ in ordered]


def _placed(events: Iterable[ImpactEvent]) -> Iterator[tuple[ImpactEvent, int, bool]]:
    """Each event, the number of the run in use when it came, and whether it is of that run."""
    run, number = None, -1
    for event in events:
        after = SenderRun.of(event) if run is None else run.after(event)
        if after is not None:
            number += run is None or not run.has(event)
            run = after
        yield event, number, after is not None
