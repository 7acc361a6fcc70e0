# SPDX-License-Identifier: Apache-2.0
"""import --samples: tables of encoders and cameras become topics for --measurements."""

import re
from pathlib import Path

import pytest

from impact_observer.cli.main import main
from impact_observer.io import BagReader
from impact_observer.message_fields import header_stamp

TRACKER = "Frame\tX1\tFlag1\nTracks 1 to 1\n0\t62.5\t \n1\t62.25\t \n3\tnan\t \n4\t61.5\t \n"
MEASUREMENTS = """measurements:
- {name: encoder, topic: /encoder, joint: x1, quantity: position, deviation: 1.0e-5}
"""


def imported(
    folder: Path,
    samples: str,
    *options: str,
    name: str = "encoder.csv",
    impacts: str = "0.5,stop\n",
) -> int:
    """The exit code of an import with a file of samples."""
    (folder / "impacts.csv").write_text(impacts, encoding="utf-8")
    (folder / name).write_text(samples, encoding="utf-8")
    given = ["--model", "two_mass", "--samples", str(folder / name), "-o", str(folder / "bag")]
    return main(["import", str(folder / "impacts.csv"), *given, *options])


def joints(folder: Path, topic: str) -> list[tuple[int, dict[str, float]]]:
    """Stamps, ns, and positions of joints in the messages of a topic."""
    with BagReader(folder / "bag") as reader:
        return [
            (header_stamp(message) or 0, dict(zip(message.name, message.position, strict=True)))
            for _, message in reader.messages(topic)
        ]


def test_each_column_of_numbers_is_a_joint(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A cell without a number is no joint of its message; impacts stay beside the samples."""
    text = "t_ms;x1;note;x2\n0,25;0,5;a;\n250;-1;b;2e-3\n750;;c;7\n"
    assert imported(tmp_path, text) == 0
    assert joints(tmp_path, "/encoder") == [
        (1_000_250_000, {"x1": 0.5}),
        (1_250_000_000, {"x1": -1.0, "x2": 0.002}),
        (1_750_000_000, {"x2": 7.0}),
    ]
    with BagReader(tmp_path / "bag") as reader:
        assert [event.stamp for event in reader.events()] == [1_500_000_000]
    assert "1 event of 1 row, times in s, 3 samples on /encoder" in capsys.readouterr().out


def test_frames_of_a_tracker_have_times_by_their_rate(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Impacts keep their own times; a cell without a number is counted."""
    assert imported(tmp_path, TRACKER, "--frame-rate", "25", name="hit 1.txt") == 0
    assert joints(tmp_path, "/hit_1") == [
        (1_000_000_000, {"X1": 62.5}),
        (1_040_000_000, {"X1": 62.25}),
        (1_160_000_000, {"X1": 61.5}),
    ]
    said = capsys.readouterr().out
    assert "1 of 4 values of X1 left out (25 %)" in said
    assert "in line 5, is 'nan'" in said


def test_an_observer_uses_samples_from_a_table(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The exported truth of a plant, without its other coordinate, is used as an encoder."""
    plant, table = tmp_path / "plant", tmp_path / "truth.csv"
    assert main(["simulate", "two_mass", "--duration", "5", "--rate", "50", "-o", str(plant)]) == 0
    assert main(["export", str(plant), "-o", str(table), "--what", "states"]) == 0
    assert main(["export", str(plant), "-o", str(tmp_path / "e.csv"), "--what", "events"]) == 0
    header, *rows = table.read_text(encoding="utf-8").splitlines()
    time, x1 = header.split(",").index("time_s"), header.split(",").index("q_x1")
    cells = [row.split(",") for row in rows]
    text = "\n".join(["time,x1", *(f"{row[time]},{row[x1]}" for row in cells)])
    events = (tmp_path / "e.csv").read_text(encoding="utf-8")
    assert imported(tmp_path, text, impacts=events) == 0
    (tmp_path / "m.yaml").write_text(MEASUREMENTS, encoding="utf-8")
    capsys.readouterr()
    given = ["--measurements", str(tmp_path / "m.yaml"), "--rate", "20", "-o", str(tmp_path / "o")]
    law = ["--law", "minimum-variance"]
    assert main(["observe", str(tmp_path / "bag"), *given, *law]) == 0
    assert re.search(rf"encoder +{len(rows)} +{len(rows)} ", capsys.readouterr().out)


@pytest.mark.parametrize(
    ("text", "options", "said"),
    [
        ("time,x1\n1700000000.5,1\n", {}, "1700000000.500000000 s is of another clock"),
        ("time,x1\n-2,1\n", {}, "-1.000000000 s; expected more than 0"),
        ("time,x1\n0,on\n", {}, "line 1: x1 beside the time"),
        ("time,x1\n0,1\n", {"name": "impacts.txt"}, "topic /impacts is taken"),
        ("Frame,x1\n0,1\n1,2\n", {}, "--frame-rate HZ"),
    ],
)
def test_samples_that_cannot_be_used_are_one_line(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    text: str,
    options: dict[str, str],
    said: str,
) -> None:
    """The line names the file; no bag is left."""
    assert imported(tmp_path, text, **options) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert said in line
    assert not (tmp_path / "bag").exists()


def test_a_frame_rate_that_no_file_needs_is_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Both files have times."""
    assert imported(tmp_path, "time,x1\n0,1\n", "--frame-rate", "25") == 2
    assert "leave out --frame-rate" in capsys.readouterr().err
