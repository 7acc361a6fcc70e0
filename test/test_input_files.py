# SPDX-License-Identifier: Apache-2.0
"""Whatever is named as an input: every command ends, with one line."""

import contextlib
import os
import sqlite3
from pathlib import Path

import pytest

from impact_observer.cli.main import main
from impact_observer.errors import ModelError
from impact_observer.model.files_beside import load_matrix

COMMANDS = {
    "a model": ["check-model", "{}"],
    "a model of a bag": ["check", "bag", "--model", "{}"],
    "a table": ["import", "{}.csv", "-o", "out"],
    "a signal": ["detect", "{}.csv", "--contact", "stop", "--threshold", "1", "-o", "out"],
    "a sound": ["detect", "{}.wav", "--contact", "stop", "--threshold", "1", "-o", "out"],
    "sensors": ["detect", "bag", "--sources", "{}", "-o", "out"],
    "an MCAP file": ["export", "{}.mcap", "-o", "out.csv"],
    "a database": ["observe", "{}.db3", "-o", "out"],
}


pytestmark = pytest.mark.usefixtures("in_tmp_path")


@pytest.mark.parametrize("what", COMMANDS)
@pytest.mark.parametrize("kind", ["pipe", "device", "loop", "long"])
def test_no_input_without_an_end_is_begun(
    what: str, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Pipes, devices, links in a circle and names that are too long: exit code 2, one line."""
    words = [each.format("a" * 5000 if kind == "long" else "input") for each in COMMANDS[what]]
    name = next(each for each in words if each.startswith(("input", "aaa")))
    match kind:
        case "pipe":
            os.mkfifo(name)
        case "device":
            Path(name).symlink_to("/dev/zero")
        case "loop":
            Path(name).symlink_to(name)
    assert main(words) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert len(error) < 500
    expected = {"pipe": "is a pipe; expected a regular file", "device": "is a device; expected"}
    assert expected.get(kind, "") in error


def test_a_file_that_the_kernel_makes_is_no_input(capsys: pytest.CaptureFixture[str]) -> None:
    """Some files in /proc are regular by name and never end."""
    Path("input").symlink_to("/proc/kmsg")
    assert main(["check-model", "input"]) == 2
    assert "is made by the kernel" in capsys.readouterr().err


def test_metadata_that_are_nested_without_an_end_are_one_line(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The library that reads ``metadata.yaml`` would end the process without a word."""
    Path("bag").mkdir()
    Path("bag/metadata.yaml").write_text("[\n" * 100_000, encoding="utf-8")
    assert main(["export", "bag", "-o", "out.csv"]) == 1
    assert capsys.readouterr().err.count("\n") == 1


def test_a_view_in_place_of_a_table_is_no_bag(capsys: pytest.CaptureFixture[str]) -> None:
    """A view may have rows without an end."""
    endless = "WITH RECURSIVE t(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM t) SELECT id FROM t"
    with contextlib.closing(sqlite3.connect("bag.db3")) as database:
        database.execute(f"CREATE VIEW topics AS {endless}")
    assert main(["export", "bag.db3", "-o", "out.csv"]) == 1
    assert "has a view topics; expected tables alone" in capsys.readouterr().err


def test_two_dashes_are_no_value(capsys: pytest.CaptureFixture[str]) -> None:
    """A parser of arguments takes ``--option=--`` for an empty list."""
    with pytest.raises(SystemExit) as end:
        main(["plot", "bag", "--select=--"])
    assert end.value.code == 2
    assert "--select=--: no value found" in capsys.readouterr().err


def test_files_of_a_bag_are_regular_ones(capsys: pytest.CaptureFixture[str]) -> None:
    """A pipe in the folder of a bag is refused by every command."""
    Path("bag").mkdir()
    os.mkfifo("bag/bag_0.mcap")
    Path("bag/metadata.yaml").write_text("{}", encoding="utf-8")
    for words in (
        ["export", "bag", "-o", "a.csv"],
        ["observe", "bag", "-o", "out"],
        ["check", "bag"],
    ):
        assert main(words) in (1, 2)
        assert "bag" in "".join(capsys.readouterr())


def npy(**header: object) -> bytes:
    """A file of numpy with a header of its own, and one number."""
    text = repr({"descr": "<f8", "fortran_order": False, "shape": (1,)} | header).encode()
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + bytes(8)


MATRIX = "%%MatrixMarket matrix coordinate real general\n"


@pytest.mark.parametrize(
    ("name", "content", "fault"),
    [
        ("m.npy", npy(shape=(10**11, 10**11)), "overflow"),
        ("m.npy", npy(shape=(10**6, 10**4)), "greater than file size"),
        ("m.npy", npy(descr="|O"), "Python objects in dtype"),
        ("m.npy", npy(shape=(-1, -1)), ""),
        ("m.npy", npy(shape="x"), "shape is not valid"),
        ("m.npy", b"", ""),
        ("m.npy", b"PK\x03\x04" + bytes(99), "magic string is not correct"),
        ("m.mtx", f"{MATRIX}100000000 100000000 0\n".encode(), "expected 2 x 2"),
    ],
)
def test_matrices_that_cannot_be(name: str, content: bytes, fault: str) -> None:
    """One line; no memory is asked for."""
    Path(name).write_bytes(content)
    with pytest.raises(ModelError) as caught:
        load_matrix("mass", name, Path(), (2, 2))
    assert fault in str(caught.value)
    assert str(caught.value).startswith(f"mass: {name} cannot be read: ")


def test_a_line_that_never_ends_is_no_table(capsys: pytest.CaptureFixture[str]) -> None:
    """The line of the error shows its beginning."""
    Path("long.csv").write_bytes(b"time\n0.5\n" + b"1" * 1_100_000)
    assert main(["import", "long.csv", "-o", "out"]) == 2
    error = capsys.readouterr().err
    assert "long.csv, line 3: '111" in error
    assert len(error) < 500


def test_a_time_of_day_of_any_length_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    """Python reads no whole number of 5000 digits."""
    for cell in ("9" * 5000 + ":00:00", "1e999999999", "1e-999999999", "9" * 5000):
        Path("odd.csv").write_text(f"time\n{cell}\n", encoding="utf-8")
        assert main(["import", "odd.csv", "-o", "out"]) in (1, 2)
        assert capsys.readouterr().err.count("\n") == 1
