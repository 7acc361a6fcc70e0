# SPDX-License-Identifier: Apache-2.0
"""Comparison of estimates with the truth in a bag: recorded ones, and those of observers run."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from impact_observer.compare.comparison import (
    Comparison,
    compare_replicas,
    compare_states,
    impacts_in,
)
from impact_observer.errors import BagError, UnfitBagError
from impact_observer.io import interfaces
from impact_observer.io.bag_part import TimeZero, time_zero
from impact_observer.io.pairing import Samples, samples_of
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import events_in, outcomes_in
from impact_observer.model.multibody import Multibody
from impact_observer.observer import Observer
from impact_observer.states import Stamps


@dataclass(frozen=True, slots=True, eq=False)
class BagComparison:
    """All estimates of one bag against its truth.

    Attributes:
        system: the system that plant and observers share.
        comparisons: recorded estimates by their observer's topic prefix, such as
            ``/observer_geometric``; estimates of observers that were run on the bag by the law's
            name.
        impacts: stamps of the impacts (ns), by contact.
        zero: time zero.
    """

    system: Multibody
    comparisons: dict[str, Comparison]
    impacts: dict[str, Stamps]
    zero: TimeZero


def compare_bag(
    reader: BagReader,
    system: Multibody,
    observers: Sequence[Observer] = (),
    *,
    progress: Callable[[str, int, int], None] = lambda _what, _done, _all: None,
) -> BagComparison:
    """Compare the observers in a bag, and others that are run on its events, with the truth.

    The ``observers``, one a law, have received nothing yet. ``progress`` receives the name of the
    work, the amount done, and the whole amount.

    Raises:
        BagError: the bag has no truth, no estimate, or no stamp that both have, or an observer
            could not apply any of its events.
        ImpactLawError, DynamicsError: an observer cannot follow the events.
    """
    true_topic = reader.truth_topic()
    if true_topic is None:
        raise UnfitBagError(
            f"{reader.path}: has no truth ({interfaces.PLANT_JOINT_STATES.topic}) to compare with"
        )
    topics = {prefix: topic for topic, prefix in reader.state_topics().items() if prefix}
    if not topics and not observers:
        advice = "make them with observe"
        advice += " --measurements FILE" if system.has_encoders else ", or name laws with --laws"
        raise UnfitBagError(f"{reader.path}: has no estimates; {advice}")
    events = events_in(reader)
    zero = time_zero(reader)
    law_of, states = states_of_topics(
        reader, system, [true_topic, *topics.values()], partial(progress, "comparing")
    )
    true_states = states[true_topic]
    try:
        comparisons = {
            name: compare_states(
                system,
                law_of.get(topic) or name.rpartition("/")[2],
                true_states,
                states[topic],
                outcomes_in(reader, topic, events),
            )
            for name, topic in topics.items()
        }
        for observer in observers:
            law = observer.law.name
            replay = partial(progress, law)
            comparisons[law] = compare_replicas(observer, events, true_states, progress=replay)[0]
    except BagError as error:
        if str(error).startswith(str(reader.path)):
            raise
        raise BagError(f"{reader.path}: {error}") from None
    return BagComparison(system, comparisons, impacts_in(events), zero)


def labelled_by_law(results: Sequence[tuple[Path, BagComparison]]) -> dict[str, Comparison]:
    """All estimates by a unique label: the law, with observer and bag if the law is ambiguous.

    An observer that was run on the bag, and not recorded in it, has no prefix.
    """
    each = [
        (bag, "" if prefix == comparison.law else f" {prefix}", comparison)
        for bag, result in results
        for prefix, comparison in result.comparisons.items()
    ]
    namings = [
        [comparison.law for _, _, comparison in each],
        [f"{comparison.law}{prefix}" for _, prefix, comparison in each],
        [f"{comparison.law} {bag.name}" for bag, _, comparison in each],
        [f"{comparison.law}{prefix} {bag}" for bag, prefix, comparison in each],
    ]
    names = next((n for n in namings if len(set(n)) == len(n)), None)
    if names is None:
        names = [f"{name} #{i}" for i, name in enumerate(namings[-1], start=1)]
    return dict(zip(names, (comparison for _, _, comparison in each), strict=True))


def states_of_topics(
    reader: BagReader,
    system: Multibody,
    topics: Sequence[str],
    progress: Callable[[int, int], None],
) -> tuple[dict[str, str], dict[str, Samples]]:
    """The laws that topics of states name, and their states in the order of the bag, by topic.

    ``system`` gives the order of the coordinates; those that rest on encoders have deviations.

    Raises:
        BagError: the bag is damaged, or a topic has other coordinates.
    """
    found = reader.states(topics, system.coordinates, progress)
    laws = {topic: each.law for topic, each in found.items() if each.law}
    return laws, {
        topic: samples_of(
            each.stamps,
            each.x,
            each.last_event,
            each.deviations if system.has_encoders else None,
        )
        for topic, each in found.items()
    }
