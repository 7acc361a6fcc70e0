# SPDX-License-Identifier: Apache-2.0
"""The harness of the benchmarks: rounds, ratios of the same round, goals, the table."""

import json
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from rich.console import Console

from benchmarks import report
from benchmarks.__main__ import benchmarks, main
from benchmarks.events import prepare_late
from benchmarks.harness import (
    OURS,
    Benchmark,
    Contest,
    Goal,
    Metrics,
    Result,
    SkippedError,
    measure,
)

UNITS = {"p50": "s", "p99": "s"}


@pytest.fixture(autouse=True)
def no_collection(monkeypatch: pytest.MonkeyPatch) -> None:
    """Garbage of earlier tests is not collected in a benchmark."""
    monkeypatch.setattr("benchmarks.harness.gc.collect", lambda: 0)


def quiet(_: str) -> None:
    """Show nothing."""


def contest(_: Path) -> Contest:
    """Ours is half of the peer's in the first round, twice in the second, thrice in the third."""
    ours, theirs = iter([1.0, 4.0, 9.0]), iter([2.0, 2.0, 3.0])

    def metrics(values: Iterator[float]) -> Metrics:
        value = next(values)
        return {"p50": 1e-3 * value, "p99": 1e-3 * value}

    return Contest(
        "nothing",
        lambda _: metrics(ours),
        {"peer": lambda _: metrics(theirs)},
        {"other": "not installed"},
        UNITS,
    )


def measured(*goals: Goal) -> Result:
    """Three rounds of that."""
    found = measure(Benchmark("it", "is it?", contest, goals, rounds=3), None, quiet)
    assert isinstance(found, Result)
    return found


def test_ratios_are_those_of_the_same_round() -> None:
    """A slow spell hits a whole round; a ratio of medians would differ."""
    ratio = measured().ratio("peer", "p50")
    assert (ratio.median, ratio.low, ratio.high) == pytest.approx((2.0, 0.5, 3.0))


def test_each_contestant_starts_a_round_in_turn() -> None:
    """No contestant is always first."""
    order: list[str] = []
    jobs = {name: lambda _, name=name: order.append(name) for name in (OURS, "a", "b")}
    peers = {name: job for name, job in jobs.items() if name != OURS}
    each = Benchmark("it", "?", lambda _: Contest("", jobs[OURS], peers))
    measure(each, 3, quiet)
    assert order == [OURS, "a", "b", "a", "b", OURS, "b", OURS, "a"]


def test_the_least_of_the_repeats_of_a_turn_counts_and_ours_is_made_ready_before_each() -> None:
    """What makes it ready is not timed."""
    order, values = [], iter([3.0, 2.0, 4.0])

    def ours(_: Path) -> Metrics:
        order.append("run")
        return {"p50": next(values)}

    made = Contest("", ours, units={"p50": "s"}, ready=lambda: order.append("ready"), repeats=3)
    found = measure(Benchmark("it", "?", lambda _: made), 1, quiet)
    assert isinstance(found, Result)
    assert found.own("p50").median == 2.0
    assert order == ["ready", "run"] * 3


def test_a_job_without_metrics_is_timed() -> None:
    """From its start to its end, in seconds."""
    found = measure(
        Benchmark("it", "?", lambda _: Contest("", lambda _: time.sleep(0.02))), 1, quiet
    )
    assert isinstance(found, Result)
    assert 0.02 <= found.own("time").median < 10


def test_goals_are_met_by_the_median_of_ratios_or_the_least_of_our_own_metric() -> None:
    """A goal over an absent peer is neither met nor missed."""
    goals = (Goal(2.0, "peer", "p50"), Goal(0.9e-3, metric="p99"), Goal(1.0, "other", "p50"))
    (found,) = report.document([measured(*goals)], {})["benchmarks"]
    assert [goal["met"] for goal in found["goals"]] == [True, False, None]
    assert [goal["found"] for goal in found["goals"]] == [
        pytest.approx(2),
        pytest.approx(1e-3),
        None,
    ]


def test_table_and_markdown_have_metrics_goals_and_skipped_peers() -> None:
    """A row for each peer and goal; both are made from the document alone."""
    document = report.document([measured(Goal(1.5, "peer", "p50"))], {})
    document = json.loads(json.dumps(document))
    rows = {(row.benchmark, row.peer): row for row in report.rows(document)}
    assert set(rows) == {("it, p50", "peer"), ("it, p99", "peer"), ("it, p50", "other")}
    row = rows["it, p50", "peer"]
    assert row[1:] == ("4.00 ms", "peer", "2.00 ms", "2", "0.5 to 3", "<= 1.5", "no")
    assert rows["it, p50", "other"].spread == "skipped: not installed"
    assert f"| {' | '.join(row)} |" in report.markdown(document)
    console = Console(width=200)
    with console.capture() as printed:
        console.print(report.table(document))
    assert "4.00 ms" in printed.get()


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.1234, "s", "123 ms"),
        (39.96e-6, "s", "40.0 us"),
        (0.9996, "s", "1.00 s"),
        (12.34, "s", "12.3 s"),
        (3e-9, "s", "3.00 ns"),
        (1.125, "", "1.12"),
    ],
)
def test_metrics_are_shown_with_a_fitting_prefix(value: float, unit: str, text: str) -> None:
    """Three digits."""
    assert report.shown(value, unit) == text


def test_a_benchmark_that_cannot_run_gives_the_reason() -> None:
    """The others go on."""

    def prepare(_: Path) -> Contest:
        raise SkippedError("no ROS here")

    assert measure(Benchmark("it", "?", prepare), 1, quiet) == "no ROS here"


def test_document_has_versions_and_nothing_of_the_machine() -> None:
    """Of Python, numpy and all other packages in use."""
    versions = report.document([], {})["versions"]
    assert {"python", "numpy", "scipy", "rosbags", "mcap", "rclpy", "fastrtps", "siconos"} <= set(
        versions
    )
    assert versions["numpy"]


@pytest.mark.slow
def test_command_measures_the_named_benchmark_and_writes_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One benchmark, one round, one file."""
    path = tmp_path / "metrics.json"
    assert main(["event_in_order", "--rounds", "1", "--json", str(path)]) == 0
    assert "event_in_order" in capsys.readouterr().out
    (found,) = json.loads(path.read_text("utf-8"))["benchmarks"]
    assert len(found["metrics"]["ours"]["event"]) == 1


def test_wrong_use_is_one_line_and_exit_code_2(capsys: pytest.CaptureFixture[str]) -> None:
    """The line lists the benchmarks."""
    with pytest.raises(SystemExit) as end:
        main(["nothing"])
    assert end.value.code == 2
    assert "no benchmark nothing; there are plant, plant_impacts" in capsys.readouterr().err


def test_names_of_benchmarks_are_unique_and_without_spaces() -> None:
    """They are arguments of a command."""
    names = [each.name for each in benchmarks(60)]
    assert len(set(names)) == len(names)
    assert not any(" " in name for name in names)


@pytest.mark.slow
def test_a_late_event_ends_in_the_same_estimate_as_one_in_time(tmp_path: Path) -> None:
    """The benchmark of roll-back compares equal work."""
    assert "the same bits" in prepare_late(tmp_path).work
