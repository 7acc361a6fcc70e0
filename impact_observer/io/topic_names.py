# SPDX-License-Identifier: Apache-2.0
"""Topics of a bag by the names that users give, and their first states."""

from collections.abc import Iterable

from impact_observer.errors import UsageError
from impact_observer.io.reader import BagReader
from impact_observer.io.state_arrays import JointStates


def named_topic(reader: BagReader, name: str) -> str:
    """The absolute name of a topic, given with or without its first slash.

    Raises:
        UsageError: the bag has no such topic.
    """
    topic = f"/{name.strip('/')}"
    if topic not in reader.topics:
        found = ", ".join(reader.topics) or "none"
        raise UsageError(f"{reader.path}: no topic or observer {topic}; in the bag: {found}")
    return topic


def named_states(reader: BagReader, name: str) -> str:
    """The topic of states of the observer or topic ``name``.

    Raises:
        UsageError: the bag has neither.
    """
    prefix = f"/{name.strip('/')}"
    return states_of(reader, prefix) if prefix in reader.observers() else named_topic(reader, name)


def states_of(reader: BagReader, prefix: str) -> str:
    """The topic of an observer's states, or of its joint states if no states are recorded."""
    state = f"{prefix}/state"
    return state if state in reader.topics else f"{prefix}/joint_states"


def first_stamp(reader: BagReader, topics: Iterable[str]) -> int | None:
    """The first stamp, ns, in the first topic with a state; None without a state."""
    first = first_block(reader, topics)
    return None if first is None else int(first.stamps[0])


def first_block(reader: BagReader, topics: Iterable[str]) -> JointStates | None:
    """The first states in the first topic with a state; None without a state."""
    blocks = (next(iter(reader.blocks([topic])))[1] for topic in topics)
    return next((block for block in blocks if block.stamps.size), None)
