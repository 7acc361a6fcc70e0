# SPDX-License-Identifier: Apache-2.0
"""Files that are taken for bags: of ROS 1, of JSON, without a schema; pointers of Git LFS."""

import json
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest
from foreign_bags import bare, humble_sqlite
from mcap.writer import Writer as McapFileWriter
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.typesys import Stores, get_typestore

from impact_observer.cli.main import main
from impact_observer.io import BagReader
from impact_observer.io.recordings import events_in

MS = 1_000_000
HITS = (500, 1300, 1900)  # ms after the start
START = 1_000_000_000
LFS = "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n"
BOOL = "module std_msgs { module msg { struct Bool { boolean data; }; }; };"
JSON_SCHEMA = json.dumps({"type": "object", "properties": {"data": {"type": "boolean"}}})

Schema = tuple[str, str, str]
"""Name, encoding and text."""


def cdr(closed: bool) -> bytes:
    """A ``std_msgs/Bool`` of ROS 2."""
    return b"\0\1\0\0" + bytes([closed])


def as_json(closed: bool) -> bytes:
    """The same as JSON."""
    return json.dumps({"data": closed}).encode()


def mcap(
    path: Path,
    profile: str,
    *topics: tuple[str, Schema | None, str, Callable[[bool], bytes]],
) -> Path:
    """A file of switches that are closed for 5 ms at each hit, in some encodings."""
    with path.open("wb") as file:
        writer = McapFileWriter(file)
        writer.start(profile=profile, library="test")
        channels = []
        for topic, schema, encoding, make in topics:
            number = 0
            if schema is not None:
                name, kind, text = schema
                number = writer.register_schema(name=name, encoding=kind, data=text.encode())
            channel = writer.register_channel(
                topic=topic, message_encoding=encoding, schema_id=number
            )
            channels.append((channel, make))
        for k in range(2000):
            closed = any(hit <= k < hit + 5 for hit in HITS)
            for channel, make in channels:
                at = START + k * MS
                writer.add_message(channel, log_time=at, publish_time=at, data=make(closed))
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def said_by(capsys: pytest.CaptureFixture[str]) -> str:
    """Everything that was printed, without line ends."""
    out, err = capsys.readouterr()
    return " ".join((out + err).split())


def ros1(path: Path) -> Path:
    """A ROS 1 bag with a switch."""
    store = get_typestore(Stores.ROS1_NOETIC)
    kind = "std_msgs/msg/Bool"
    with Ros1Writer(path) as writer:
        topic = writer.add_connection("/switch", kind, typestore=store)
        for k in range(3):
            message = store.types[kind](data=k == 1)
            writer.write(topic, START + k * MS, store.serialize_ros1(message, kind))
    return path


def pointer(path: Path) -> Path:
    """A pointer of Git LFS, which stands for a file that was not fetched."""
    path.write_text(LFS)
    return path


ROS1_SCHEMA = ("std_msgs/Bool", "ros1msg", "bool data\n")
SWITCH_SCHEMA = ("Switch", "jsonschema", JSON_SCHEMA)
FOREIGN: dict[str, Callable[[Path], Path]] = {
    "ros1.bag": ros1,
    "ros1.mcap": lambda path: mcap(
        path, "ros1", ("/switch", ROS1_SCHEMA, "ros1", lambda on: bytes([on]))
    ),
    "json.mcap": lambda path: mcap(path, "", ("/switch", SWITCH_SCHEMA, "json", as_json)),
    "schemaless.mcap": lambda path: mcap(path, "", ("/switch", None, "json", as_json)),
    "pointer.mcap": pointer,
    "pointer.db3": pointer,
}
"""Files that are no bag of ROS 2."""


@pytest.mark.parametrize("name", FOREIGN)
def test_every_command_refuses_what_is_no_bag_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    """It names the file; ``check`` counts one error, and names what converts it."""
    path, output = FOREIGN[name](tmp_path / name), str(tmp_path / "out")
    for command in (
        ["export", str(path), "-o", f"{output}.csv"],
        ["detect", str(path), "--contact", "stop", "--topic", "/switch", "-o", output],
        ["observe", str(path), "--model", "two_mass", "--rate", "10", "-o", output],
    ):
        assert main(command) in {1, 2}
        (line,) = capsys.readouterr().err.splitlines()
        assert str(path) in line
    assert main(["check", str(path), "--model", "two_mass"]) == 1
    assert "1 error)" in (said := said_by(capsys))
    assert name.startswith("pointer") or "rosbags-convert" in said


@pytest.mark.parametrize("encoding", ["ros2idl", "omgidl"])
def test_a_definition_as_idl_is_that_of_the_message(tmp_path: Path, encoding: str) -> None:
    """A switch whose type is defined as IDL gives its impacts."""
    schema = ("std_msgs/msg/Bool", encoding, BOOL)
    path = mcap(tmp_path / "idl.mcap", "ros2", ("/switch", schema, "cdr", cdr))
    output = tmp_path / "out"
    given = ["--contact", "stop", "--topic", "/switch", "-o", str(output)]
    assert main(["detect", str(path), *given]) == 0
    with BagReader(output) as reader:
        assert [each.stamp for each in events_in(reader)] == [START + hit * MS for hit in HITS]


def test_messages_beside_those_of_ros_2_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Such a file is refused in one line."""
    bool_schema = ("std_msgs/msg/Bool", "ros2msg", "bool data\n")
    topics = (
        ("/switch", bool_schema, "cdr", cdr),
        ("/log", ("Switch", "jsonschema", JSON_SCHEMA), "json", as_json),
        ("/bare", None, "cdr", cdr),
    )
    path = mcap(tmp_path / "mixed.mcap", "ros2", *topics)
    assert main(["export", str(path), "-o", str(tmp_path / "out.csv")]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert str(path) in line


def test_the_converter_that_is_named_makes_a_bag_that_is_read(tmp_path: Path) -> None:
    """The three messages of a ROS 1 bag are those of the converted one."""
    program = Path(sys.executable).with_name("rosbags-convert")
    source, target = ros1(tmp_path / "old.bag"), tmp_path / "new"
    subprocess.run([program, "--src", source, "--dst", target], check=True)
    with BagReader(tmp_path / "new") as reader:
        messages = [(at, each.data) for at, each in reader.messages("/switch")]
    assert messages == [(START + k * MS, k == 1) for k in range(3)]


def reencoded(bag: Path, *, files: bool) -> Path:
    """A bag whose metadata.yaml, and whose files if wanted, name an encoding that is none."""
    described = bag / "metadata.yaml"
    text = described.read_text()
    described.write_text(text.replace("format: cdr", "format: wrong_format"))
    if files:
        with closing(sqlite3.connect(bare(bag))) as database:
            database.execute("UPDATE topics SET serialization_format = 'wrong_format'")
            database.commit()
    return bag


@pytest.mark.parametrize("files", [True, False])
def test_sqlite_messages_of_another_encoding_are_one_line(
    files: bool, sample_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whether the files or metadata.yaml alone name it."""
    bag = reencoded(humble_sqlite(sample_bag, tmp_path / "humble"), files=files)
    assert main(["export", str(bag), "-o", str(tmp_path / "out.csv")]) != 0
    (line,) = capsys.readouterr().err.splitlines()
    assert str(bag) in line
    assert main(["check", str(bag)]) != 0


def test_the_largest_time_of_sqlite_is_a_time(
    sample_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Beyond this integer sqlite3 counts in floats."""
    largest = 2**63 - 1
    path = bare(humble_sqlite(sample_bag, tmp_path / "humble"))
    with closing(sqlite3.connect(path)) as database:
        database.execute("UPDATE messages SET timestamp = ?", (largest,))
        database.commit()
    with BagReader(path) as reader:
        assert (reader.start, reader.end) == (largest, largest)
    main(["check", str(path)])
    assert "9223372036.854775807 s" in said_by(capsys)
