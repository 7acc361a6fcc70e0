"""Chunks of MCAP files, read and written many messages at a time: as ``rosbags`` does it."""

from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader, StoragePlugin, Writer

from impact_observer.errors import BagError
from impact_observer.io import BagReader, interfaces
from impact_observer.io import batch_writer as together_module
from impact_observer.io.batch_writer import write_together
from impact_observer.io.chunks import index_of
from impact_observer.io.typestores import new_typestore

TOPICS = ("/a", "/b", "/c")


def some(count: int, seed: int) -> list[tuple[str, int, bytes]]:
    """Messages of three topics whose log times go back by as much as 50 ms, some of them equal."""
    random = np.random.default_rng(seed)
    times = np.sort(random.integers(1, 1000, count)) + random.integers(0, 50, count)
    return [
        (
            TOPICS[random.integers(3)],
            int(time) * 1_000_000,
            random.bytes(int(random.integers(4, 900))),
        )
        for time in times
    ]


def open_writer(path: Path) -> tuple[Writer, dict[str, Connection]]:
    """A writer of ``rosbags`` and its topics."""
    writer, store = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP), new_typestore()
    writer.open()
    return writer, {
        topic: writer.add_connection(topic, interfaces.STRING, typestore=store) for topic in TOPICS
    }


def written(path: Path, messages: list[tuple[str, int, bytes]], sizes: list[int]) -> list[bytes]:
    """The files of a bag into which messages came so many at a time; one by one if not told."""
    writer, topics = open_writer(path)
    items = [(topics[topic], log_time, data) for topic, log_time, data in messages]
    if not sizes:
        for item in items:
            writer.write(*item)
    for begin, end in zip(
        np.cumsum([0, *sizes]).tolist(), np.cumsum(sizes).tolist(), strict=False
    ):
        write_together(writer, items[begin:end])
    writer.close()
    return [file.read_bytes() for file in sorted(path.iterdir())]


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
    "sizes",
    [
        pytest.param([6000], marks=pytest.mark.slow),
        [1, 256, 0, 1000, 4743],
        pytest.param([100] * 60, marks=pytest.mark.slow),
    ],
)
def test_file_is_that_of_rosbags_in_every_byte(tmp_path: Path, sizes: list[int]) -> None:
    """However many come at a time, across several chunks."""
    messages = some(6000, seed=1)
    (tmp_path / "one").mkdir()
    (tmp_path / "many").mkdir()
    one = written(tmp_path / "one" / "bag", messages, [])
    assert written(tmp_path / "many" / "bag", messages, sizes) == one
    index = index_of(tmp_path / "one" / "bag" / "bag.mcap")
    assert index is not None
    assert len(index.chunk_indexes) > 2


def test_message_larger_than_a_chunk_is_written_as_by_rosbags(tmp_path: Path) -> None:
    """It ends the chunk that it comes into; the next begins anew."""
    messages = [("/a", k, bytes(size)) for k, size in enumerate([4, 3 << 20, 5, 2 << 20, 1 << 20])]
    (tmp_path / "one").mkdir()
    (tmp_path / "many").mkdir()
    one = written(tmp_path / "one" / "bag", messages, [])
    assert written(tmp_path / "many" / "bag", messages, [5]) == one


def test_rosbags_writes_itself_where_its_chunks_are_not_as_we_know_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another version may keep them otherwise."""
    monkeypatch.setattr(together_module, "_OF_CHUNK", ("something else",))
    messages = some(50, seed=2)
    written(tmp_path / "bag", messages, [50])
    assert sorted(by_rosbags(tmp_path / "bag")) == sorted(messages)


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
    """Of chunks that reach into each other, with equal log times, compressed or not."""
    path = mcap(tmp_path / "bag.mcap", some(2000, seed=3), compression)
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
    """No message is made up of what lies behind it."""
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
