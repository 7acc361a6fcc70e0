# SPDX-License-Identifier: Apache-2.0
"""Writing estimates: many messages together, against ``rosbags`` message by message."""

from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer

from benchmarks.fast_bags import EPOCH, RATE
from benchmarks.harness import Benchmark, Contest, DisagreementError
from impact_observer.io import interfaces
from impact_observer.io.estimate_messages import messages_of
from impact_observer.io.messages import JointState, bag_messages
from impact_observer.io.reader import BagReader
from impact_observer.io.typestores import new_typestore
from impact_observer.io.writer import BagWriter
from impact_observer.states import Estimate, Estimates

COUNT = 30_000
TOGETHER = 100
"""Estimates between two impacts, where there are ten a second."""
PEER = "rosbags"
NAMES = ("x1", "x2")
_TOPICS = (interfaces.OBSERVER_JOINT_STATES, interfaces.OBSERVER_STATES)


def prepare(folder: Path) -> Contest:
    """Random estimates; both write the same messages."""
    stamps = EPOCH + np.arange(COUNT) * round(1e9 / RATE)
    x = np.random.default_rng(1).normal(size=(COUNT, 2 * len(NAMES)))
    first = Estimate(EPOCH, "geometric", x[0, :2], x[0, 2:], last_sequence=1, last_event=EPOCH)
    every = Estimates(first, stamps, x)
    blocks = [every.part(k, k + TOGETHER) for k in range(0, COUNT, TOGETHER)]
    make = bag_messages()
    messages = [
        (
            each.stamp,
            (
                make.joint_state(JointState(each.stamp, NAMES, each.q, each.u)),
                make.estimate(each, NAMES),
            ),
        )
        for each in every
    ]

    def ours(place: Path) -> None:
        with BagWriter(place / "bag") as writer:
            for block in blocks:
                for log_time, topic, data in messages_of(block, NAMES, writer.serialized):
                    writer.write_raw(topic, log_time, data)

    def theirs(place: Path) -> None:
        store = new_typestore()
        with Writer(place / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            connections = [
                writer.add_connection(each.topic, each.type, typestore=store) for each in _TOPICS
            ]
            for stamp, two in messages:
                for connection, message in zip(connections, two, strict=True):
                    data = store.serialize_cdr(message, connection.msgtype)
                    writer.write(connection, stamp, data)

    written = []
    for name, job in (("ours", ours), ("theirs", theirs)):
        (folder / name).mkdir()
        job(folder / name)
        with BagReader(folder / name / "bag") as reader:
            written.append([*reader.raw()])
    if written[0] != written[1]:
        raise DisagreementError("they do not write the same messages")
    work = f"{len(written[0])} messages, serialized and written, {2 * TOGETHER} together"
    return Contest(work, ours, {PEER: theirs})


BENCHMARK = Benchmark("write", "what is gained by writing many messages at once?", prepare)
