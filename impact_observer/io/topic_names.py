"""Which topics of a bag are meant, as users name them, and where their states begin."""

from collections.abc import Iterable

from impact_observer.errors import UsageError
from impact_observer.io.columns import JointStates
from impact_observer.io.reader import BagReader


def named_topic(reader: BagReader, name: str) -> str:
    """The absolute name of a topic, with its first slash or without.

    Raises:
        UsageError: the bag has no such topic.
    """
    topic = f"/{name.strip('/')}"
    if topic not in reader.topics:
        found = ", ".join(reader.topics) or "none"
        raise UsageError(f"{reader.path}: no topic or observer {topic}; in the bag: {found}")
    return topic


def named_states(reader: BagReader, name: str) -> str:
    """The topic of states of an observer that is named, or the topic that is.

    Raises:
        UsageError: the bag has neither.
    """
    prefix = f"/{name.strip('/')}"
    return states_of(reader, prefix) if prefix in reader.observers() else named_topic(reader, name)


def states_of(reader: BagReader, prefix: str) -> str:
    """The topic of an observer's states, which say more than its joint states."""
    state = f"{prefix}/state"
    return state if state in reader.topics else f"{prefix}/joint_states"


def first_stamp(reader: BagReader, topics: Iterable[str]) -> int | None:
    """The first stamp of the first of some topics of states that has one, ns; None for none."""
    first = first_block(reader, topics)
    return None if first is None else int(first.stamps[0])


def first_block(reader: BagReader, topics: Iterable[str]) -> JointStates | None:
    """The first states of the first of some topics that has any; None for none."""
    blocks = (next(iter(reader.blocks([topic])))[1] for topic in topics)
    return next((block for block in blocks if block.stamps.size), None)
