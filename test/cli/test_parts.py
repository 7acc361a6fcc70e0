# SPDX-License-Identifier: Apache-2.0
"""--start and --duration: the part of a bag that a command reads."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from impact_observer.cli.main import main
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import events_in, model_of
from impact_observer.observer import Options, make_observer, replay
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Estimate

EPOCH = NS_PER_S
LOW, HIGH = EPOCH + 8 * NS_PER_S, EPOCH + 14 * NS_PER_S
PART = ("--start", "8", "--duration", "6")
WORDS = "part: 8 s to 14 s after the epoch, 1.000000000 s"


@pytest.fixture(scope="module")
def run_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twenty seconds of two_mass, with 14 exact impacts."""
    bag = tmp_path_factory.mktemp("parts") / "plant"
    words = ["simulate", "two_mass", "--duration", "20", "--rate", "50", "--seed", "1"]
    assert main([*words, "-o", str(bag)]) == 0
    return bag


@pytest.mark.parametrize("epoch", [(), ("--epoch", "1")])
def test_an_observer_of_a_part_knows_only_the_impacts_in_it(
    run_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], epoch: tuple[str, ...]
) -> None:
    """Estimates are those of an observer that joined late; the bag has nothing of before."""
    out = tmp_path / "out"
    assert main(["observe", str(run_bag), *PART, *epoch, "-o", str(out)]) == 0
    assert WORDS in capsys.readouterr().out
    with BagReader(run_bag) as reader:
        events = [each for each in events_in(reader) if LOW <= each.stamp <= HIGH]
        stamps = np.array([*reader.all_stamps(["/plant/joint_states"])])
        observer = make_observer(model_of(reader), Options("geometric"))
    stamps = stamps[(stamps >= events[0].stamp) & (stamps <= HIGH)]
    expected = [e for e in replay(observer, events, stamps) if isinstance(e, Estimate)]
    with BagReader(out) as reader:
        found = reader.observer_states("/observer/state", ("x1", "x2"))
        truth = np.array([*reader.all_stamps(["/plant/joint_states"])])
        assert [each.stamp for each in events_in(reader)] == [each.stamp for each in events]
    assert found.stamps.tolist() == stamps.tolist()
    np.testing.assert_array_equal(found.q, [each.q for each in expected])
    assert (truth.min(), truth.max()) == (LOW, HIGH)


def test_where_nothing_was_recorded_before_a_part_the_start_is_known(
    run_bag: Path, tmp_path: Path
) -> None:
    """The first impact is in the part, so the given initial state holds at the epoch."""
    whole, part = tmp_path / "whole", tmp_path / "part"
    given = ["--initial-state", "0.1,-0.2,0.5,0"]
    assert main(["observe", str(run_bag), *given, "-o", str(whole)]) == 0
    assert main(["observe", str(run_bag), *given, "--start", "0.1", "-o", str(part)]) == 0
    found = []
    for bag in (whole, part):
        with BagReader(bag) as reader:
            states = reader.observer_states("/observer/state", ("x1", "x2"))
        found.append(states.q[states.stamps >= EPOCH + NS_PER_S // 10])
    np.testing.assert_array_equal(found[0], found[1])


def test_a_smoothed_part_agrees_with_the_plant(run_bag: Path, tmp_path: Path) -> None:
    """The motion at its first impact is estimated, from the five impacts in it."""
    out = tmp_path / "out"
    words = ["smooth", str(run_bag), *PART, "--clock-error", "1e-5", "-o", str(out)]
    assert main(words) == 0
    with BagReader(out) as reader:
        smoothed = reader.observer_states("/smoother/state", ("x1", "x2"))
        truth = reader.joint_states("/plant/joint_states", ("x1", "x2"))
    q = truth.q[np.isin(truth.stamps, smoothed.stamps)]
    np.testing.assert_allclose(smoothed.q, q, atol=1e-5)


def test_parameters_are_identified_from_a_part(
    run_bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The initial state of the model does not count: the state at the first impact is fitted."""
    words = ["identify", str(run_bag), "--free", "restitution", "--start", "8", "--json"]
    assert main(words) == 0
    printed = capsys.readouterr()
    assert "part: 8 s to the end after the epoch" in printed.err
    found = json.loads(printed.out)["parameters"]["restitution.stop"]
    assert found["value"] == pytest.approx(0.7, abs=1e-6)


def test_tables_and_comparisons_keep_to_the_part(
    run_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Rows are those of the part, with the time of the whole bag."""
    table = tmp_path / "rows.csv"
    assert main(["export", str(run_bag), "-o", str(table), *PART]) == 0
    assert WORDS in capsys.readouterr().out
    with table.open(encoding="utf-8") as file:
        times = [float(row["time_s"]) for row in csv.DictReader(file)]
    np.testing.assert_allclose(times, np.arange(8, 14.001, 0.02))
    assert main(["compare", str(run_bag), "--laws", "geometric", *PART, "--json"]) == 0
    printed = capsys.readouterr()
    found = json.loads(printed.out)["geometric"]
    assert WORDS in printed.err
    assert found["impacts_used"] == 5


def test_a_picture_shows_the_part(
    run_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The line names the seconds that are drawn."""
    picture = str(tmp_path / "picture.png")
    assert main(["plot", str(run_bag), "-o", picture, "--select", "x1", *PART]) == 0
    assert f"picture: {picture}, 8.000 to 14.000 s of {run_bag}" in capsys.readouterr().out


def test_impacts_detected_in_a_part_are_numbered_from_two(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """So observers do not think that nothing has happened between the epoch and the part."""
    signal, out = tmp_path / "switch.csv", tmp_path / "out"
    hits = (0.503, 1.303, 1.903, 2.353)
    rows = [f"{k / 1000},{int(any(0 <= k / 1000 - h < 0.01 for h in hits))}" for k in range(3000)]
    signal.write_text("time,closed\n" + "\n".join(rows) + "\n", encoding="utf-8")
    sources = tmp_path / "sources.yaml"
    declared = "sources: [{contact: stop, topic: /closed, kind: switch, threshold: 0.5}]"
    sources.write_text(declared, encoding="utf-8")
    given = ["detect", str(signal), "--sources", str(sources)]
    assert main([*given, "--start", "1", "--duration", "1", "-o", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "1001 rows in 1 s" in printed
    assert "part: 1 s to 2 s after the file's time 0, 1.000000000 s" in printed
    with BagReader(out) as reader:
        found = [(each.stamp, each.sequence) for each in events_in(reader)]
    assert found == [(2_303_000_000, 2), (2_903_000_000, 3)]
    again = tmp_path / "again"
    assert main([*given, "--start", "7", "-o", str(again)]) == 2
    assert "no row from 7 s to the end after the file's time 0" in capsys.readouterr().err
    assert not again.exists()
