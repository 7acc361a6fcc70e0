# SPDX-License-Identifier: Apache-2.0
"""The output of ``compare``: figures, a table, a picture; and the topics it accepts."""

import csv
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")

from impact_observer.cli.main import main
from impact_observer.compare.bag_comparison import BagComparison, compare_bag, labelled_by_law
from impact_observer.compare.distance_picture import distance_picture
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import carried_topics, model_of, write_run
from impact_observer.io.writer import BagWriter
from impact_observer.model import read_model
from impact_observer.plant import Plant, simulate
from impact_observer.stamps import NS_PER_S, grid


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag with six seconds of a late sensor, and an estimate."""
    folder = tmp_path_factory.mktemp("compare")
    plant, estimates = str(folder / "plant"), str(folder / "estimates")
    simulated = ["simulate", "two_mass", "--duration", "6", "--rate", "250", "--delay", "0.008"]
    assert main([*simulated, "-o", plant]) == 0
    observed = ["observe", plant, "--initial-state", "random:1", "--ensemble", "1"]
    assert main([*observed, "-o", estimates]) == 0
    return Path(estimates)


def metrics(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, dict[str, Any]]:
    """Output of ``compare --json``."""
    capsys.readouterr()
    assert main(["compare", *arguments, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    return dict(found)


def test_a_part_has_the_errors_of_its_samples(
    bag: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """``--start`` counts from the epoch: errors are those of the rows that export writes."""
    table = tmp_path / "errors.csv"
    assert main(["export", str(bag), "-o", str(table), "--what", "errors"]) == 0
    with table.open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if float(row["time_s"]) >= 3]
    found = metrics(capsys, str(bag), "--start", "3")["geometric"]
    assert found["samples"] == len(rows)
    assert found["start_stamp_ns"] == int(rows[0]["stamp_ns"])
    assert found["V_start"] == float(rows[0]["V"])
    squares = [float(row["dq_x1"]) ** 2 for row in rows]
    assert found["rms"][0] == pytest.approx((sum(squares) / len(rows)) ** 0.5)
    whole = metrics(capsys, str(bag))["geometric"]
    assert found["mismatch_windows"] < whole["mismatch_windows"]


@pytest.mark.slow
def test_a_late_sensor_does_not_count_as_a_bad_estimate(
    bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """At each impact two samples of 4 ms lie between the jumps."""
    found = metrics(capsys, str(bag))["geometric"]
    assert found["mismatch_windows"] == found["impacts_used"]
    assert found["mismatch_samples"] == 2 * found["impacts_used"]
    assert found["mismatch_longest"] == pytest.approx(0.008)
    main(["compare", str(bag)])
    table = capsys.readouterr().out
    assert re.search(r"geometric +\d+ +0 +0 +0 +\d+ +8 ms +\d\.\d\de[+-]\d\d J", table)


@pytest.mark.slow
def test_a_topic_of_another_package_can_be_compared(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its joint states have the name of an observer's; no state of this package is needed."""
    other = tmp_path / "other"
    with BagReader(bag) as reader, BagWriter(other) as writer:
        topics, _ = carried_topics(reader, writer, ())
        for raw in reader.raw(topics):
            writer.write_raw(*raw)
        name = "/observer_mine/joint_states"
        writer.declare(name, type_name="sensor_msgs/msg/JointState")
        for message in reader.raw(["/observer/joint_states"]):
            writer.write_raw(name, message.log_time, message.data)
    found = metrics(capsys, str(other))
    assert len(found) == 2
    mine, ours = found["observer_mine"], found["geometric"]
    assert mine["V_end"] == ours["V_end"]
    assert mine["rms"] == ours["rms"]


@pytest.mark.slow
def test_bags_are_drawn_together_each_since_its_own_epoch(bag: Path, tmp_path: Path) -> None:
    """Each bag is a curve from 0 on; impacts are labelled by bag if the runs differ."""
    plant, later = tmp_path / "plant", tmp_path / "later"
    model, epoch = read_model("two_mass"), 1000 * NS_PER_S
    moving = Plant(model.system, *model.initial_state(), epoch=epoch)
    run = simulate(moving, grid(epoch, epoch + 4 * NS_PER_S, 100.0))
    write_run(plant, model, run, seed=0)
    observed = ["observe", str(plant), "--law", "kinematic", "--ensemble", "1"]
    assert main([*observed, "-o", str(later)]) == 0
    results = [(each, compared(each)) for each in (bag, later)]
    labelled = labelled_by_law(results)
    axes = distance_picture(labelled, results).axes[0]
    times = [np.asarray(line.get_xdata()) for line in axes.lines]
    assert [time[0] for time in times[:2]] == [0.0, 0.0]
    assert [time[-1] for time in times[:2]] == [pytest.approx(6.0), pytest.approx(4.0)]
    assert [line.get_label() for line in axes.lines[2:]] == [
        "impacts at stop, estimates",
        "impacts at stop, later",
    ]


def test_impacts_of_one_run_are_drawn_once(bag: Path) -> None:
    """Several bags with estimates of one run share the marks of its impacts."""
    results = [(bag, compared(bag)), (bag, compared(bag))]
    axes = distance_picture(labelled_by_law(results), results).axes[0]
    assert [line.get_label() for line in axes.lines[2:]] == ["impacts at stop"]


def compared(bag: Path) -> BagComparison:
    """Comparison of all estimates of a bag with its truth."""
    with BagReader(bag) as reader:
        return compare_bag(reader, model_of(reader).system)
