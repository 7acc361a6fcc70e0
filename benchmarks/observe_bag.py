# SPDX-License-Identifier: Apache-2.0
"""Observing a bag, against reading it and writing the same messages with ``rosbags``."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys.store import Typestore

from benchmarks.fast_bags import RATE, SECONDS, observe, write_impacts, write_truth
from benchmarks.harness import Benchmark, Contest, DisagreementError, Goal
from impact_observer.io import interfaces
from impact_observer.io.reader import BagReader, RawMessage
from impact_observer.io.state_arrays import ObserverStates
from impact_observer.io.typestores import new_typestore
from impact_observer.stamps import NS_PER_S

COPYING = "reading and writing"
_STATES = interfaces.OBSERVER_STATES.topic
_JOINT_STATES = interfaces.OBSERVER_JOINT_STATES.topic


@dataclass(frozen=True, slots=True, eq=False)
class Observed:
    """The messages of an observer, for the peer that only writes them.

    Attributes:
        states: every estimate.
        after_impact: the first message after each impact, by its sequence number.
        others: the other messages, serialized, by log time.
    """

    states: ObserverStates
    after_impact: dict[int, object]
    others: list[RawMessage]


def prepare(folder: Path, seconds: float = SECONDS) -> Contest:
    """Record a plant, to be estimated at the stamps of its true states."""
    write_truth(folder / "bag", seconds)
    return _contest(folder, None)


def prepare_impacts(folder: Path, seconds: float = SECONDS) -> Contest:
    """Record impacts alone, to be estimated at ``RATE``."""
    write_truth(folder / "truth", seconds)
    write_impacts(folder / "bag", folder / "truth")
    return _contest(folder, RATE)


def _contest(folder: Path, rate: float | None) -> Contest:
    """Check that both write the same bytes on every topic."""
    bag = folder / "bag"
    observe(bag, folder / "ours", rate)
    observed = _observed(bag, folder / "ours")
    _written(bag, observed, folder / "theirs")
    ours, theirs = _contents(folder / "ours"), _contents(folder / "theirs")
    if ours != theirs:
        differ = [topic for topic in ours | theirs if ours.get(topic) != theirs.get(topic)]
        raise DisagreementError(f"other messages on {' and '.join(differ)}")
    return Contest(
        f"{ours[interfaces.IMPACTS.topic][0]} impacts, {observed.states.stamps.size} estimates,"
        f" {sum(count for count, _ in ours.values())} messages written",
        lambda place: observe(bag, place / "bag", rate),
        {COPYING: lambda place: _written(bag, observed, place / "bag")},
    )


def _observed(bag: Path, output: Path) -> Observed:
    with BagReader(bag) as given, BagReader(output) as reader:
        states, found = reader.observer_states(_STATES), dict[int, object]()
        for _, message in reader.messages(_STATES):
            found.setdefault(message.last_sequence, message)
        others = reader.topics.keys() - given.topics.keys() - {_STATES, _JOINT_STATES}
        return Observed(states, found, [*reader.raw(others)])


def _written(bag: Path, observed: Observed, output: Path) -> None:
    """The least that an observer must do, with ``rosbags`` alone.

    Impacts are decoded and written again. For each estimate its two messages are made from given
    numbers, one by one.
    """
    store = new_typestore()
    with (
        Reader(bag) as reader,
        Writer(output, version=9, storage_plugin=StoragePlugin.MCAP) as writer,
    ):
        topics = {c.topic: (c.topic, c.msgtype) for c in reader.connections}
        for each in interfaces.INTERFACES:
            if each.topic in {_STATES, _JOINT_STATES, *(m.topic for m in observed.others)}:
                topics[each.topic] = (each.topic, each.type)
        connections = {
            topic: writer.add_connection(*named, typestore=store)
            for topic, named in topics.items()
        }
        for connection, log_time, data in reader.messages():
            if connection.topic == interfaces.IMPACTS.topic:
                store.deserialize_cdr(data, connection.msgtype)
            writer.write(connections[connection.topic], log_time, data)
        for topic, log_time, data in observed.others:
            writer.write(connections[topic], log_time, data)
        two = connections[_JOINT_STATES], connections[_STATES]
        for log_time, messages in _messages(store, observed):
            for connection, message in zip(two, messages, strict=True):
                serialized = store.serialize_cdr(message, connection.msgtype)
                writer.write(connection, log_time, serialized)


def _messages(store: Typestore, observed: Observed) -> Iterator[tuple[int, tuple[object, object]]]:
    """The stamp and the two messages of each estimate."""
    states, types, none = observed.states, store.types, np.empty(0)
    rows = zip(
        states.stamps.tolist(), states.q, states.u, states.last_sequence.tolist(), strict=True
    )
    for stamp, q, u, sequence in rows:
        about = observed.after_impact[sequence]
        seconds, nanoseconds = divmod(stamp, NS_PER_S)
        time = types[interfaces.TIME](sec=seconds, nanosec=nanoseconds)
        header = types[interfaces.HEADER](stamp=time, frame_id="")
        names = [*states.names]
        joints = types[interfaces.JOINT_STATE](
            header=header, name=names, position=q, velocity=u, effort=none
        )
        kept = {name: getattr(about, name) for name in _CONSTANT}
        state = types[interfaces.OBSERVER_STATE](
            header=header, name=names, position=q, velocity=u, **kept
        )
        yield stamp, (joints, state)


_CONSTANT = (
    "law",
    "covariance",
    "closed",
    "convergence",
    "synchronized",
    "clock_offset",
    "last_sequence",
    "last_event",
    "parameter_name",
    "parameter",
    "parameter_deviation",
)
"""Fields that change at events only."""


def _contents(bag: Path) -> dict[str, tuple[int, int]]:
    """The number of messages of each topic, and a digest of their log times and bytes."""
    contents: dict[str, tuple[int, int]] = {}
    with BagReader(bag) as reader:
        for topic, log_time, data in reader.raw():
            count, digest = contents.get(topic, (0, 0))
            contents[topic] = (count + 1, hash((digest, log_time, data)))
    return contents


def benchmarks(seconds: float = SECONDS) -> tuple[Benchmark, Benchmark]:
    """For bags of so many seconds, with truth and without."""
    truth, impacts = partial(prepare, seconds=seconds), partial(prepare_impacts, seconds=seconds)
    goals = (Goal(3.0, COPYING),)
    return (
        Benchmark("observe", "what does observing a bag cost over copying it?", truth, goals),
        Benchmark("observe_impacts", "the same for a bag without truth, at 1 kHz", impacts, goals),
    )
