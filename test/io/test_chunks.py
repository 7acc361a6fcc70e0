# SPDX-License-Identifier: Apache-2.0
"""Reading the chunks of MCAP files: the same messages in the same order as ``rosbags``."""

from pathlib import Path

import pytest
from foreign_bags import TOPICS, random_messages
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import Reader

from impact_observer.errors import BagError
from impact_observer.io import BagReader, interfaces
from impact_observer.io.chunks import index_of


def mcap(path: Path, messages: list[tuple[str, int, bytes]], compression: CompressionType) -> Path:
    """A bare MCAP file of small chunks, as another program writes it."""
    with path.open("wb") as file:
        writer = McapWriter(file, chunk_size=20_000, compression=compression)
        writer.start("ros2")
        schema = writer.register_schema(interfaces.STRING, "ros2msg", b"string data\n")
        channels = {topic: writer.register_channel(topic, "cdr", schema) for topic in TOPICS}
        for topic, time, data in messages:
            writer.add_message(channels[topic], time, data, time)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def by_rosbags(path: Path, start: int | None = None) -> list[tuple[str, int, bytes]]:
    """The messages as ``rosbags`` reads them."""
    with Reader(path) as reader:
        return [(c.topic, time, data) for c, time, data in reader.messages(start=start)]


@pytest.mark.parametrize(
    "compression",
    [
        pytest.param(each, marks=pytest.mark.slow if each is CompressionType.NONE else (), id=name)
        for name, each in CompressionType.__members__.items()
    ],
)
@pytest.mark.parametrize("start", [0, 500_000_000])
def test_order_is_that_of_rosbags(
    tmp_path: Path, compression: CompressionType, start: int
) -> None:
    """Of chunks that overlap in time, with equal log times, compressed or not."""
    path = mcap(tmp_path / "bag.mcap", random_messages(2000, seed=3), compression)
    assert index_of(path) is not None
    with BagReader(path) as reader:
        assert [*reader.raw(start=start)] == by_rosbags(path, start or None)
        two = [each for each in by_rosbags(path) if each[0] != "/b"]
        assert [*reader.raw(["/a", "/c"])] == two


def test_file_without_index_is_read_by_rosbags(tmp_path: Path) -> None:
    """A file of a program that writes none."""
    path = tmp_path / "bag.mcap"
    messages = [("/a", k, bytes([k])) for k in range(1, 9)]
    with path.open("wb") as file:
        writer = McapWriter(file, use_chunking=False)
        writer.start("ros2")
        schema = writer.register_schema(interfaces.STRING, "ros2msg", b"string data\n")
        channel = writer.register_channel("/a", "cdr", schema)
        for _, time, data in messages:
            writer.add_message(channel, time, data, time)
        writer.finish()  # type: ignore[no-untyped-call]
    assert index_of(path) is None
    with BagReader(path) as reader:
        assert [*reader.raw()] == messages


def test_record_that_does_not_fit_its_chunk_is_one_line(tmp_path: Path) -> None:
    """No message is made of the bytes behind it."""
    path = mcap(tmp_path / "bag.mcap", [("/a", 7, b"x" * 100)], CompressionType.NONE)
    data = bytearray(path.read_bytes())
    at = data.index(b"x" * 100) - 31
    data[at + 1 : at + 9] = (122 + 5).to_bytes(8, "little")
    head = data.index(b"\x06", 8)
    crc = head + 9 + 24
    data[crc : crc + 4] = bytes(4)
    path.write_bytes(data)
    with BagReader(path) as reader, pytest.raises(BagError, match=r"beyond the end of its chunk"):
        list(reader.raw())
