"""Comparing estimates with the truth in a bag: those in it, and those of observers run on it."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial

import numpy as np

from impact_observer.compare.comparison import (
    SETTLED,
    Comparing,
    Comparison,
    compare_law,
    impacts_in,
)
from impact_observer.errors import BagError
from impact_observer.events import ImpactEvent
from impact_observer.io import interfaces
from impact_observer.io.columns import JointStates, ObserverStates
from impact_observer.io.pairing import Series
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import epoch_of, events_in, outcomes_in
from impact_observer.io.topic_names import first_stamp, named_states, named_topic
from impact_observer.model import System
from impact_observer.observer import Observer
from impact_observer.states import Stamps


@dataclass(frozen=True, slots=True, eq=False)
class BagComparison:
    """All estimates of one bag against its truth.

    Attributes:
        system: the system that plant and observers share.
        comparisons: by the observer's topic prefix, such as ``/observer_geometric``, or by the
            topic that was named, and of observers that were run on the bag by their law's name.
        impacts: stamps of the impacts (ns), by contact.
        epoch: stamp of ``t = 0``, ns; where no event says it, the first stamp of the truth.
    """

    system: System
    comparisons: dict[str, Comparison]
    impacts: dict[str, Stamps]
    epoch: int


@dataclass(frozen=True, slots=True)
class Choice:
    """What of a bag to compare, and how.

    Attributes:
        truth: the topic of the plant's true states; None for the one there is.
        estimates: observers' prefixes, or topics of states; None for every observer.
        threshold: V over V at the start below which an estimate has settled.
    """

    truth: str | None = None
    estimates: tuple[str, ...] | None = None
    threshold: float = SETTLED


ALL = Choice()
"""Every observer in the bag against its truth."""


def compare_bag(
    reader: BagReader,
    system: System,
    observers: Sequence[Observer] = (),
    *,
    choice: Choice = ALL,
    progress: Callable[[str, int, int], None] = lambda _what, _done, _all: None,
) -> BagComparison:
    """Compare with the plant the observers in a bag, and others that are run on its events.

    The states go by block by block: memory does not grow with the length of the bag.

    Args:
        reader: the bag.
        system: gives M and K for V.
        observers: to run on the bag, one a law; they have seen nothing yet.
        choice: what of the bag to compare, and how.
        progress: told what is done, how much of it and how much there is.

    Raises:
        UsageError: a topic that is named is not in the bag.
        BagError: the bag has no truth, no estimate, or nothing in common between them, or an
            observer could not apply any of its events.
        ImpactLawError, DynamicsError, UsageError: an observer cannot follow the events.
    """
    truth = _truth_topic(reader, choice.truth)
    topics = _estimate_topics(reader, choice.estimates)
    if not topics and not observers:
        raise BagError(
            f"{reader.path}: has no estimates; make them with observe, or name laws with --laws"
        )
    events = events_in(reader)
    comparisons = _compare_recorded(
        reader, system, (truth, topics), events, choice=choice, progress=progress
    )
    for observer in observers:
        law = observer.law.name
        with _named(reader):
            comparisons[law] = compare_law(
                observer,
                events,
                partial(_truth_of, reader, truth, system),
                threshold=choice.threshold,
                progress=partial(progress, law),
            )
    epoch = epoch_of(events) or first_stamp(reader, [truth]) or 0
    return BagComparison(system, comparisons, impacts_in(events), epoch)


def _truth_topic(reader: BagReader, named: str | None) -> str:
    if named is not None:
        return named_topic(reader, named)
    if (found := reader.truth_topic()) is None:
        raise BagError(
            f"{reader.path}: has no truth ({interfaces.PLANT_JOINT_STATES.topic}) to compare with"
        )
    return found


def _estimate_topics(reader: BagReader, named: Sequence[str] | None) -> dict[str, str]:
    """Topics of estimates by what they are called: an observer's prefix, or the topic itself."""
    names = reader.observers() if named is None else [f"/{each.strip('/')}" for each in named]
    return {name: named_states(reader, name) for name in names}


def _compare_recorded(
    reader: BagReader,
    system: System,
    where: tuple[str, dict[str, str]],
    events: list[ImpactEvent],
    *,
    choice: Choice,
    progress: Callable[[str, int, int], None],
) -> dict[str, Comparison]:
    """The estimates that are in the bag, all in one pass."""
    truth, topics = where
    if not topics:
        return {}
    recorded = {
        name: RecordedEstimate(
            topic,
            Comparing(system, outcomes_in(reader, topic, events), choice.threshold),
            law=name.rpartition("/")[2],
        )
        for name, topic in topics.items()
    }
    wanted = dict.fromkeys([truth, *topics.values()])
    total, done = sum(reader.topics[topic].count for topic in wanted), 0
    for topic, block in reader.blocks([*wanted], system.coordinates):
        for each in recorded.values():
            each.add(topic, block, truth)
            each.comparing.proceed()
        done += block.stamps.size
        progress("comparing", done, total)
    with _named(reader):
        return {name: each.comparing.result(each.law) for name, each in recorded.items()}


@dataclass(slots=True)
class RecordedEstimate:
    """The estimates on a topic, against the truth while both go by.

    Attributes:
        topic: of the estimates.
        comparing: takes the blocks of both.
        law: of the estimates; the observer's name while they have not said it.
    """

    topic: str
    comparing: Comparing
    law: str

    def add(self, topic: str, block: JointStates, truth: str) -> None:
        """Take the next states of any topic; ``truth`` is that of the plant's."""
        if topic == truth:
            self.comparing.pairing.truth.add(_series(block))
        if topic == self.topic:
            self.comparing.pairing.estimates.add(_series(block))
            self.law = getattr(block, "law", "") or self.law


def _truth_of(reader: BagReader, topic: str, system: System) -> Iterator[Series]:
    """The plant's states, block by block."""
    return (_series(block) for _, block in reader.blocks([topic], system.coordinates))


@contextmanager
def _named(reader: BagReader) -> Iterator[None]:
    """Errors within say which bag."""
    try:
        yield
    except BagError as error:
        where = str(reader.path)
        raise error if str(error).startswith(where) else BagError(f"{where}: {error}") from None


def _series(block: JointStates) -> Series:
    last_event = block.last_event if isinstance(block, ObserverStates) else None
    return Series(block.stamps, np.hstack([block.q, block.u]), last_event)
