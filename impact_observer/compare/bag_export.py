# SPDX-License-Identifier: Apache-2.0
"""The states, errors, events or impacts of a bag as rows of a table, topic by topic.

``topics`` are topics of states, or observers' prefixes; None means all. Seconds count from
``time_zero``.
"""

from collections.abc import Callable, Collection, Iterator, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from impact_observer.compare.bag_comparison import states_of_topics
from impact_observer.compare.comparison import compare_states
from impact_observer.compare.table_files import TableBlock
from impact_observer.errors import BagError, UnfitBagError, UsageError
from impact_observer.events import ImpactEstimate, Ruling
from impact_observer.io import interfaces
from impact_observer.io.bag_part import TimeZero, time_zero
from impact_observer.io.interfaces import absolute
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import events_in, outcomes_in
from impact_observer.model.multibody import Multibody

DEVIATIONS = ("deviation_q", "deviation_u")
"""Prefixes of the columns of standard deviations, of coordinates and of velocities."""
_ROWS = 65536
"""Most rows of states in a block."""
Progress: TypeAlias = Callable[[int, int], None]
"""Receives the number of messages read, and of all."""


def state_rows(
    reader: BagReader, topics: Collection[str] | None, progress: Progress
) -> Iterator[TableBlock]:
    """The true states and the estimates, each topic in the order of the bag.

    If an observer has a covariance, all rows have standard deviations too, NaN for other states.

    Raises:
        UsageError: a topic is not in the bag.
        BagError: there are no states, topics have different coordinates, or the bag is damaged.
    """
    chosen = state_topics(reader, topics)
    first = reader.first_state(chosen)
    if first is None:
        raise UnfitBagError(f"{reader.path}: has no states; topics: {', '.join(reader.topics)}")
    zero = time_zero(reader)
    states = reader.states(chosen, first.names, progress)
    with_deviations = any(np.isfinite(each.deviations).any() for each in states.values())
    for topic, each in states.items():
        numbers = _columns(("q", "u"), each.names, each.x)
        if with_deviations:
            numbers |= _columns(DEVIATIONS, each.names, each.deviations)
        for rows in (slice(k, k + _ROWS) for k in range(0, each.stamps.size, _ROWS)):
            some = {name: column[rows] for name, column in numbers.items()}
            stamps = each.stamps[rows]
            yield TableBlock(topic, zero, stamps, {"topic": [topic] * stamps.size}, some)


def error_rows(
    reader: BagReader,
    system: Multibody,
    topics: Collection[str] | None,
    progress: Progress,
) -> Iterator[TableBlock]:
    """Estimate minus truth, and V, at the stamps that both have.

    As in ``compare``, estimates that were published before their events arrived are left out, and
    so are samples between the jumps of truth and estimate.

    Raises:
        UsageError: a topic is not in the bag.
        BagError: there is no truth, no estimate, or no stamp that both have.
    """
    truth = reader.truth_topic()
    if truth is None:
        raise UnfitBagError(f"{reader.path}: has no truth ({interfaces.PLANT_JOINT_STATES.topic})")
    chosen = [topic for topic in state_topics(reader, topics) if topic != truth]
    if not chosen:
        raise UnfitBagError(f"{reader.path}: has no estimates; make them with observe")
    zero = time_zero(reader)
    events = events_in(reader) if reader.find(interfaces.IMPACTS) else []
    laws, states = states_of_topics(reader, system, [truth, *chosen], progress)
    for topic in chosen:
        law = laws.get(topic) or topic.split("/")[-2]
        outcomes = outcomes_in(reader, topic, events)
        try:
            compared = compare_states(system, law, states[truth], states[topic], outcomes)
        except BagError as error:
            raise BagError(f"{reader.path}: {error}") from None
        words = {"topic": [topic] * compared.samples, "law": [law] * compared.samples}
        errors = _columns(("dq", "du"), system.coordinates, compared.error)
        yield TableBlock(topic, zero, compared.stamps, words, {"V": compared.V, **errors})


def event_rows(reader: BagReader, progress: Progress) -> Iterator[TableBlock]:
    """The events, a row for each contact that switches; ``import`` reads them again.

    Raises:
        BagError: there are no events, or the bag is damaged.
    """
    events = events_in(reader)
    if not events:
        raise UnfitBagError(f"{reader.path}: has no events to export")
    zero = time_zero(reader)
    rows = [(event, switch) for event in events for switch in event.switches]
    words = {
        "contact": [switch.contact for _, switch in rows],
        "kind": [switch.kind.name.lower() for _, switch in rows],
    }
    numbers = {
        "sequence": np.array([event.sequence for event, _ in rows], dtype=np.int64),
        "episode": np.array([event.episode for event, _ in rows], dtype=np.int64),
    }
    stamps = np.array([event.stamp for event, _ in rows], dtype=np.int64)
    yield TableBlock(reader.find(interfaces.IMPACTS) or "", zero, stamps, words, numbers)
    progress(len(rows), len(rows))


def impact_rows(
    reader: BagReader,
    topics: Collection[str] | None,
    progress: Progress,
    zero: TimeZero | None = None,
) -> Iterator[TableBlock]:
    """The estimates of impacts, each number followed by its standard deviation, in SI units.

    Times count from ``zero``; None for the time zero of the bag. NaN stands for a deviation that
    a law does not have, and for all numbers of a rejected impact.

    Raises:
        UsageError: a topic is not in the bag.
        BagError: there are no estimates of impacts, or the bag is damaged.
    """
    chosen, zero = named_impacts(reader, topics), zero or time_zero(reader)
    for done, topic in enumerate(chosen, start=1):
        rows = [*reader.impact_estimates(topic)]
        values, deviations = np.reshape([each[4:] for each in rows], (-1, 2, 4)).swapaxes(0, 1)
        deviations[deviations < 0] = np.nan
        values[[each.ruling is Ruling.REJECTED for each in rows]] = np.nan
        numbers = {"sequence": np.array([each.sequence for each in rows], dtype=np.int64)}
        for k, name in enumerate(ImpactEstimate._fields[4:8]):
            numbers |= {name: values[:, k], f"{name}_deviation": deviations[:, k]}
        words = {
            "topic": [topic] * len(rows),
            "contact": [each.contact for each in rows],
            "verdict": [each.ruling.name.lower() for each in rows],
        }
        stamps = np.array([each.stamp for each in rows], dtype=np.int64)
        yield TableBlock(topic, zero, stamps, words, numbers)
        progress(done, len(chosen))


def _columns(
    kinds: tuple[str, str], names: Sequence[str], x: NDArray[np.float64]
) -> dict[str, NDArray[np.float64]]:
    """Columns of coordinates and velocities, such as ``q_x1`` and ``u_x1``."""
    headings = [f"{kind}_{name}" for kind in kinds for name in names]
    return dict(zip(headings, x.T, strict=True))


def state_topics(reader: BagReader, named: Collection[str] | None) -> list[str]:
    """Topics of states: the named ones, else the truth and the states of every observer."""
    if named is None:
        return [*reader.state_topics()]
    prefixes = reader.observers()
    topics = (
        reader.states_of(prefix)
        if (prefix := absolute(name)) in prefixes
        else _in_bag(reader, name)
        for name in named
    )
    return [*dict.fromkeys(topics)]


def _in_bag(reader: BagReader, name: str) -> str:
    """The absolute name of a topic, given with or without its first slash.

    Raises:
        UsageError: the bag has no such topic.
    """
    topic = absolute(name)
    if topic not in reader.topics:
        in_bag = ", ".join(reader.topics) or "none"
        raise UsageError(f"{reader.path}: no topic or observer {topic}; in the bag: {in_bag}")
    return topic


def named_impacts(reader: BagReader, named: Collection[str] | None) -> list[str]:
    """Topics of estimates of impacts: the named ones, else those of every observer.

    Raises:
        UsageError: the bag has no such topic or observer.
        BagError: the bag has no estimates of impacts.
    """
    of_owner = {topic.rpartition("/")[0]: topic for topic in reader.impact_topics()}
    if named is None:
        return [*of_owner.values()]
    topics = (of_owner.get(absolute(name)) or _in_bag(reader, name) for name in named)
    return [*dict.fromkeys(topics)]
