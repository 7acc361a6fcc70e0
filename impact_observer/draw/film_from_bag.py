"""A stretch of a bag as a film: only what will be seen is kept in memory."""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_observer.draw.scene.film import Contacts, Distance, Film, Track, scene_of
from impact_observer.errors import BagError, UsageError
from impact_observer.io import interfaces
from impact_observer.io.columns import JointStates, ObserverStates, joined
from impact_observer.io.pairing import HOLD, arrived
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import epoch_of, events_in, outcomes_in
from impact_observer.io.topic_names import first_stamp, states_of
from impact_observer.model import System
from impact_observer.stamps import from_seconds, text
from impact_observer.states import Stamps

MOST_ESTIMATES = 6
"""Most estimates above each other."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """A part of a bag.

    Attributes:
        start: s since the epoch.
        duration: s, from there.
    """

    start: float
    duration: float


def read_film(
    reader: BagReader, system: System, stretch: Stretch, observers: Sequence[str] | None = None
) -> Film:
    """What plant and observers do in a stretch of a bag.

    Args:
        reader: the bag.
        system: of the plant.
        stretch: which part; what is beyond the end is left out.
        observers: prefixes of the estimates' topics, with or without the first slash; None for
            all.

    Raises:
        BagError: the bag has neither truth nor estimates, none in the stretch, or is damaged.
        UsageError: an observer that is not in the bag, or too many of them.
    """
    prefixes = _chosen(reader, observers)
    truth_topic = reader.truth_topic()
    topics = {prefix: states_of(reader, prefix) for prefix in prefixes}
    wanted = [*([] if truth_topic is None else [truth_topic]), *topics.values()]
    if not wanted:
        raise BagError(
            f"{reader.path}: nothing that moves; expected true states on"
            f" {interfaces.PLANT_JOINT_STATES.topic} or estimates, as observe makes them"
        )
    events = events_in(reader) if reader.find(interfaces.IMPACTS) is not None else []
    epoch = epoch_of(events) or first_stamp(reader, wanted) or 1
    start = epoch + from_seconds(stretch.start)
    window = (start, start + from_seconds(stretch.duration))
    states = _read(reader, system, wanted, window)
    heard = {event.stamp for event in events}
    truth = None
    if truth_topic is not None:
        truth = _track("plant", states[truth_topic], heard)
    labels = _labels({prefix: states[topic] for prefix, topic in topics.items()})
    estimates = []
    for prefix, topic in topics.items():
        made = outcomes_in(reader, topic, events)
        punctual = _punctual(states[topic], made.reported)
        estimates.append(_track(labels[prefix], punctual, heard | set(made.instants.tolist())))
    present = [each.stamps for each in states.values() if each.stamps.size]
    return Film(
        scene=scene_of(system, [*([] if truth is None else [truth]), *estimates]),
        truth=truth,
        estimates=tuple(estimates),
        distances=_distances(system, truth, estimates),
        contacts=Contacts.of(system, events),
        epoch=epoch,
        start=max(start, min(int(each.min()) for each in present)),
        end=max(int(each.max()) for each in present),
    )


def _chosen(reader: BagReader, observers: Sequence[str] | None) -> tuple[str, ...]:
    """Prefixes of the observers that are shown."""
    known = reader.observers()
    chosen = known if observers is None else tuple(f"/{each.lstrip('/')}" for each in observers)
    for each in chosen:
        if each not in known:
            raise UsageError(
                f"observer {each}: not in {reader.path}; it has {', '.join(known) or 'none'}"
            )
    if len(chosen) > MOST_ESTIMATES:
        raise UsageError(
            f"{len(chosen)} observers: too many; name at most {MOST_ESTIMATES} with --observers:"
            f" {', '.join(known)}"
        )
    return tuple(dict.fromkeys(chosen))


def _read(
    reader: BagReader, system: System, topics: Sequence[str], window: tuple[int, int]
) -> dict[str, JointStates]:
    """The states between two stamps, ns, of each topic.

    Raises:
        BagError: there is none on any topic, or as ``BagReader.blocks``.
    """
    low, high = window
    found: dict[str, list[JointStates]] = {topic: [] for topic in topics}
    beyond: set[str] = set()
    for topic, block in reader.blocks(topics, system.coordinates):
        inside = (block.stamps >= low) & (block.stamps <= high)
        found[topic].append(_part(block, inside))
        if np.any(block.stamps > high + HOLD):
            beyond.add(topic)
        if len(beyond) == len(found):
            break
    states = {topic: joined(blocks) for topic, blocks in found.items()}
    if not any(each.stamps.size for each in states.values()):
        raise BagError(
            f"{reader.path}: no states between {text(low)} and {text(high)} s; choose another"
            " stretch with --start and --duration"
        )
    return states


def _part(block: JointStates, rows: NDArray[np.bool_]) -> JointStates:
    """Some rows of a block; the others are let go."""
    arrays: dict[str, Any] = {
        each.name: getattr(block, each.name)[rows]
        for each in fields(block)
        if isinstance(getattr(block, each.name), np.ndarray)
    }
    return replace(block, **arrays)


def _track(label: str, states: JointStates, cuts: Collection[int]) -> Track:
    """The track of some states."""
    law = states.law if isinstance(states, ObserverStates) else ""
    return Track.of(label, law, (states.stamps, states.q, states.u), cuts)


def _distances(
    system: System, truth: Track | None, estimates: Sequence[Track]
) -> tuple[Distance, ...]:
    """Of each estimate, if there is truth."""
    if truth is None:
        return ()
    return tuple(Distance.between(system, truth, each) for each in estimates)


def _labels(states: Mapping[str, JointStates]) -> dict[str, str]:
    """Each estimate by its law, with the topic's prefix where that is not enough."""
    laws = {
        prefix: (each.law if isinstance(each, ObserverStates) else "") or prefix.lstrip("/")
        for prefix, each in states.items()
    }
    several = {law for law, times in Counter(laws.values()).items() if times > 1}
    return {
        prefix: f"{law} ({prefix.lstrip('/')})" if law in several else law
        for prefix, law in laws.items()
    }


def _punctual(states: JointStates, told: Stamps) -> JointStates:
    """The estimates that contain the events before them, of which ``told`` are the stamps.

    The others were published before an event arrived, and are on the wrong side of its jump.
    """
    if not isinstance(states, ObserverStates) or not states.last_event.any():
        return states  # which events they contain they do not say
    return _part(states, arrived(states.stamps, states.last_event, told))
