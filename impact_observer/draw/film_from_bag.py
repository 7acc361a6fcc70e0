# SPDX-License-Identifier: Apache-2.0
"""The film of a part of a bag; only the states of the part are kept in memory."""

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_observer.draw.estimates import chosen_observers, labels_by_law, law_of
from impact_observer.draw.scene.film import ContactHistory, Distance, Film, Track, scene_of
from impact_observer.errors import UnfitBagError
from impact_observer.io import interfaces
from impact_observer.io.bag_part import time_zero
from impact_observer.io.live_inputs import with_recorded
from impact_observer.io.pairing import HOLD, arrived
from impact_observer.io.reader import BagReader, first_stamp, states_of
from impact_observer.io.recordings import events_in, outcomes_in
from impact_observer.io.state_arrays import JointStates, ObserverStates, joined
from impact_observer.model import System
from impact_observer.stamps import from_seconds, text
from impact_observer.states import Stamps

MOST_ESTIMATES = 6
"""Most estimates in a film."""


def read_film(
    reader: BagReader,
    system: System,
    *,
    start: float | None,
    duration: float,
    observers: Sequence[str] | None = None,
    warn: Callable[[str], object] = lambda _line: None,
) -> Film:
    """The motion of plant and observers in a part of a bag.

    Args:
        reader: the bag.
        system: of the plant.
        start: of the part, s since ``t = 0``; None for the first state.
        duration: of the part, s; may be longer than the bag.
        observers: prefixes of the estimates' topics, with or without the first slash; None for
            all.
        warn: called with a line for each reason why samples of live inputs were left out.

    Raises:
        BagError: the bag has neither truth nor estimates, none in this part, or is damaged.
        UsageError: an observer that is not in the bag, or too many observers.
    """
    prefixes = chosen_observers(reader, observers, MOST_ESTIMATES)
    truth_topic = reader.truth_topic()
    topics = {prefix: states_of(reader, prefix) for prefix in prefixes}
    wanted = [*([] if truth_topic is None else [truth_topic]), *topics.values()]
    if not wanted:
        raise UnfitBagError(
            f"{reader.path}: nothing that moves; expected true states on"
            f" {interfaces.PLANT_JOINT_STATES.topic} or estimates, as observe makes them"
        )
    events = events_in(reader) if reader.find(interfaces.IMPACTS) is not None else []
    zero = time_zero(reader)
    epoch = zero.stamp
    system = with_recorded(reader, system, epoch, warn)
    first = min(epoch, first_stamp(reader, wanted) or epoch)
    first = first if start is None else epoch + from_seconds(start)
    states = _states_between(reader, system, wanted, first, first + from_seconds(duration))
    impacts = {event.stamp for event in events}
    truth = None if truth_topic is None else _track("plant", states[truth_topic], impacts)
    labels = labels_by_law({prefix: law_of(states[topic]) for prefix, topic in topics.items()})
    estimates = []
    for prefix, topic in topics.items():
        outcomes = outcomes_in(reader, topic, events)
        in_time = _with_all_events(states[topic], outcomes.reported)
        jumps = impacts | set(outcomes.instants.tolist())
        estimates.append(_track(labels[prefix], in_time, jumps))
    present = [each.stamps for each in states.values() if each.stamps.size]
    return Film(
        scene=scene_of(system, [*([] if truth is None else [truth]), *estimates]),
        truth=truth,
        estimates=tuple(estimates),
        distances=tuple(Distance.between(system, truth, each) for each in estimates if truth),
        contacts=ContactHistory.of_events(system, events),
        zero=zero,
        start=max(first, min(int(each.min()) for each in present)),
        end=max(int(each.max()) for each in present),
    )


def _states_between(
    reader: BagReader, system: System, topics: Sequence[str], low: int, high: int
) -> dict[str, JointStates]:
    """The states of each topic from stamp ``low`` to stamp ``high``, ns.

    Raises:
        BagError: no topic has a state between the stamps, or as ``BagReader.blocks``.
    """
    parts: dict[str, list[JointStates]] = {topic: [] for topic in topics}
    beyond: set[str] = set()
    for topic, block in reader.blocks(topics, system.coordinates):
        parts[topic].append(_rows(block, (block.stamps >= low) & (block.stamps <= high)))
        if np.any(block.stamps > high + HOLD):
            beyond.add(topic)
        if len(beyond) == len(parts):
            break
    states = {topic: joined(blocks) for topic, blocks in parts.items()}
    if not any(each.stamps.size for each in states.values()):
        raise UnfitBagError(
            f"{reader.path}: no states between {text(low)} and {text(high)} s; choose another"
            " stretch with --start and --duration"
        )
    return states


def _rows(block: JointStates, rows: NDArray[np.bool_]) -> JointStates:
    """Copies of some rows of a block."""
    arrays: dict[str, Any] = {
        each.name: getattr(block, each.name)[rows]
        for each in fields(block)
        if isinstance(getattr(block, each.name), np.ndarray)
    }
    return replace(block, **arrays)


def _track(label: str, states: JointStates, jumps: set[int]) -> Track:
    """The track of some states."""
    return Track.of_states(label, law_of(states), (states.stamps, states.q, states.u), jumps)


def _with_all_events(states: JointStates, received: Stamps) -> JointStates:
    """The estimates that contain all events before their stamp.

    ``received`` are the stamps of the events. Other estimates were published before an event
    arrived, and lack the jump of the event.
    """
    if not isinstance(states, ObserverStates) or not states.last_event.any():
        return states  # the messages do not name the events that an estimate contains
    return _rows(states, arrived(states.stamps, states.last_event, received))
