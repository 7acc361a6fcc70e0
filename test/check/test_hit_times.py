# SPDX-License-Identifier: Apache-2.0
"""Warnings drawn from the times of impacts: a table's unit, and bounces that settle."""

from pathlib import Path

import numpy as np
import pytest

from impact_observer.check.hit_times import (
    HitTimes,
    doubts,
    longest_interval,
    settling,
    too_slow,
)
from impact_observer.cli.main import main
from impact_observer.events import ImpactEvent, Switch
from impact_observer.model import read_model


def times_of(seconds: list[float], contact: str = "floor") -> HitTimes:
    """The times of impacts of one contact."""
    stamps = (1e9 * (1 + np.asarray(seconds))).astype(np.int64).tolist()
    return HitTimes(ImpactEvent(at, (Switch(contact),), k, 0, 1) for k, at in enumerate(stamps))


def test_a_ball_in_milliseconds_that_were_taken_for_seconds_is_named() -> None:
    """The warning names the unit that fits; the same bounces in seconds give no warning."""
    bounces = np.cumsum(2 * np.sqrt(2 / 9.81) * 0.9 ** np.arange(12))
    system = read_model("bouncing_ball").system
    assert longest_interval(system) == pytest.approx(2 * 30 / 9.81)
    assert too_slow(times_of(bounces.tolist()), system) == ""
    for factor, unit in ((1e3, "ms"), (1e6, "us")):
        said = too_slow(times_of((factor * bounces).tolist()), system)
        assert f"are the times in {unit} (import --time-unit {unit})" in said


def test_periods_of_modes_and_forces_bound_the_time_between_impacts() -> None:
    """The bound is thirty periods of the slowest mode of a chain or of its force."""
    system = read_model("two_mass").system
    slowest = min(np.sqrt(np.linalg.eigvals(np.linalg.solve(system.M, system.K))).min(), 2.5)
    assert longest_interval(system) == pytest.approx(30 * 2 * np.pi / slowest)
    assert too_slow(times_of([0, 90, 180]), system) == ""
    assert "make" in too_slow(times_of([0, 900, 1800]), system)


def test_bounces_that_settle_are_named_with_the_dead_time_that_leaves_them_out() -> None:
    """Neither as many hits at an even rate nor a few settling hits are named."""
    row = np.cumsum(0.05 * 0.6 ** np.arange(30))
    rows = np.concatenate([row + k for k in range(10)]).tolist()
    said = settling(times_of(rows))
    assert "250 of the first 300 hits follow another in less than 5 ms" in said
    assert "--dead-time 0.005 of simulate" in said
    assert settling(times_of(row.tolist())) == ""
    assert settling(times_of((0.006 * np.arange(500)).tolist())) == ""


@pytest.mark.usefixtures("in_tmp_path")
def test_commands_name_a_wrong_unit_before_they_work(capsys: pytest.CaptureFixture[str]) -> None:
    """The commands import with a model, check and observe."""
    rows = "\n".join(f"{each}" for each in (0, 1200, 2280, 3250, 4120))
    Path("ball.csv").write_text(rows, encoding="utf-8")
    said = "are the times in ms (import --time-unit ms)"
    for command in (
        ["import", "ball.csv", "--model", "bouncing_ball", "-o", "bag"],
        ["check", "bag"],
        ["observe", "bag", "--rate", "0.1", "-o", "estimates"],
    ):
        assert main(command) == 0
        assert said in " ".join(capsys.readouterr().out.split())
    assert (
        main(
            ["import", "ball.csv", "--model", "bouncing_ball", "--time-unit", "ms", "-o", "right"]
        )
        == 0
    )
    assert said not in capsys.readouterr().out


@pytest.mark.usefixtures("in_tmp_path")
def test_filters_are_not_begun_where_milliseconds_were_taken_for_seconds(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A filter, which would insert thousands of impacts, is refused; a replica gets a warning."""
    times = np.cumsum(2 * np.sqrt(2 / 9.81) * 0.9 ** np.arange(12))
    Path("ball.csv").write_text("\n".join(f"{1e3 * t:.3f}" for t in times), encoding="utf-8")
    assert main(["import", "ball.csv", "--model", "bouncing_ball", "-o", "bag"]) == 0
    filtered = ["--law", "minimum-variance", "--rate", "0.01", "-o", "out"]
    for words in (
        ["observe", "bag", *filtered],
        ["smooth", "bag", *filtered[2:]],
        ["identify", "bag", "--free", "restitution"],
    ):
        capsys.readouterr()
        assert main(words) == 1
        assert "(import --time-unit ms)" in capsys.readouterr().err
        assert not Path("out").exists()
    assert main(["observe", "bag", "--rate", "0.01", "-o", "out"]) == 0


@pytest.mark.usefixtures("in_tmp_path")
def test_a_clock_error_as_long_as_the_time_between_impacts_is_doubted(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """By every command with a filter; replicas do not use it, and a hundredth is no doubt."""
    times = np.cumsum(0.3 * 0.9 ** np.arange(6))
    Path("ball.csv").write_text("\n".join(f"{t:.5f}" for t in times), encoding="utf-8")
    assert main(["import", "ball.csv", "--model", "bouncing_ball", "-o", "bag"]) == 0
    doubted = "and half of the times between impacts are below 0.27 s"
    filtered = ["--law", "minimum-variance", "--rate", "9", "-o"]
    for k, words in enumerate(
        (["observe", "bag", *filtered], ["smooth", "bag", *filtered[2:]], ["identify", "bag"])
    ):
        for error in ("0.1", "0.005"):
            end = ["--check"] if words[0] == "identify" else [f"out{k}-{error}"]
            assert main([*words, *end, "--clock-error", error]) in {0, 1}
            assert (doubted in capsys.readouterr().out) == (error == "0.1")
    assert main(["observe", "bag", "--clock-error", "0.1", "--rate", "9", "-o", "out"]) == 0
    assert doubted not in capsys.readouterr().out


@pytest.mark.usefixtures("in_tmp_path")
def test_check_does_not_ask_to_debounce_a_simulation(capsys: pytest.CaptureFixture[str]) -> None:
    """The bounces of a simulation die out; simulate counts as many impacts as check does."""
    words = ["simulate", "bouncing_ball", "--duration", "10", "--impacts-only", "--rate", "1"]
    assert main([*words, "-o", "bag"]) == 0
    said = capsys.readouterr().out
    assert "bouncing_ball, 10 s, 174 impacts (1 of them persistent, 0 releases)" in said
    assert "174 events of a sensor with impacts_only: 174 impacts" in said
    assert main(["check", "bag"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "124 of 174 impacts follow another in less than 5 ms; bounces of a simulation" in said
    assert "debounce" not in said


def test_events_before_their_epoch_are_counted_in_a_doubt() -> None:
    """Two of three events are stamped up to 0.8 s before the epoch of the forcing."""
    events = [
        ImpactEvent(
            100_000_000_000 + 400_000_000 * k, (Switch("stop"),), k + 1, 0, 100_800_000_000
        )
        for k in range(3)
    ]
    said = [
        *doubts(Path("bag"), HitTimes(events), read_model("two_mass").system, has_covariance=False)
    ]
    assert any("2 events stamped before the epoch" in line for line in said)


@pytest.mark.usefixtures("in_tmp_path")
@pytest.mark.parametrize("command", ["observe", "smooth"])
def test_an_epoch_that_is_given_after_the_first_impacts_is_doubted(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two of twelve impacts of a bag without an epoch come before the epoch that is given."""
    Path("hits.csv").write_text(
        "time,contact\n" + "".join(f"{1.1 + 0.3 * k:.3f},stop\n" for k in range(12))
    )
    assert main(["import", "hits.csv", "--time-zero", "0", "-o", "bag"]) == 0
    given = ["--model", "two_mass", "--epoch", "1.5", "--clock-error", "0.001"]
    assert main([command, "bag", *given, "--rate", "10", "-o", "out"]) == 0
    said = capsys.readouterr().out
    assert "warning: 2 events stamped before the epoch: such events are not applied" in said
