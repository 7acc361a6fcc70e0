# SPDX-License-Identifier: Apache-2.0
"""The events of a recording's last episode, in the order in which an observer applies them."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from impact_observer.errors import BagError, UsageError
from impact_observer.events import ImpactEvent
from impact_observer.model import System
from impact_observer.observer.contact_change import ContactChange
from impact_observer.observer.event_order import EventKey, interpretations, keys_of
from impact_observer.observer.sender_runs import placed
from impact_observer.stamps import seconds_between


class Episode(NamedTuple):
    """The last episode of a recording.

    Attributes:
        start: the epoch, ns; the first stamp where the events do not give an epoch or the first
            of them are missing.
        epoch: stamp of ``t = 0`` of the forcing, ns; ``start`` where the events do not give it.
        keys: the events, each once and in order.
        foreign: number of switches of contacts that the model does not have, by name.
        left_out: number of events that are duplicates, or before the start.
        episodes: number of episodes in the recording.
    """

    start: int
    epoch: int
    keys: list[EventKey]
    foreign: Mapping[str, int]
    left_out: int
    episodes: int

    @property
    def changes(self) -> list[ContactChange]:
        """The changes of the contacts at each event, with seconds since the start."""
        return [*changes(self.keys, self.start)]


def changes(keys: Sequence[EventKey], start: int) -> Iterator[ContactChange]:
    """Yields the changes of the contacts at each event; all contacts are open at first.

    Args:
        keys: events in order, each once.
        start: stamp at which the seconds of the changes are zero, ns.
    """
    for key, (closed, meaning) in zip(keys, interpretations(keys), strict=True):
        t = seconds_between(start, key.stamp)
        yield ContactChange.of(t, closed, meaning.switches, stamp=key.stamp, sequence=key.sequence)


def require_epoch(system: System, epoch: int) -> None:
    """Raise UsageError where the forcing depends on time and its ``epoch`` (ns) is unknown, 0."""
    if not epoch and system.depends_on_time:
        raise UsageError(
            f"epoch: 0 found, which is none, and the forcing of {system.name} depends on time;"
            " expected its stamp of t = 0: --epoch S (epoch of nodes, ns), detect --pulses COLUMN,"
            " or import --time-zero S with S above 0"
        )


def last_episode(system: System, events: Sequence[ImpactEvent]) -> Episode:
    """The last episode of ``events``, for the contacts of ``system``.

    ``events`` are in order of reception, or as ``sender_runs.in_order`` has them.

    Raises:
        BagError: the episode contains no impact of the system's contacts.
    """
    index = {name: i for i, name in enumerate(system.contact_names)}
    last = _latest(events)
    foreign = Counter(s.contact for e in last for s in e.switches if s.contact not in index)
    epoch = max((e.epoch for e in last), default=0)
    first = min((e.sequence for e in last if e.sequence), default=0)
    start = epoch if epoch and first <= 1 else min((e.stamp for e in last), default=0)
    usable = sum(any(s.contact in index for s in e.switches) for e in last)
    keys = [key for key in keys_of(last, index) if key.stamp >= start]
    episodes = len({(e.epoch, e.episode) for e in events})
    episode = Episode(start, epoch or start, keys, dict(foreign), usable - len(keys), episodes)
    if not any(change.hit for change in episode.changes):
        wanted, others = (", ".join(each) or "none" for each in (index, sorted(foreign)))
        raise BagError(
            f"contains no impact of the model's contacts ({wanted}); others in it: {others}"
        )
    return episode


def _latest(events: Sequence[ImpactEvent]) -> list[ImpactEvent]:
    """The events of the run in use at the end."""
    every = placed(events)
    last = max((each.period for each in every), default=0)
    return [each.event for each in every if each.period == last]
