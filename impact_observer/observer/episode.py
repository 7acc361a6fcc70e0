"""What an observer would make of a recording: its last episode, each event once and in order."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from impact_observer.errors import BagError
from impact_observer.estimation.contact_change import ContactChange
from impact_observer.events import ImpactEvent
from impact_observer.model import System
from impact_observer.observer.event_order import EventKey, deduplicated, interpretations
from impact_observer.stamps import seconds_between


class Episode(NamedTuple):
    """What an observer would make of a recording.

    Attributes:
        start: the epoch, or the first stamp where the events do not say it or their first ones
            are missing, ns.
        epoch: stamp of ``t = 0`` of the forcing, ns; the start where the events do not say it.
        keys: the events, in order.
        foreign: how many switches were of contacts that the model does not have, by name.
        left_out: events that came twice, or before the start.
        episodes: in the recording; the last one counts.
    """

    start: int
    epoch: int
    keys: list[EventKey]
    foreign: Mapping[str, int]
    left_out: int
    episodes: int

    @property
    def changes(self) -> list[ContactChange]:
        """What the events mean, with seconds since the start."""
        return [*changes(self.keys, self.start)]


def changes(keys: Sequence[EventKey], start: int) -> Iterator[ContactChange]:
    """What events mean, all contacts open at first.

    Args:
        keys: in order, each once.
        start: since which their seconds count, ns.
    """
    for key, (closed, reading) in zip(keys, interpretations(keys), strict=True):
        t = seconds_between(start, key.stamp)
        yield ContactChange.of(t, closed, reading.switches, stamp=key.stamp, sequence=key.sequence)


def last_episode(system: System, events: Sequence[ImpactEvent]) -> Episode:
    """The last episode's events, each once and in order, as an observer takes them.

    Raises:
        BagError: they tell no impact of the system's contacts.
    """
    index = {name: i for i, name in enumerate(system.contact_names)}
    last = _latest(events)
    foreign = Counter(s.contact for e in last for s in e.switches if s.contact not in index)
    epoch = max((e.epoch for e in last), default=0)
    first = min((e.sequence for e in last if e.sequence), default=0)
    start = epoch if epoch and first <= 1 else min((e.stamp for e in last), default=0)
    told = [
        EventKey(event.stamp, event.sequence, tuple(sorted(kinds)))
        for event in last
        if (kinds := {(index[s.contact], s.kind) for s in event.switches if s.contact in index})
    ]
    keys = [key for key in deduplicated(told) if key.stamp >= start]
    episodes = len({(e.epoch, e.episode) for e in events})
    found = Episode(start, epoch or start, keys, dict(foreign), len(told) - len(keys), episodes)
    if not any(change.hit for change in found.changes):
        wanted, others = (", ".join(each) or "none" for each in (index, sorted(foreign)))
        raise BagError(
            f"tells no impact of the model's contacts ({wanted}); others in it: {others}"
        )
    return found


def _latest(events: Sequence[ImpactEvent]) -> list[ImpactEvent]:
    """Events of the latest epoch and, in that, of the latest episode."""
    epoch = max((e.epoch for e in events), default=0)
    of_epoch = [e for e in events if e.epoch in {0, epoch}]
    episode = max((e.episode for e in of_epoch), default=0)
    return [e for e in of_epoch if e.episode == episode]
