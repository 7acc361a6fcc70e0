"""Comparing the estimates in a bag with the truth in it."""

from dataclasses import dataclass

import numpy as np

from impact_observer.analysis.comparison import Comparison, Series, compare
from impact_observer.bag import interfaces
from impact_observer.bag.reader import BagReader, JointStates
from impact_observer.bag.recordings import events_in
from impact_observer.errors import BagError
from impact_observer.events import ImpactEvent, Kind, Ruling
from impact_observer.model import System
from impact_observer.states import Stamps


@dataclass(frozen=True, slots=True, eq=False)
class BagComparison:
    """All estimates of one bag against its truth.

    Attributes:
        system: the system that plant and observers share.
        comparisons: by the observer's topic prefix, such as ``/observer_geometric``.
        impacts: stamps of the impacts (ns), by contact.
        epoch: stamp of ``t = 0``, ns; where no event says it, the first stamp of the truth.
    """

    system: System
    comparisons: dict[str, Comparison]
    impacts: dict[str, Stamps]
    epoch: int


def compare_bag(reader: BagReader, system: System) -> BagComparison:
    """Compare every observer in a bag with the plant.

    Raises:
        BagError: the bag has no truth, no estimate, or nothing in common between them.
    """
    truth_topic = reader.truth_topic()
    if truth_topic is None:
        raise BagError(
            f"{reader.path}: has no truth ({interfaces.PLANT_JOINT_STATES.topic}) to compare with"
        )
    observers = reader.observers()
    if not observers:
        raise BagError(f"{reader.path}: has no estimates; make them with observe")
    truth = _series(reader.joint_states(truth_topic, system.coordinates))
    events = events_in(reader)
    comparisons = {}
    for prefix in observers:
        comparisons[prefix] = _compare_observer(reader, prefix, system, truth, events)
    epochs = [e.epoch for e in events if e.epoch] or [int(truth.stamps[0])]
    return BagComparison(system, comparisons, _impacts_of(events), epochs[0])


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
    try:
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
    except BagError as error:
        where = str(reader.path)
        raise error if str(error).startswith(where) else BagError(f"{where}: {error}") from None


def _series(states: JointStates) -> Series:
    return Series(states.stamps, np.hstack([states.q, states.u]))


def _applied(reader: BagReader, prefix: str, events: list[ImpactEvent]) -> Stamps:
    """Stamps of the events that an observer applied, by its verdicts where it gave any."""
    topic = f"{prefix}/verdicts"
    if topic in reader.topics:
        used = (Ruling.APPLIED, Ruling.INSERTED)
        stamps = [verdict.stamp for verdict in reader.verdicts(topic) if verdict.ruling in used]
    else:
        stamps = [event.stamp for event in events]
    return np.unique(np.array(stamps, dtype=np.int64))


def _impacts_of(events: list[ImpactEvent]) -> dict[str, Stamps]:
    by_contact: dict[str, list[int]] = {}
    for event in events:
        for switch in (each for each in event.switches if each.kind is not Kind.OPEN):
            by_contact.setdefault(switch.contact, []).append(event.stamp)
    return {name: np.array(stamps, dtype=np.int64) for name, stamps in sorted(by_contact.items())}
