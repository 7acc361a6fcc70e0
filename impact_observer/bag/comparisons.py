"""Comparing estimates with the truth in a bag: those in it, and those of observers run on it."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial

import numpy as np

from impact_observer.analysis.comparison import (
    Comparison,
    Series,
    applied_in,
    compare,
    compare_law,
    impacts_in,
)
from impact_observer.bag import interfaces
from impact_observer.bag.columns import JointStates
from impact_observer.bag.reader import BagReader
from impact_observer.bag.recordings import events_in
from impact_observer.errors import BagError
from impact_observer.events import ImpactEvent
from impact_observer.model import System
from impact_observer.observer import Observer
from impact_observer.states import Stamps


@dataclass(frozen=True, slots=True, eq=False)
class BagComparison:
    """All estimates of one bag against its truth.

    Attributes:
        system: the system that plant and observers share.
        comparisons: by the observer's topic prefix, such as ``/observer_geometric``, and of
            observers that were run on the bag by their law's name.
        impacts: stamps of the impacts (ns), by contact.
        epoch: stamp of ``t = 0``, ns; where no event says it, the first stamp of the truth.
    """

    system: System
    comparisons: dict[str, Comparison]
    impacts: dict[str, Stamps]
    epoch: int


def compare_bag(
    reader: BagReader,
    system: System,
    observers: Sequence[Observer] = (),
    *,
    progress: Callable[[str, int, int], None] = lambda _law, _done, _all: None,
) -> BagComparison:
    """Compare with the plant every observer in a bag, and others that are run on its events.

    Args:
        reader: the bag.
        system: gives M and K for V.
        observers: to run on the bag, one a law; they have seen nothing yet.
        progress: told an observer's law, its estimates made and how many there will be.

    Raises:
        BagError: the bag has no truth, no estimate, or nothing in common between them, or an
            observer could not apply any of its events.
        ImpactLawError, DynamicsError, UsageError: an observer cannot follow the events.
    """
    truth_topic = reader.truth_topic()
    if truth_topic is None:
        raise BagError(
            f"{reader.path}: has no truth ({interfaces.PLANT_JOINT_STATES.topic}) to compare with"
        )
    prefixes = reader.observers()
    if not prefixes and not observers:
        raise BagError(
            f"{reader.path}: has no estimates; make them with observe, or name laws with --laws"
        )
    truth = _series(reader.joint_states(truth_topic, system.coordinates))
    events = events_in(reader)
    comparisons = {}
    for prefix in prefixes:
        comparisons[prefix] = _compare_observer(reader, prefix, system, truth, events)
    for observer in observers:
        law = observer.law.name
        with _named(reader):
            comparisons[law] = compare_law(
                observer, events, truth, progress=partial(progress, law)
            )
    epochs = [e.epoch for e in events if e.epoch] or [int(truth.stamps[0])]
    return BagComparison(system, comparisons, impacts_in(events), epochs[0])


def _compare_observer(
    reader: BagReader,
    prefix: str,
    system: System,
    truth: Series,
    events: list[ImpactEvent],
) -> Comparison:
    """One observer; without its ``state`` topic its joint states are taken as they are."""
    state_topic = f"{prefix}/state"
    applied = _applied(reader, prefix, events)
    with _named(reader):
        if state_topic not in reader.topics:
            joint = reader.joint_states(f"{prefix}/joint_states", system.coordinates)
            name = prefix.rpartition("/")[2]
            return compare(system, name, truth, _series(joint), applied=applied)
        states = reader.observer_states(state_topic, system.coordinates)
        return compare(
            system,
            states.law,
            truth,
            _series(states),
            applied=applied,
            last_event=states.last_event,
        )


@contextmanager
def _named(reader: BagReader) -> Iterator[None]:
    """Errors within say which bag."""
    try:
        yield
    except BagError as error:
        where = str(reader.path)
        raise error if str(error).startswith(where) else BagError(f"{where}: {error}") from None


def _series(states: JointStates) -> Series:
    return Series(states.stamps, np.hstack([states.q, states.u]))


def _applied(reader: BagReader, prefix: str, events: list[ImpactEvent]) -> Stamps:
    """Stamps of the events that an observer applied, by its verdicts where it gave any."""
    topic = f"{prefix}/verdicts"
    if topic in reader.topics:
        return applied_in(reader.verdicts(topic))
    return np.unique(np.array([event.stamp for event in events], dtype=np.int64))
