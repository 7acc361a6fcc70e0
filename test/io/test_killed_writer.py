# SPDX-License-Identifier: Apache-2.0
"""A bag whose writer never ended: what is on the disk, and who can read it."""

import os
import re
from contextlib import suppress
from io import BytesIO
from pathlib import Path

import pytest
from mcap.exceptions import EndOfFile
from mcap.records import Channel, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader

from impact_observer.errors import BagError
from impact_observer.events import ImpactEvent, Switch
from impact_observer.io import BagReader, BagWriter, interfaces
from impact_observer.io.messages import bag_messages

MAKE = bag_messages()
REINDEXED = re.compile(r".+_(\d+)\.([a-zA-Z0-9])+")
"""Files that ``ros2 bag reindex`` of Jazzy takes (rosbag2_cpp, reindexer.cpp)."""
HASHES = {
    "std_msgs/msg/String": "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    "std_msgs/msg/Header": "f49fb3ae2cf070f793645ff749683ac6b06203e41c891e17701b1cb597ce6a01",
}
"""Type hashes of the packages of Jazzy (share/PACKAGE/msg/NAME.json)."""


def event(stamp: int) -> object:
    """A message of an event."""
    return MAKE.event(ImpactEvent(stamp, (Switch("stop"),), stamp))


def records(data: bytes) -> list[McapRecord]:
    """The records of a file from its beginning, up to where it ends too early."""
    found: list[McapRecord] = []
    with suppress(EndOfFile):
        found.extend(StreamReader(BytesIO(data)).records)
    return found


def log_times(data: bytes) -> list[int]:
    """The log times of the messages in a file that is not closed."""
    return [each.log_time for each in records(data) if isinstance(each, Message)]


def test_what_is_flushed_is_on_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """After a loss of power a file has its synchronized part."""
    sizes: list[int] = []
    fsync = os.fsync

    def noted(descriptor: int) -> None:
        fsync(descriptor)
        sizes.append(os.fstat(descriptor).st_size)

    monkeypatch.setattr(os, "fsync", noted)
    with BagWriter(tmp_path / "bag") as writer:
        for last in (1, 100):
            for stamp in range(last, last + 10):
                writer.write("/impacts", stamp, event(stamp))
            writer.flush()
            data = (tmp_path / "bag" / "bag_0.mcap").read_bytes()[: sizes[-1]]
            assert log_times(data)[-10:] == [*range(last, last + 10)]


def test_reindexing_finds_all_it_needs_in_the_chunks(tmp_path: Path) -> None:
    """Another library finds the file's name, types with hashes, qualities and messages.

    ``ros2 bag reindex`` reads the records from the beginning where there is no index, up to the
    first that is cut short.
    """
    bag = tmp_path / "bag"
    with BagWriter(bag) as writer:
        writer.write("/plant/model", 1, MAKE.model("x"))
        writer.declare("/header", type_name="std_msgs/msg/Header")
        for stamp in range(2, 102):
            writer.write("/impacts", stamp, event(stamp))
        writer.flush()
        (file,) = bag.iterdir()
        data = file.read_bytes()
    assert REINDEXED.fullmatch(file.name)
    found = records(data)
    schemas = {each.id: each for each in found if isinstance(each, Schema)}
    channels = {each.id: each for each in found if isinstance(each, Channel)}
    assert log_times(data) == [*range(1, 102)]
    assert {each.message_encoding for each in channels.values()} == {"cdr"}
    for channel in channels.values():
        name = schemas[channel.schema_id].name
        assert channel.metadata["topic_type_hash"].startswith("RIHS01_")
        assert channel.metadata["topic_type_hash"][7:] == HASHES.get(
            name, channel.metadata["topic_type_hash"][7:]
        )
        assert channel.metadata["offered_qos_profiles"].startswith("- ")
    assert HASHES.keys() <= {schemas[each.schema_id].name for each in channels.values()}


def test_a_disk_that_fills_up_is_reported_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the flush, and by the end of the bag."""

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    writer = BagWriter(tmp_path / "bag")
    writer.write("/impacts", 1, event(1))
    monkeypatch.setattr(os, "fsync", full)
    for last in (writer.flush, writer.close):
        with pytest.raises(BagError, match="bag: cannot be written: No space left on device"):
            last()


def flushed(bag: Path, count: int) -> list[int]:
    """Write a bag of events in a chunk each; the sizes of the file after each."""
    sizes = []
    with BagWriter(bag) as writer:
        for stamp in range(1, count + 1):
            writer.write("/impacts", stamp, event(stamp))
            writer.flush()
            sizes.append((bag / "bag_0.mcap").stat().st_size)
    return sizes


def test_a_file_without_an_end_is_read_with_one_warning(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The events are those of whole chunks, wherever the file ends; zeros behind do no harm."""
    bag, file = tmp_path / "bag", tmp_path / "bag" / "bag_0.mcap"
    sizes = flushed(bag, 10)
    data = file.read_bytes()
    (bag / "metadata.yaml").unlink()
    ends = [(end, 0) for end in range(sizes[0], len(data) - 8, 501)] + [(sizes[4], 4096)]
    for end, zeros in ends:
        file.write_bytes(data[:end] + bytes(zeros))
        with BagReader(bag) as reader:
            assert not reader.is_whole
            assert reader.topics["/impacts"].quality == interfaces.EVENTS
            count = sum(size <= end for size in sizes)
            assert [each.stamp for each in reader.events()] == [*range(1, count + 1)]
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith(f"warning: {bag}: ")


def test_a_whole_file_without_metadata_is_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nothing is lost, and there is no warning."""
    bag = tmp_path / "bag"
    flushed(bag, 10)
    (bag / "metadata.yaml").unlink()
    with BagReader(bag) as reader:
        assert [each.stamp for each in reader.events()] == [*range(1, 11)]
    assert not capsys.readouterr().err


def test_a_damaged_chunk_names_the_command_that_recovers(tmp_path: Path) -> None:
    """A flipped bit in a chunk is found by its checksum, in a file with and without an end."""
    bag = tmp_path / "bag"
    flushed(bag, 10)
    data = bytearray((bag / "bag_0.mcap").read_bytes())
    data[data.rindex(b"stop", 0, len(data) // 3)] ^= 1
    for size in (len(data), len(data) // 2):
        (bag / "bag_0.mcap").write_bytes(data[:size])
        with (
            pytest.raises(BagError, match=r"`mcap recover .*bag_0\.mcap"),
            BagReader(bag) as reader,
        ):
            list(reader.events())
