# SPDX-License-Identifier: Apache-2.0
"""detect: from a signal in a table or a sound to a bag with impacts."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.io import wavfile

from impact_observer.cli.main import main
from impact_observer.events import Switch
from impact_observer.io import BagReader
from impact_observer.io.messages import read_stamp
from impact_observer.io.recordings import events_in, model_of
from impact_observer.states import Vector

HITS = np.array([0.0513, 0.1271, 0.2345])  # s
RATE = 4000
SECOND = 1_000_000_000


def signal(rate: int = RATE, gravity: float = 9.81) -> tuple[Vector, Vector]:
    """Times, s, and accelerations, m/s^2: half-sines of 5 ms and 80 m/s^2 on top of gravity."""
    t = np.arange(0, 0.3, 1 / rate)
    since = t[:, None] - HITS
    hits = np.where(np.abs(since) < 0.0025, 80 * np.cos(since * np.pi / 0.005), 0.0)
    return t, gravity + hits.sum(axis=1)


def table(header: str = "time,az\n", row: Callable[[float, float], str] | None = None) -> str:
    """A table of the signal."""
    row = row or (lambda t, a: f"{t:.6f},{a:.5f}")
    return header + "\n".join(row(t, a) for t, a in zip(*signal(), strict=True))


def impact_times(path: Path, *arguments: str) -> Vector:
    """Stamps of the impacts in a file, s after the default stamp of its time zero."""
    output = path.with_name("bag")
    given = ["--threshold", "30", "--baseline", "1", "-o", str(output), *arguments]
    assert main(["detect", str(path), *given]) == 0
    with BagReader(output) as reader:
        events = events_in(reader)
    assert all(event.switches == (Switch("stop"),) for event in events)
    assert [event.sequence for event in events] == [1, 2, 3]
    return np.array([event.stamp - SECOND for event in events]) / SECOND


@pytest.mark.parametrize(
    ("name", "text", "arguments"),
    [
        ("acc.csv", table(), ()),
        ("bare.txt", table(""), ()),
        (
            "phone.csv",
            table(
                '"Time (s)";"a x (m/s^2)";"a z (m/s^2)"\n',
                lambda t, a: f"{t:.6f};0.1;{a:.5f}".replace(".", ","),
            ),
            ("--topic", "a z"),
        ),
        ("ms.tsv", table("t_ms\taz\n", lambda t, a: f"{1e3 * t:.3f}\t{a:.5f}"), ()),
        ("odd.csv", table("time,az\n0,\n"), ()),
    ],
    ids=["header", "bare", "columns", "unit", "empty_cell"],
)
def test_a_table_of_a_signal_gives_its_impacts(
    tmp_path: Path, name: str, text: str, arguments: tuple[str, ...]
) -> None:
    """Stamps are exact to a twentieth of a sample; the contact is the model's only one."""
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    if name == "ms.tsv":
        arguments = ("--time-column", "t_ms")
    stamps = impact_times(path, "--model", "two_mass", *arguments)
    np.testing.assert_allclose(stamps, HITS, atol=0.05 / RATE)
    with BagReader(tmp_path / "bag") as reader:
        assert model_of(reader).system.name == "two_mass"
        assert {event.epoch for event in events_in(reader)} == {SECOND}


@pytest.mark.parametrize(
    ("kind", "error"), [(np.uint8, 5e-5), (np.int16, 5e-6), (np.int32, 1e-6), (np.float32, 1e-6)]
)
def test_a_sound_gives_its_impacts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: type, error: float
) -> None:
    """A sound of any format counts in parts of full scale; the signal is its second channel."""
    rate = 48000
    _, a = signal(rate, gravity=0.0)
    part = np.stack([0 * a, a / 100], axis=1)
    if kind != np.float32:
        info = np.iinfo(kind)
        zero = 128 if kind == np.uint8 else 0
        part = np.rint(zero + part * (info.max - zero))
    path = tmp_path / "hits.WAV"
    wavfile.write(path, rate, part.astype(kind))
    arguments = ["--contact", "stop", "--topic", "channel2", "--epoch", "0.5"]
    stamps = impact_times(path, *arguments, "--threshold", "0.3", "--baseline", "0")
    np.testing.assert_allclose(stamps, HITS, atol=error)
    printed = capsys.readouterr().out
    assert "(4.8e+04 Hz); time 0 is stamp 1.000000000 s, epoch 0.500000000 s" in printed


def test_a_file_of_sensors_names_columns(tmp_path: Path) -> None:
    """Two contacts have a column each; each run of characters that no topic has becomes ``_``."""
    path = tmp_path / "acc.csv"
    path.write_text(
        table("time,a [g],b\n", lambda t, a: f"{t:.6f},{a:.5f},{-a if t > 0.2 else 0}"),
        encoding="utf-8",
    )
    sources = tmp_path / "rig.yaml"
    sources.write_text(
        "sources:\n- {contact: left, topic: a_g, threshold: 30}\n"
        "- {contact: right, topic: b, threshold: 30, direction: down}\n",
        encoding="utf-8",
    )
    output = ["-o", str(tmp_path / "bag")]
    assert main(["detect", str(path), "--sources", str(sources), "--time-zero", "2", *output]) == 0
    with BagReader(tmp_path / "bag") as reader:
        events = events_in(reader)
    contacts = [event.switches[0].contact for event in events]
    assert sorted(contacts) == ["left", "left", "left", "right"]
    right = next(event for event in events if event.switches[0].contact == "right")
    assert abs(right.stamp / SECOND - 2 - HITS[2]) < 0.05 / RATE


@pytest.mark.parametrize(
    ("text", "arguments", "code", "expected"),
    [
        (table(), [], 2, "--contact NAME, or --model"),
        (table(), ["--model", "three_mass"], 2, "--contact NAME, one of right, left"),
        (table("czas,az\n"), ["--contact", "stop"], 2, "no column of time in czas, az"),
        (table(), ["--contact", "stop", "--frame-rate", "9"], 2, "leave out --frame-rate"),
        ("time,x,y\n0,1,2", ["--contact", "stop"], 2, "columns x, y; name one with --topic"),
        ("time,x,x\n0,1,2", ["--contact", "stop", "--topic", "x"], 2, "columns x.1, x.2"),
        (table(), ["--contact", "stop", "--topic", "ay"], 2, "no column ay; columns az"),
        (
            table(),
            ["--contact", "stop", "--threshold", "90", "--baseline", "0"],
            1,
            "at most 89.8 of the threshold 90",
        ),
    ],
)
def test_a_signal_that_cannot_be_used_is_one_line(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    *,
    text: str,
    arguments: list[str],
    code: int,
    expected: str,
) -> None:
    """The error says what was found, and the remedy; no bag is left."""
    path, output = tmp_path / "acc.csv", tmp_path / "bag"
    path.write_text(text, encoding="utf-8")
    given = ["--threshold", "30", *arguments, "-o", str(output)]
    assert main(["detect", str(path), *given]) == code
    errors = capsys.readouterr().err.strip().splitlines()
    assert len(errors) == 1
    assert errors[0].startswith(f"impact-observer: {path}")
    assert expected in errors[0]
    assert not output.exists()


def test_what_is_no_signal_is_said_to_be_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A file that is no sound, options of a table for a bag, and a signal where a bag is due."""
    sound, output = tmp_path / "hits.wav", str(tmp_path / "bag")
    sound.write_bytes(b"no sound")
    given = ["--contact", "stop", "--topic", "az", "-o", output]
    assert main(["detect", str(sound), *given]) == 2
    assert "is no sound" in capsys.readouterr().err
    wavfile.write(sound, RATE, np.zeros(9, np.int16))
    assert main(["detect", str(sound), "--time-column", "t", *given]) == 2
    assert "leave out options of a table" in capsys.readouterr().err
    assert main(["detect", str(tmp_path), "--time-zero", "3", *given]) == 2
    assert "go with a signal, not with a bag" in capsys.readouterr().err
    assert main(["observe", str(sound), "-o", output]) == 2
    assert "`import` makes one of a table of times, `detect`" in capsys.readouterr().err


def test_rising_edges_of_a_column_are_the_pulses_of_a_drive(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The first edge is the epoch; a noisy channel has as many edges as the generator."""
    t, a = signal()
    edges = np.array([0.0123, 0.1023, 0.1923, 0.2823])  # s
    phase = (t[:, None] - edges) % 1.0
    noise = 0.3 * np.random.default_rng(1).standard_normal(t.size)
    ttl = np.where((phase < 0.03).any(axis=1), 4.9, 0.1) + noise
    rows = [f"{x:.6f},{y:.5f},{z:.5f}" for x, y, z in zip(t, a, ttl, strict=True)]
    path = tmp_path / "scope.csv"
    path.write_text("\n".join(["time,CH1,CH2", *rows]))
    named = ("--contact", "stop", "--topic", "CH1")
    impact_times(path, *named, "--pulses", "CH2")
    assert "CH2: 4 pulses, the first at 1.012" in capsys.readouterr().out
    with BagReader(tmp_path / "bag") as reader:
        pulses = [read_stamp("", m.stamp) for _, m in reader.messages("/phase_reference")]
        assert {event.epoch for event in events_in(reader)} == {pulses[0]}
    np.testing.assert_allclose((np.array(pulses) - SECOND) / SECOND, edges, atol=1 / RATE)


@pytest.mark.parametrize(
    ("column", "said"),
    [("CH3", "no column CH3; columns: CH1, CH2"), ("CH2", "CH2 has no rising edge; expected")],
)
def test_a_column_without_pulses_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], column: str, said: str
) -> None:
    """It names the columns, or what was expected."""
    path, output = tmp_path / "scope.csv", str(tmp_path / "bag")
    path.write_text("time,CH1,CH2\n0,0,1\n0.001,50,1\n0.002,0,1\n")
    named = ("--contact", "stop", "--topic", "CH1", "--threshold", "30", "--pulses", column)
    assert main(["detect", str(path), *named, "-o", output]) == 2
    assert said in capsys.readouterr().err


def test_pulses_are_not_those_of_the_signal_itself(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Hits taken for pulses give a wrong epoch."""
    path = tmp_path / "acc.csv"
    path.write_text(table())
    given = ["--contact", "stop", "--topic", "az", "--threshold", "1", "--pulses", "az"]
    assert main(["detect", str(path), *given, "-o", str(tmp_path / "bag")]) == 2
    assert "--pulses az: " in capsys.readouterr().err


@pytest.mark.parametrize(("first", "zero"), [(-3.25, 5), (-10.0, 11), (-250.0, 251)])
def test_a_table_that_begins_long_before_its_time_zero_is_told_what_to_give(
    first: float, zero: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A trigger in the middle of a record; the value that is named is one that helps."""
    path = tmp_path / "acc.csv"
    path.write_text(table(row=lambda t, a: f"{t + first:.6f},{a:.5f}"))
    given = ["detect", str(path), "--contact", "stop", "--topic", "az", "--threshold", "30"]
    given += ["-o", str(tmp_path / "bag")]
    assert main(given) == 2
    assert f"choose --time-zero {zero}, the stamp of time 0" in capsys.readouterr().err
    assert main([*given, "--time-zero", str(zero)]) == 0


def test_a_file_of_sensors_says_how_a_table_is_read(tmp_path: Path) -> None:
    """The unit of its times; the sensor may be one of options."""
    path, sources = tmp_path / "acc.csv", tmp_path / "rig.yaml"
    text = table("clock,az\n", lambda t, a: f"{1e3 * t:.3f},{a:.5f}")
    path.write_text(text, encoding="utf-8")
    sources.write_text("table: {time_column: clock, time_unit: ms}\n", encoding="utf-8")
    stamps = impact_times(path, "--contact", "stop", "--sources", str(sources))
    np.testing.assert_allclose(stamps, HITS, atol=0.05 / RATE)
