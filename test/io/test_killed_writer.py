# SPDX-License-Identifier: Apache-2.0
"""A bag whose writer never ended: what is on the disk, and who can read it."""

import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from io import BytesIO
from pathlib import Path

import pytest
from mcap.exceptions import EndOfFile
from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from impact_observer.check.salvage import Salvage, salvage
from impact_observer.errors import BagError, UsageError
from impact_observer.events import ImpactEvent, Switch
from impact_observer.io import BagReader, BagWriter
from impact_observer.io.messages import bag_messages

MAKE = bag_messages()
PATIENCE = 90.0
"""How long a slow machine may take, s."""
REINDEXED = re.compile(r".+_(\d+)\.([a-zA-Z0-9])+")
"""Files that ``ros2 bag reindex`` of Jazzy takes (rosbag2_cpp, reindexer.cpp)."""
HASHES = {
    "std_msgs/msg/String": "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    "std_msgs/msg/Header": "f49fb3ae2cf070f793645ff749683ac6b06203e41c891e17701b1cb597ce6a01",
}
"""Type hashes of the packages of Jazzy (share/PACKAGE/msg/NAME.json)."""
WRITE = """
import sys, time
from impact_observer.events import ImpactEvent, Switch
from impact_observer.io import BagWriter
from impact_observer.io.messages import bag_messages
make, stamp = bag_messages(), 0
with BagWriter(sys.argv[1], flush=0.2) as writer:
    while True:
        stamp += 1
        writer.write("/impacts", stamp, make.event(ImpactEvent(stamp, (Switch("stop"),), stamp)))
        print(stamp, time.monotonic(), flush=True)
        time.sleep(0.01)
"""


def event(stamp: int) -> object:
    """A message of an event."""
    return MAKE.event(ImpactEvent(stamp, (Switch("stop"),), stamp))


def salvaged(bag: Path) -> list[int]:
    """The stamps of the events that a salvage brings back; none where nothing can be read."""
    new = bag.with_name(f"{bag.name}_new")
    try:
        salvage(Salvage(bag), new)
    except BagError:
        return []
    with BagReader(new) as reader:  # the first flush may come before the first event
        stamps = [each.stamp for each in reader.events()] if "/impacts" in reader.topics else []
    shutil.rmtree(new)
    return stamps


def records(data: bytes, *, whole_chunks: bool = False) -> list[McapRecord]:
    """The records of a file from its beginning, up to where it ends too early."""
    found: list[McapRecord] = []
    with suppress(EndOfFile):
        found.extend(StreamReader(BytesIO(data), emit_chunks=whole_chunks).records)
    return found


def chunks(data: bytes) -> list[Chunk]:
    """The chunks of a file from its beginning, up to where it ends too early."""
    return [each for each in records(data, whole_chunks=True) if isinstance(each, Chunk)]


def wait(done: Callable[[], object]) -> None:
    """Wait until a condition holds."""
    latest = time.monotonic() + PATIENCE
    while not done():
        assert time.monotonic() < latest, "it never came"
        time.sleep(0.01)


def test_an_event_is_on_the_disk_though_no_message_follows(tmp_path: Path) -> None:
    """Another library reads the event from a whole chunk of the open file."""
    file = tmp_path / "bag" / "bag_0.mcap"

    def log_times() -> list[int]:
        return [each.log_time for each in records(file.read_bytes()) if isinstance(each, Message)]

    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/impacts", 7, event(7))
        wait(log_times)
        assert log_times() == [7]


def test_flush_of_the_library_ends_a_chunk_with_a_message_and_no_other(tmp_path: Path) -> None:
    """The messages that a killed recorder leaves rest on this method of ``mcap``."""
    path = tmp_path / "file.mcap"
    with path.open("xb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start("ros2")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        channel = writer.register_channel("/a", "cdr", schema)
        writer.flush()  # type: ignore[no-untyped-call]
        assert not chunks(path.read_bytes())
        for count in (1, 2, 3):
            writer.add_message(channel, count, b"text", count)
            writer.flush()  # type: ignore[no-untyped-call]
            writer.flush()  # type: ignore[no-untyped-call]
            written = chunks(path.read_bytes())
            assert [each.message_start_time for each in written] == [*range(1, count + 1)]
            assert all(each.uncompressed_crc for each in written)


@pytest.mark.slow
def test_one_event_is_on_the_disk_without_another(tmp_path: Path) -> None:
    """A copy of the open bag has the event, although its chunk is not full."""
    file = tmp_path / "bag" / "bag_0.mcap"
    with BagWriter(tmp_path / "bag", flush=0.02) as writer:
        for stamp in (1, 2, 3):
            before = file.stat().st_size
            writer.write("/impacts", stamp, event(stamp))
            wait(lambda before=before: file.stat().st_size > before)  # type: ignore[misc]
            wait(lambda stamp=stamp: salvaged(tmp_path / "bag") == [*range(1, stamp + 1)])  # type: ignore[misc]
    assert salvaged(tmp_path / "bag") == [1, 2, 3]


@pytest.mark.slow
def test_a_killed_writer_loses_less_than_a_second(tmp_path: Path) -> None:
    """After SIGKILL every event older than a second is salvaged."""
    command = [sys.executable, "-c", WRITE, str(tmp_path / "bag")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        written = [process.stdout.readline().split() for _ in range(150)]
        process.send_signal(signal.SIGKILL)
        killed = time.monotonic()
        written += [line.split() for line in process.stdout]
    due = [int(stamp) for stamp, at in written if float(at) < killed - 1]
    stamps = salvaged(tmp_path / "bag")
    assert stamps == [*range(1, len(stamps) + 1)]
    assert 0 < len(due) <= len(stamps) <= len(written) + 1


@pytest.mark.slow
def test_events_that_come_one_by_one_are_salvaged_wherever_the_file_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each of 6000 events is flushed alone at 1 Hz; only events in the cut-off part are lost."""
    monkeypatch.setattr(os, "fsync", lambda _: None)
    sizes = []
    bag = tmp_path / "bag"
    with BagWriter(bag, flush=1.0) as writer:
        for second in range(1, 6001):
            writer.write("/impacts", second * 1_000_000_000, event(second))
            writer.flush()
            sizes.append((bag / "bag_0.mcap").stat().st_size)
    data = (bag / "bag_0.mcap").read_bytes()
    assert len(data) < 6000 * 500
    (bag / "metadata.yaml").unlink()
    for cut in (sizes[5999], sizes[4999] + 7, sizes[9]):
        (bag / "bag_0.mcap").write_bytes(data[:cut])
        count = sum(size <= cut for size in sizes)
        assert salvaged(bag) == [*range(1, count + 1)]


def test_what_is_flushed_is_on_the_disk_and_zeros_behind_it_do_no_harm(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After a loss of power a file has its synchronized part, and perhaps blocks of zeros."""
    synchronized: dict[str, int] = {}
    fsync = os.fsync

    def noted(descriptor: int) -> None:
        fsync(descriptor)
        name = Path(f"/proc/self/fd/{descriptor}").readlink().name
        synchronized[name] = os.fstat(descriptor).st_size

    monkeypatch.setattr(os, "fsync", noted)
    bag, lost = tmp_path / "bag", tmp_path / "lost"
    with BagWriter(bag, flush=1.0) as writer:
        assert {"bag", tmp_path.name, "bag_0.mcap"} <= synchronized.keys()
        for stamp in range(1, 101):
            writer.write("/impacts", stamp, event(stamp))
        writer.flush()
        lost.mkdir()
        data = (bag / "bag_0.mcap").read_bytes()[: synchronized["bag_0.mcap"]]
    assert synchronized["metadata.yaml"] == (bag / "metadata.yaml").stat().st_size
    (lost / "lost_0.mcap").write_bytes(data + bytes(4096))
    assert salvaged(lost) == [*range(1, 101)]


def test_reindexing_finds_all_it_needs_in_the_chunks(tmp_path: Path) -> None:
    """Another library finds the file's name, types with hashes, qualities and messages.

    ``ros2 bag reindex`` reads the records from the beginning where there is no index, up to the
    first that is cut short.
    """
    bag = tmp_path / "bag"
    with BagWriter(bag, flush=0.02) as writer:
        writer.write("/plant/model", 1, MAKE.model("x"))
        writer.declare("/header", type_name="std_msgs/msg/Header")
        for stamp in range(2, 102):
            writer.write("/impacts", stamp, event(stamp))
        wait(lambda: salvaged(bag) == [*range(2, 102)])
        (file,) = bag.iterdir()
        data = file.read_bytes()
    assert REINDEXED.fullmatch(file.name)
    found = records(data)
    schemas = {each.id: each for each in found if isinstance(each, Schema)}
    channels = {each.id: each for each in found if isinstance(each, Channel)}
    times = [each.log_time for each in found if isinstance(each, Message)]
    assert times == [*range(1, 102)]
    assert {each.message_encoding for each in channels.values()} == {"cdr"}
    for channel in channels.values():
        name = schemas[channel.schema_id].name
        assert channel.metadata["topic_type_hash"].startswith("RIHS01_")
        assert channel.metadata["topic_type_hash"][7:] == HASHES.get(
            name, channel.metadata["topic_type_hash"][7:]
        )
        assert channel.metadata["offered_qos_profiles"].startswith("- ")
    assert HASHES.keys() <= {schemas[each.schema_id].name for each in channels.values()}


def test_a_disk_that_fills_up_between_two_messages_is_reported_by_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The report is one line, though no further batch of messages is full."""
    failed = threading.Event()

    def full(_: int) -> None:
        failed.set()
        raise OSError(28, "No space left on device")

    writer = BagWriter(tmp_path / "bag", flush=0.02)
    writer.write("/impacts", 1, event(1))
    monkeypatch.setattr(os, "fsync", full)

    def write_until_refused() -> None:
        latest = time.monotonic() + PATIENCE
        while time.monotonic() < latest:
            writer.write("/impacts", 2, event(2))
            time.sleep(0.01)

    with pytest.raises(BagError, match="bag: cannot be written: No space left on device"):
        write_until_refused()
    assert failed.is_set()
    with pytest.raises(BagError, match="No space left"):
        writer.close()


@pytest.mark.parametrize("flush", [0.0, 1.5, float("nan"), float("inf")])
def test_flushing_less_than_once_a_second_is_refused(tmp_path: Path, flush: float) -> None:
    """A refused writer creates no file."""
    with pytest.raises(UsageError, match=r"flush is \S+; expected more than 0, at most 1 s"):
        BagWriter(tmp_path / "bag", flush=flush)
    assert list(tmp_path.iterdir()) == []
