# SPDX-License-Identifier: Apache-2.0
"""Damaged bags: the findings of ``check``, and what ``salvage`` recovers."""

import random
import re
import shutil
import sqlite3
from pathlib import Path

import pytest
import zstandard
from faulty_bags import GOOD, MAKE, S, model, state
from foreign_bags import bare, humble_sqlite, mcap_folder, rewritten
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.rosbag2 import CompressionMode, StoragePlugin, Writer
from systems import examples

from impact_observer.check.bag_check import check_bag
from impact_observer.check.salvage import Salvage, salvage
from impact_observer.cli.main import main
from impact_observer.errors import BagError, UsageError
from impact_observer.io import BagReader, BagWriter, decompression, interfaces
from impact_observer.io.mcap_checksums import data_are_damaged
from impact_observer.io.reader import RawMessage
from impact_observer.stamps import text


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model, 400 states and the impacts among them."""
    path = tmp_path_factory.mktemp("salvage") / "own"
    with BagWriter(path) as writer:
        writer.write("/plant/model", S, MAKE.model(model()))
        for k in range(400):
            writer.write("/plant/joint_states", S + k * 20_000_000, state(S + k * 20_000_000))
            if k % 50 == 49 and k // 50 < len(GOOD):
                event = GOOD[k // 50]
                writer.write("/impacts", event.stamp, MAKE.event(event))
    return path


pytestmark = pytest.mark.usefixtures("in_tmp_path")


def messages(path: Path) -> list[RawMessage]:
    """All messages of a whole bag."""
    with BagReader(path) as reader:
        return list(reader.raw())


def cut(path: Path, share: float) -> int:
    """Cut a file short, and return its new size."""
    data = path.read_bytes()
    path.write_bytes(data[: round(share * len(data))])
    return path.stat().st_size


def flip(path: Path, at: int, mask: int = 0x55) -> None:
    """Change a byte of a file."""
    data = bytearray(path.read_bytes())
    data[at] ^= mask
    path.write_bytes(data)


def lines(path: Path) -> list[str]:
    """The findings of a bag that no observer can use."""
    report = check_bag(path)
    assert not report.usable
    return [f"{each.severity} {each.line}" for each in report.findings]


def salvaged_count(path: Path, whole: Path) -> int:
    """Number of messages that a salvage recovers, each of them unharmed."""
    salvage(Salvage(path), Path("new"))
    again, all_ = messages(Path("new")), set(messages(whole))
    assert set(again) <= all_
    assert len(again) == len(set(again))
    shutil.rmtree("new")
    return len(again)


def readable(path: Path) -> dict[str, int]:
    """Number of readable messages of each topic."""
    source = Salvage(path)
    assert len(list(source.raw())) == sum(source.counts.values())
    return source.counts


def chunks(path: Path) -> list[int]:
    """Offsets of the chunks in an MCAP file."""
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    return [each.chunk_start_offset for each in summary.chunk_indexes]


REMEDY = "write them to a new bag with `impact-observer check bag --salvage -o NEW`"


@pytest.mark.slow
@pytest.mark.parametrize("compression", ["", "zstd", "lz4"])
def test_mcap_that_was_cut_in_a_chunk(whole: Path, compression: str) -> None:
    """Every message before the cut is recovered, the messages of the open chunk too."""
    bag = mcap_folder(whole, Path("bag"), distro="jazzy", compression=compression, chunk=10_000)
    size = cut(bare(bag), 0.5)
    counts = readable(bag)
    last = max(raw.log_time for raw in Salvage(bag).raw())
    printed = lines(bag)
    assert printed[0] == (
        f"error bag: cannot be read as a bag: File end magic is invalid; {sum(counts.values())}"
        f" messages, up to {text(last)} s, can be read: {REMEDY}"
    )
    assert f"warning bag_0.mcap: was cut short at byte {size}" in printed
    assert salvaged_count(bag, whole) == sum(counts.values()) > 120


def test_mcap_whose_recorder_was_killed(whole: Path) -> None:
    """The file ends after a chunk, without index and metadata."""
    bag = mcap_folder(whole, Path("bag"), distro="jazzy", chunk=10_000)
    (bag / "metadata.yaml").unlink()
    third = chunks(bare(bag))[2]
    bare(bag).write_bytes(bare(bag).read_bytes()[:third])
    assert lines(bag) == [
        f"error bag: no metadata.yaml; 147 messages, up to 3.860000000 s, can be read: {REMEDY}",
        f"warning bag_0.mcap: was cut short at byte {third}",
        "note /impacts: 2 messages can be read, up to 3.000000000 s",
        "note /plant/joint_states: 144 messages can be read, up to 3.860000000 s",
        "note /plant/model: 1 message can be read, up to 1.000000000 s",
    ]
    assert salvaged_count(bag, whole) == 147


def test_mcap_with_a_broken_chunk(whole: Path) -> None:
    """The broken chunk is left out, since any of its messages may be wrong."""
    bag = mcap_folder(whole, Path("bag"), distro="jazzy", chunk=10_000)
    second = chunks(bare(bag))[1]
    flip(bare(bag), second + 3000)
    printed = lines(bag)
    assert printed[0].startswith("error bag: cannot be read as a bag: Chunk checksum mismatch; ")
    assert printed[1:3] == [
        (
            f"warning bag_0.mcap: the chunk at byte {second} does not match its checksum, and is"
            " left out: 85 messages in 1.66 s from 2.200000000 s"
        ),
        (
            "warning /impacts: 1 event missing by the sequence numbers, the first is number 2,"
            " before 4.000000000 s; record with reliable quality of service and a depth of 2000"
        ),
    ]
    assert salvaged_count(bag, whole) == len(messages(whole)) - 85


def test_a_flipped_bit_in_our_own_bag_is_noticed(whole: Path) -> None:
    """Reader and check notice the bit by the checksums of the chunks that this package writes."""
    shutil.copytree(whole, "bag")
    file = Path("bag") / "own_0.mcap"
    begin = chunks(file)[0]  # a slow machine ends a chunk early: the first may be small
    size = int.from_bytes(file.read_bytes()[begin + 9 + 16 : begin + 9 + 24], "little")
    flip(file, begin + 9 + 40 + size // 2, mask=1)
    with pytest.raises(BagError, match=r"bag: cannot be read as a bag: Chunk checksum mismatch"):
        messages(Path("bag"))
    report = check_bag(Path("bag"))
    assert not report.readable
    expected = f"own_0.mcap: the chunk at byte {begin} does not match its checksum"
    assert expected in report.findings[0].remedy


def test_no_flipped_bit_alters_what_is_read_or_salvaged(whole: Path) -> None:
    """Of 100 bags, each with one flipped bit: the messages are as before, or refused."""
    shutil.copytree(whole, "bag")
    file, draw = Path("bag") / "own_0.mcap", random.Random(7)
    before, data = messages(whole), file.read_bytes()
    refused, left = 0, []
    for _ in range(100):
        at, bit = draw.randrange(len(data)), draw.randrange(8)
        file.write_bytes(data[:at] + bytes([data[at] ^ 1 << bit]) + data[at + 1 :])
        try:
            assert messages(Path("bag")) == before
            with file.open("rb") as stream:
                assert data_are_damaged(stream)
        except BagError:
            refused += 1
        source = Salvage(Path("bag"))
        left.append(set(source.raw()))
        assert left[-1] <= set(before)
        assert len(left[-1]) == len(before) or source.losses
    assert refused > 70
    assert max(map(len, left)) == len(before)


def test_a_chunk_that_turns_into_the_end_of_the_file_is_read(whole: Path) -> None:
    """One bit makes a footer of a chunk; the index says that it is a chunk."""
    bag = mcap_folder(whole, Path("bag"), distro="jazzy", chunk=10_000)
    flip(bare(bag), chunks(bare(bag))[1], mask=0x06 ^ 0x02)
    assert salvaged_count(bag, whole) == len(messages(whole))


def test_a_damaged_index_is_refused_and_not_needed(whole: Path) -> None:
    """Another quality of service in the index would be read without a word."""
    shutil.copytree(whole, "bag")
    file = Path("bag") / "own_0.mcap"
    flip(file, file.read_bytes().rindex(b"reliable"), mask=1)
    fault = "bag: cannot be read as a bag: the index of own_0.mcap does not match its checksum; "
    with pytest.raises(BagError, match=re.escape(fault)):
        BagReader("bag")
    assert salvaged_count(Path("bag"), whole) == len(messages(whole))


def test_a_bag_without_checksums_is_read(whole: Path) -> None:
    """As before; check says that there are none."""
    bag = mcap_folder(whole, Path("bag"), distro="jazzy", chunk=10_000)
    data = bytearray(bare(bag).read_bytes())
    for chunk in chunks(bare(bag)):
        data[chunk + 33 : chunk + 37] = bytes(4)
    data[-12:-8] = bytes(4)
    bare(bag).write_bytes(data)
    assert messages(bag) == messages(whole)
    printed = [f"{each.severity} {each.line}" for each in check_bag(bag).findings]
    count = len(chunks(bare(bag)))
    assert (
        f"note bag_0.mcap: {count} of {count} chunks without a checksum; flipped bits in messages"
        " go unnoticed" in printed
    )


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ("message_count: 400", "message_count: -400", "-400 messages on /plant/joint_states"),
        ("name: /impacts", "name: /imqacts", "/imqacts (impact_observer_msgs/msg/ImpactEvent)"),
    ],
)
def test_metadata_of_other_topics_than_the_files(
    whole: Path, old: str, new: str, fault: str
) -> None:
    """Topics that no file has, and counts that no bag has, are refused in one line."""
    bag = mcap_folder(whole, Path("bag"), distro="jazzy")
    metadata = bag / "metadata.yaml"
    metadata.write_text(metadata.read_text("utf-8").replace(old, new), "utf-8")
    with pytest.raises(BagError, match=re.escape(f"bag: its metadata.yaml has {fault}")):
        BagReader(bag)
    assert salvaged_count(bag, whole) == len(messages(whole))


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        (r"  files:\n(    .*\n)*", r"  files: NaN\n", "files: 'NaN'"),
        (r"\n  message_count: 406", "\n  message_count: .nan", "message_count: nan"),
        (r"message_count: 400", "message_count: .nan", "message_count: nan"),
        (r"(nanoseconds_since_epoch): \d+", r"\1: .nan", "start_time: nan"),
        (r"(nanoseconds): \d+", r"\1: 1.5", "duration: 2.5"),
        (r"message_count: 400", "message_count: x", "message_count: 'x'"),
    ],
)
def test_metadata_with_other_than_whole_numbers(
    whole: Path, old: str, new: str, fault: str
) -> None:
    """One line, before anything is made of them; salvage needs none of them."""
    bag = mcap_folder(whole, Path("bag"), distro="jazzy")
    metadata = bag / "metadata.yaml"
    text, count = re.subn(old, new, metadata.read_text("utf-8"))
    assert count
    metadata.write_text(text, "utf-8")
    with pytest.raises(BagError, match=re.escape(f"bag: its metadata.yaml has {fault}; expected")):
        BagReader(bag)
    assert salvaged_count(bag, whole) == len(messages(whole))


@pytest.mark.parametrize("column", ["timestamp", "data"])
def test_rows_of_a_database_that_are_no_messages(whole: Path, column: str) -> None:
    """sqlite3 takes text for a number: reading refuses such a row, salvage leaves it out."""
    bag = humble_sqlite(whole, Path("bag"))
    with sqlite3.connect(bare(bag)) as database:
        database.execute(f"UPDATE messages SET {column} = 'nan' WHERE id = 7")
    with pytest.raises(BagError, match=r"bag: /plant/joint_states has rows without a whole log"):
        messages(bag)
    source = Salvage(bag)
    assert len(list(source.raw())) == len(messages(whole)) - 1
    assert source.losses == ["/plant/joint_states: rows without a whole log time (ns) and bytes"]


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@pytest.mark.parametrize("has_index", [True, False])
def test_a_chunk_that_declares_gigabytes_is_not_decompressed(
    whole: Path, compression: str, *, has_index: bool
) -> None:
    """The size in chunk and index is refused in one line, before any memory is taken for it."""
    bag = mcap_folder(whole, Path("bag"), distro="jazzy", compression=compression, chunk=10_000)
    file = bare(bag)
    data, begin = bytearray(file.read_bytes()), chunks(file)[0]
    size = bytes(data[begin + 9 + 16 : begin + 9 + 24])
    data = data.replace(size, (2**35).to_bytes(8, "little"))
    data[-12:-8] = bytes(4)  # the checksum of the index
    if not has_index:
        data[-28:-12] = bytes(16)
    file.write_bytes(data)
    fault = r"declares 34359738368 bytes without its compression; expected at most 1073741824"
    with pytest.raises(BagError, match=fault):
        messages(bag)
    assert any(fault in each for each in lines(bag))


@pytest.mark.parametrize(
    ("end", "fault"), [(None, "has more than 100000 without"), (-8, "has no end")]
)
def test_a_compressed_message_of_gigabytes_or_without_an_end_is_one_line(
    whole: Path, monkeypatch: pytest.MonkeyPatch, end: int | None, fault: str
) -> None:
    """The message is refused before more memory is taken than the bound, and salvage goes on."""
    monkeypatch.setattr(decompression, "MOST_BYTES", 100_000)
    bag = rewritten(whole, Path("bag"), StoragePlugin.SQLITE3, CompressionMode.MESSAGE)
    bomb = zstandard.compress(bytes(100_001 if end is None else 1000))[:end]
    with sqlite3.connect(bare(bag)) as database:
        database.execute("UPDATE messages SET data = ? WHERE id = 7", (bomb,))
    with pytest.raises(BagError, match=fault):
        messages(bag)
    source = Salvage(bag)
    assert len(list(source.raw())) == len(messages(whole)) - 1
    (loss,) = source.losses
    assert loss.endswith("messages whose compression is damaged or too large")


def test_bytes_that_are_missing_in_a_chunk_without_an_end_alter_no_message(whole: Path) -> None:
    """What cannot be checked is named, and a message that lost bytes is left out."""
    bag, draw = mcap_folder(whole, Path("bag"), distro="jazzy", chunk=100_000), random.Random(3)
    file = bare(bag)
    data, begin, before = file.read_bytes(), chunks(file)[0], set(messages(whole))
    size = int.from_bytes(data[begin + 1 : begin + 9], "little")
    for _ in range(40):
        first, last = sorted(draw.randrange(begin + 5000, begin + size) for _ in range(2))
        file.write_bytes(data[:first] + data[last : begin + size])
        source = Salvage(bag)
        assert set(source.raw()) <= before
        unchecked = f"{source.counts.total()} messages of the chunk at byte {begin} cannot be"
        assert any(unchecked in each for each in source.losses)


@pytest.mark.slow
def test_mcap_with_broken_lengths_goes_on_at_the_next_chunk(whole: Path) -> None:
    """The index of the file has the place and the length of every chunk."""
    bag = mcap_folder(whole, Path("bag"), distro="jazzy", chunk=10_000)
    (bag / "metadata.yaml").unlink()
    _, second, third, *_ = chunks(bare(bag))
    flip(bare(bag), second + 7)
    data = bare(bag).read_bytes()
    size = int.from_bytes(data[second + 9 + 32 : second + 9 + 40], "little")
    flip(bare(bag), second + 9 + 40 + size + 7)  # of the message index behind the chunk
    damaged = f"is damaged from byte {second + 9 + 40 + size} to {third}"
    assert f"warning bag_0.mcap: {damaged}" in lines(bag)
    assert salvaged_count(bag, whole) == len(messages(whole))


def test_metadata_with_aliases_without_an_end(whole: Path) -> None:
    """The library would write them out in its error."""
    bag = mcap_folder(whole, Path("bag"), distro="jazzy")
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 12)]
    text = (bag / "metadata.yaml").read_text("utf-8")
    text = text.replace("storage_identifier: mcap", "storage_identifier: *a11")
    assert "*a11" in text
    (bag / "metadata.yaml").write_text("\n".join([*lines, text]), "utf-8")
    with pytest.raises(BagError, match=r"bag: its metadata.yaml: .*e\+12 values with its aliases"):
        BagReader(bag)
    assert salvaged_count(bag, whole) == len(messages(whole))


@pytest.mark.slow
def test_metadata_that_is_missing_or_wrong_loses_nothing(whole: Path) -> None:
    """The files hold all that is needed."""
    everything = (
        f"nothing seems to be lost; 406 messages, up to 8.980000000 s, can be read: {REMEDY}"
    )
    bag = mcap_folder(whole, Path("bag"), distro="jazzy")
    metadata = bag / "metadata.yaml"
    right = metadata.read_text("utf-8")
    metadata.write_text(right.replace("message_count: 400", "message_count: 401"), "utf-8")
    assert (
        lines(bag)[0] == f"error bag: 406 messages found, 407 promised by its index; {everything}"
    )
    metadata.write_text("{[", "utf-8")
    printed = lines(bag)[0]
    assert printed.startswith("error bag: cannot be read as a bag: Could not load YAML from bag/")
    assert printed.endswith(everything)
    metadata.unlink()
    assert lines(bag)[0] == f"error bag: no metadata.yaml; {everything}"
    assert salvaged_count(bag, whole) == 406


@pytest.mark.parametrize("damage", ["cut", "broken page"])
def test_damaged_database_names_the_command_that_recovers_it(
    whole: Path, damage: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Check, salvage and every command that opens the bag name the command."""
    bag = humble_sqlite(whole, Path("bag"))
    file = bare(bag)
    if damage == "cut":
        cut(file, 0.6)
    else:
        data = file.read_bytes()
        leaves = [at for at in range(4096, len(data), 4096) if data[at] == 0x0D]
        flip(file, leaves[len(leaves) // 2])
    recover = f"`sqlite3 {file} .recover | sqlite3 NEW.db3` writes what is left to a new file"
    malformed = f"Cannot open database {file}: database disk image is malformed"
    lost = f"bag_0.db3: damaged as an sqlite3 file; {recover}"
    assert lines(bag) == [
        f"error bag: cannot be read as a bag: {malformed}; nothing can be read: {lost}"
    ]
    with pytest.raises(BagError, match=r"bag: nothing can be read; bag_0\.db3: .* \.recover"):
        salvage(Salvage(bag), Path("new"))
    assert not Path("new").exists()
    assert main(["export", "bag", "-o", "out.csv"]) == 1
    (error,) = capsys.readouterr().err.splitlines()
    assert error == f"impact-observer: bag: cannot be read as a bag: {malformed}; {recover}"


def test_database_without_metadata_is_salvaged_whole(whole: Path) -> None:
    """No message is lost, since sqlite3 opens the database."""
    bag = humble_sqlite(whole, Path("bag"))
    (bag / "metadata.yaml").unlink()
    assert lines(bag)[0].startswith("error bag: no metadata.yaml; nothing seems to be lost; 406")
    assert salvaged_count(bag, whole) == 406


def test_journal_that_a_recorder_left_is_reported(whole: Path) -> None:
    """No reader uses the journal; the bag without the journal can be used."""
    bag = humble_sqlite(whole, Path("bag"))
    (bag / "bag_0.db3-wal").write_bytes(b"1234")
    report = check_bag(bag)
    assert report.usable
    assert [each.line for each in report.findings] == [
        (
            "bag_0.db3-wal: 4 bytes that are not in the database yet; put them in: sqlite3"
            " bag/bag_0.db3 'PRAGMA wal_checkpoint(TRUNCATE)'"
        )
    ]


def test_a_file_that_is_no_bag_is_named() -> None:
    """Nothing can be salvaged from a file that is no bag."""
    Path("notes.txt").write_text("none")
    Path("bag").mkdir()
    for path, expected in (
        ("notes.txt", "notes.txt: not a bag; nothing can be read: there is no .mcap or .db3 file"),
        ("bag", "bag: no metadata.yaml; nothing can be read: there is no .mcap or .db3 file"),
    ):
        assert lines(Path(path)) == [f"error {expected}"]
        with pytest.raises(BagError, match=r"nothing can be read; there is no \.mcap"):
            salvage(Salvage(Path(path)), Path("new"))
        assert not Path("new").exists()
    Path("x.mcap").write_bytes(b"")
    Path("x.db3").write_bytes(b"SQLite format 4\0" * 100)
    assert lines(Path("x.mcap")) == [
        (
            "error x.mcap: cannot be read as a bag: File 'x.mcap' seems to be empty; nothing can"
            " be read: x.mcap: does not begin as an MCAP file"
        )
    ]
    assert "x.db3: file is not a database; nothing can be" in lines(Path("x.db3"))[0]
    with pytest.raises(UsageError, match=r"absent: does not exist"):
        Salvage(Path("absent"))


def test_other_definitions_and_unknown_types_are_named() -> None:
    """The first would be read as something else, the second not at all."""
    with Writer(Path("bag"), version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection(
            "/impacts", interfaces.IMPACT_EVENT, msgdef="int32 data\n", rihs01="RIHS01_0"
        )
        writer.write(connection, 1, b"\x00\x01\0\0\1\0\0\0")
    assert lines(Path("bag"))[0] == (
        "error /impacts: the bag defines impact_observer_msgs/msg/ImpactEvent otherwise than this"
        " package; expected the same fields; read it with the version that made it"
    )


def test_type_without_a_definition_is_left_out_of_a_new_bag(whole: Path) -> None:
    """An old database has no definitions."""
    bag = humble_sqlite(whole, Path("bag"))
    with sqlite3.connect(bare(bag)) as database:
        database.execute("UPDATE topics SET type = 'rig/msg/X' WHERE name = '/plant/model'")
    metadata = (bag / "metadata.yaml").read_text("utf-8")
    (bag / "metadata.yaml").write_text(metadata.replace("std_msgs/msg/String", "rig/msg/X"))
    printed = "note bag: no definition of the messages on /plant/model (rig/msg/X); they can be"
    assert any(line.startswith(printed) for line in lines(bag))
    (loss,) = salvage(Salvage(bag), Path("new"))
    assert loss.startswith("/plant/model is left out: ")
    assert len(messages(Path("new"))) == 405


@pytest.mark.slow
@settings(examples(25), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    flips=st.lists(st.tuples(st.floats(0, 1), st.integers(1, 255)), max_size=3),
    keep=st.floats(0, 1) | st.just(1.0),
    kind=st.sampled_from(["mcap", "zstd", "message", "db3"]),
)
def test_no_damage_is_ever_a_traceback(
    whole: Path, flips: list[tuple[float, int]], keep: float, kind: str
) -> None:
    """Check always prints findings, each one line; salvage reads what it can."""
    shutil.rmtree("bag", ignore_errors=True)
    if kind == "db3":
        bag = humble_sqlite(whole, Path("bag"))
    elif kind == "message":
        bag = rewritten(whole, Path("bag"), StoragePlugin.MCAP, CompressionMode.MESSAGE)
    else:
        packed = kind if kind == "zstd" else ""
        bag = mcap_folder(whole, Path("bag"), distro="jazzy", compression=packed, chunk=10_000)
    file = bare(bag)
    for where, mask in flips:
        flip(file, round(where * (file.stat().st_size - 1)), mask)
    cut(file, keep)
    report = check_bag(bag)
    assert report.readable or not report.usable
    assert all("\n" not in each.line for each in report.findings)
    readable(bag)
