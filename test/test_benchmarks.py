"""The harness of the benchmarks: turns, ratios of the same round, goals, the table."""

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
    Figures,
    Goal,
    Result,
    SkippedError,
    measure,
)

UNITS = {"p50": "s", "p99": "s"}


@pytest.fixture(autouse=True)
def no_collection(monkeypatch: pytest.MonkeyPatch) -> None:
    """The garbage of all tests before is not that of a benchmark."""
    monkeypatch.setattr("benchmarks.harness.gc.collect", lambda: 0)


def quiet(_: str) -> None:
    """Nobody is told."""


def contest(_: Path) -> Contest:
    """Ours is half of the peer's in the first round, twice in the second, thrice in the third."""
    ours, theirs = iter([1.0, 4.0, 9.0]), iter([2.0, 2.0, 3.0])

    def figures(values: Iterator[float]) -> Figures:
        value = next(values)
        return {"p50": 1e-3 * value, "p99": 1e-3 * value}

    return Contest(
        "nothing",
        lambda _: figures(ours),
        {"peer": lambda _: figures(theirs)},
        {"other": "not installed"},
        UNITS,
    )


def measured(*goals: Goal) -> Result:
    """Three rounds of that."""
    found = measure(Benchmark("it", "is it?", contest, goals, rounds=3), None, quiet)
    assert isinstance(found, Result)
    return found


def test_ratios_are_those_of_the_same_round() -> None:
    """Medians of figures would say something else: a slow spell hits all of a round."""
    ratio = measured().ratio("peer", "p50")
    assert (ratio.median, ratio.low, ratio.high) == pytest.approx((2.0, 0.5, 3.0))


def test_each_contestant_begins_a_round_in_its_turn() -> None:
    """Nobody is always first."""
    order: list[str] = []
    jobs = {name: lambda _, name=name: order.append(name) for name in (OURS, "a", "b")}
    peers = {name: job for name, job in jobs.items() if name != OURS}
    each = Benchmark("it", "?", lambda _: Contest("", jobs[OURS], peers))
    measure(each, 3, quiet)
    assert order == [OURS, "a", "b", "a", "b", OURS, "b", OURS, "a"]


def test_a_job_that_measures_nothing_is_timed() -> None:
    """From its start to its end, in seconds."""
    found = measure(
        Benchmark("it", "?", lambda _: Contest("", lambda _: time.sleep(0.02))), 1, quiet
    )
    assert isinstance(found, Result)
    assert 0.02 <= found.own("time").median < 10


def test_goals_are_met_by_the_median_of_ratios_or_of_our_own_figure() -> None:
    """And a goal over a peer that is absent is neither met nor missed."""
    goals = (Goal(2.0, "peer", "p50"), Goal(3.9e-3, figure="p99"), Goal(1.0, "other", "p50"))
    (told,) = report.document([measured(*goals)], {})["benchmarks"]
    assert [goal["met"] for goal in told["goals"]] == [True, False, None]
    assert [goal["found"] for goal in told["goals"]] == [
        pytest.approx(2),
        pytest.approx(4e-3),
        None,
    ]


def test_table_and_markdown_say_figures_goals_and_who_was_skipped() -> None:
    """A row for each peer and goal; both are made of the document alone."""
    told = report.document([measured(Goal(1.5, "peer", "p50"))], {})
    told = json.loads(json.dumps(told))
    rows = {(row.benchmark, row.peer): row for row in report.rows(told)}
    assert set(rows) == {("it, p50", "peer"), ("it, p99", "peer"), ("it, p50", "other")}
    row = rows["it, p50", "peer"]
    assert row[1:] == ("4.00 ms", "peer", "2.00 ms", "2", "0.5 to 3", "<= 1.5", "no")
    assert rows["it, p50", "other"].spread == "skipped: not installed"
    assert f"| {' | '.join(row)} |" in report.markdown(told)
    console = Console(width=200)
    with console.capture() as printed:
        console.print(report.table(told))
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
def test_figures_are_shown_in_units_that_suit(value: float, unit: str, text: str) -> None:
    """Three digits."""
    assert report.shown(value, unit) == text


def test_a_benchmark_that_lacks_something_says_so() -> None:
    """The others go on."""

    def prepare(_: Path) -> Contest:
        raise SkippedError("no ROS here")

    assert measure(Benchmark("it", "?", prepare), 1, quiet) == "no ROS here"


def test_document_has_versions_and_nothing_of_the_machine() -> None:
    """Python's, numpy's and those of everything else that is used."""
    versions = report.document([], {})["versions"]
    assert {"python", "numpy", "scipy", "rosbags", "mcap", "rclpy", "fastrtps", "siconos"} <= set(
        versions
    )
    assert versions["numpy"]


def test_command_measures_what_it_is_told_and_writes_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One benchmark, one round, one file."""
    path = tmp_path / "figures.json"
    assert main(["event_in_order", "--rounds", "1", "--json", str(path)]) == 0
    assert "event_in_order" in capsys.readouterr().out
    (told,) = json.loads(path.read_text("utf-8"))["benchmarks"]
    assert len(told["figures"]["ours"]["event"]) == 1


def test_wrong_use_is_one_line_and_exit_code_2(capsys: pytest.CaptureFixture[str]) -> None:
    """It says what there is."""
    with pytest.raises(SystemExit) as end:
        main(["nothing"])
    assert end.value.code == 2
    assert "no benchmark nothing; there are plant, topic" in capsys.readouterr().err


def test_every_benchmark_has_a_name_of_its_own_without_spaces() -> None:
    """They are arguments of a command."""
    names = [each.name for each in benchmarks(60)]
    assert len(set(names)) == len(names)
    assert not any(" " in name for name in names)


def test_an_event_that_is_late_ends_where_one_in_time_does(tmp_path: Path) -> None:
    """What the benchmark of roll-back compares is the same work."""
    assert "the same bits" in prepare_late(tmp_path).work
