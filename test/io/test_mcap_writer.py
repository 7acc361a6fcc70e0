# SPDX-License-Identifier: Apache-2.0
"""MCAP files written many messages at a time, against those that ``rosbags`` writes."""

from pathlib import Path

import pytest
from foreign_bags import TOPICS, random_messages
from mcap.reader import make_reader
from mcap.summary import Summary
from rosbags.rosbag2 import Reader, StoragePlugin, Writer

from impact_observer.io import interfaces
from impact_observer.io.mcap_writer import McapWriter
from impact_observer.io.typestores import new_typestore

Message = tuple[str, int, bytes]


def written(path: Path, messages: list[Message], sizes: list[int]) -> Path:
    """A file of ``messages``, of which so many are written at a time."""
    file, store = McapWriter(path, compressed=False), new_typestore()
    definition, _ = store.generate_msgdef(interfaces.STRING, ros_version=2)
    channels = {
        topic: file.add_channel(topic, interfaces.STRING, definition, {}) for topic in TOPICS
    }
    items = [(channels[topic], time, data) for topic, time, data in messages]
    begin = 0
    for size in sizes:
        file.write(items[begin : begin + size])
        begin += size
    file.finish("")
    return path


def by_rosbags(folder: Path, messages: list[Message]) -> Path:
    """The file that ``rosbags`` writes of the same messages, one by one."""
    store = new_typestore()
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topics = {
            topic: writer.add_connection(topic, interfaces.STRING, typestore=store)
            for topic in TOPICS
        }
        for topic, time, data in messages:
            writer.write(topics[topic], time, data)
    return folder / f"{folder.name}.mcap"


def summary_of(path: Path) -> Summary:
    """The index at the end of a file."""
    with path.open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    assert summary is not None
    return summary


def same_as_rosbags(tmp_path: Path, messages: list[Message], sizes: list[int]) -> int:
    """Compare chunks, statistics and messages with those of ``rosbags``; the number of chunks."""
    ours = written(tmp_path / "ours.mcap", messages, sizes)
    theirs = by_rosbags(tmp_path / "theirs", messages)
    one, other = summary_of(ours), summary_of(theirs)
    assert one.statistics == other.statistics
    for chunk, expected in zip(one.chunk_indexes, other.chunk_indexes, strict=True):
        for name in ("message_start_time", "message_end_time", "message_index_length"):
            assert getattr(chunk, name) == getattr(expected, name)
        assert chunk.message_index_offsets.keys() == expected.message_index_offsets.keys()
    with Reader(ours) as reader, Reader(theirs) as expected_reader:
        found = [(c.topic, time, bytes(data)) for c, time, data in reader.messages()]
        assert found == [(c.topic, time, data) for c, time, data in expected_reader.messages()]
    with ours.open("rb") as file:
        mcap = [(c.topic, m.log_time, m.data) for _, c, m in make_reader(file).iter_messages()]
    assert sorted(mcap) == sorted(messages) == sorted(found)
    return len(one.chunk_indexes)


@pytest.mark.slow
@pytest.mark.parametrize("sizes", [[6000], [1, 256, 0, 1000, 4743], [100] * 60])
def test_chunks_and_messages_are_those_of_rosbags(tmp_path: Path, sizes: list[int]) -> None:
    """However many messages are written at a time, across several chunks."""
    assert same_as_rosbags(tmp_path, random_messages(6000, seed=1), sizes) > 2


def test_a_message_larger_than_a_chunk_ends_its_chunk(tmp_path: Path) -> None:
    """As ``rosbags`` has it; the next message begins another chunk."""
    messages = [("/a", k, bytes(size)) for k, size in enumerate([4, 3 << 20, 5, 2 << 20, 1 << 20])]
    assert same_as_rosbags(tmp_path, messages, [5]) == 3


def test_the_file_does_not_depend_on_how_many_messages_are_written_at_a_time(
    tmp_path: Path,
) -> None:
    """In every byte."""
    messages = random_messages(3000, seed=2)
    one = written(tmp_path / "one.mcap", messages, [1] * 3000)
    many = written(tmp_path / "many.mcap", messages, [7, 2000, 993])
    assert one.read_bytes() == many.read_bytes()
