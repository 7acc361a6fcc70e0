# SPDX-License-Identifier: Apache-2.0
"""sweep: equal outcomes from one process, several processes and a cluster; resuming."""

import json
import re
import sys
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path

import pytest

pytest.importorskip("joblib")
pytest.importorskip("pyarrow")

import pyarrow.parquet as pq

from impact_observer.cli.main import main
from impact_observer.errors import DynamicsError
from impact_observer.sweep import case_runs, engines, outcomes_file
from impact_observer.sweep.case_runs import Outcome
from impact_observer.sweep.plan import Case

SMALL = (
    *(
        "two_mass",
        "--laws",
        "geometric,minimum-variance",
        "--runs",
        "2",
        "--duration",
        "1",
        "--rate",
        "20",
    ),
    *("--jitter", "0,0.001", "--off", "stiffness-scale=1,1.02"),
)
SIZE = 2 * 2 * 2 * 2
Table = dict[str, list[object]]


def table_of(path: Path) -> Table:
    """Contents of a file, as another program reads them."""
    table = pq.read_table(path)
    return {name: table[name].to_pylist() for name in table.column_names}


@pytest.fixture(scope="module")
def serial(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small sweep by one process."""
    path = tmp_path_factory.mktemp("serial") / "sweep.parquet"
    assert main(["sweep", *SMALL, "--jobs", "1", "-o", str(path)]) == 0
    return path


def test_options_of_observers_that_have_the_name_of_a_fault_have_a_flag_of_their_own(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The flags are those of docs/sweep.md; an epoch is in seconds, also in an error."""
    with pytest.raises(SystemExit):
        main(["sweep", "--help"])
    said = capsys.readouterr().out
    for name in ("missed", "spurious", "mislabelled", "dead-time"):
        assert f"--observer-{name} " in said
    with pytest.raises(SystemExit):
        main(["observe", "bag", "-o", "out", "--epoch", "5000000000"])
    assert "5000000000 found; expected 0 to 2147483647.999999999 s" in capsys.readouterr().err


@pytest.mark.slow
def test_rows_have_labels_and_metrics_of_the_cases(serial: Path) -> None:
    """Rows are in the order of the cases."""
    table = table_of(serial)
    assert table["case"] == [*range(SIZE)]
    assert table["law"] == ["geometric"] * 8 + ["minimum-variance"] * 8
    assert table["sensor_jitter"][:8] == [0.0] * 4 + [0.001] * 4
    assert table["off_stiffness-scale"][:4] == [1.0, 1.0, 1.02, 1.02]
    assert table["seed"][:4] == [0, 1, 0, 1]
    assert table["initial"][:2] == ["random:0", "random:1"]
    assert set(table["error"]) == {""}
    assert all(isinstance(value, float) for value in table["V_ratio"])


@pytest.mark.slow
def test_two_processes_give_the_same_bits_as_one(serial: Path, tmp_path: Path) -> None:
    """The whole file."""
    path = tmp_path / "sweep.parquet"
    assert main(["sweep", *SMALL, "--jobs", "2", "-o", str(path)]) == 0
    assert path.read_bytes() == serial.read_bytes()


@pytest.mark.long
def test_a_cluster_of_two_workers_gives_the_same_bits(serial: Path, tmp_path: Path) -> None:
    """Workers are processes of their own, found by the address of their scheduler."""
    distributed = pytest.importorskip("distributed")
    path = tmp_path / "sweep.parquet"
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50
    ) as cluster:
        address = cluster.scheduler_address
        assert main(["sweep", *SMALL, "--scheduler", address, "-o", str(path)]) == 0
    assert path.read_bytes() == serial.read_bytes()


@pytest.mark.slow
def test_a_cluster_without_workers_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The exit code is 2, and no file is written."""
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(engines, "_PATIENCE", 0.5)
    with distributed.LocalCluster(n_workers=0, dashboard_address=None, silence_logs=50) as cluster:
        address = cluster.scheduler_address
        words = ["sweep", *SMALL, "--scheduler", address, "-o", str(tmp_path / "sweep.parquet")]
        assert main(words) == 2
    line = f"impact-observer: --scheduler {address}: has no workers; start some\n"
    assert capsys.readouterr().err == line
    assert [*tmp_path.iterdir()] == []


class Engine:
    """Runs and counts cases in this process, in another order."""

    def __init__(self, stop_after: int | None = None) -> None:
        self.numbers: list[int] = []
        self.stop_after = stop_after

    def __call__(
        self, batches: Sequence[tuple[Case, ...]], *, jobs: int | None, scheduler: str | None
    ) -> Iterator[Outcome]:
        """Run batches, as ``run_batches`` does."""
        del jobs, scheduler
        for batch in reversed(batches):
            for outcome in case_runs.run_batch(batch)[::-1]:
                if len(self.numbers) == self.stop_after:
                    raise KeyboardInterrupt
                self.numbers.append(outcome.case)
                yield outcome


@pytest.mark.slow
def test_finished_cases_are_kept_and_not_run_again(
    serial: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """After Ctrl-C the same command goes on, in any order, and ends with the same file."""
    path = tmp_path / "sweep.parquet"
    first, second, third = Engine(5), Engine(), Engine()
    monkeypatch.setattr(outcomes_file, "run_batches", first)
    assert main(["sweep", *SMALL, "-o", str(path)]) == 1
    line = "impact-observer: interrupted; 5 of 16 cases are done; the same command goes on\n"
    assert capsys.readouterr().err == line
    assert table_of(path)["case"] == sorted(first.numbers) == [11, 12, 13, 14, 15]
    monkeypatch.setattr(outcomes_file, "run_batches", second)
    assert main(["sweep", *SMALL, "-o", str(path)]) == 0
    assert "has 5 of 16 cases already" in capsys.readouterr().out
    assert sorted(first.numbers + second.numbers) == [*range(SIZE)]
    assert path.read_bytes() == serial.read_bytes()
    monkeypatch.setattr(outcomes_file, "run_batches", third)
    assert main(["sweep", *SMALL, "-o", str(path)]) == 0
    assert third.numbers == []
    assert [each.name for each in tmp_path.iterdir()] == [path.name]


def test_the_file_is_written_from_time_to_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A process that is killed loses the results of seconds only."""
    path, seen = tmp_path / "sweep.parquet", []
    monkeypatch.setattr(outcomes_file, "PERIOD", 0.0)
    monkeypatch.setattr(outcomes_file, "LOAD", 0.0)

    def looking(batches: Sequence[tuple[Case, ...]], **_: object) -> Iterator[Outcome]:
        for case in chain.from_iterable(batches):
            yield Outcome(case.number, V_ratio=1.0)
            seen.append(len(table_of(path)["case"]))

    monkeypatch.setattr(outcomes_file, "run_batches", looking)
    assert main(["sweep", *SMALL, "-o", str(path)]) == 0
    assert seen == [*range(1, SIZE + 1)]


def test_the_file_of_another_sweep_is_never_overwritten(
    serial: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """No other file is overwritten, either."""
    path = tmp_path / "sweep.parquet"
    path.write_bytes(serial.read_bytes())
    assert main(["sweep", *SMALL, "--seed", "1", "-o", str(path)]) == 2
    line = f"{path}: holds another sweep: seed is 0 there and 1 here; name another file"
    assert capsys.readouterr().err == f"impact-observer: {line}\n"
    assert path.read_bytes() == serial.read_bytes()
    path.write_text("a letter")
    assert main(["sweep", *SMALL, "-o", str(path)]) == 2
    error = capsys.readouterr().err
    assert "is no sweep" in error
    assert len(error.splitlines()) == 1
    assert path.read_text() == "a letter"
    table = pq.read_table(serial)
    pq.write_table(table.replace_schema_metadata(None), path)
    assert main(["sweep", *SMALL, "-o", str(path)]) == 2
    assert f"{path}: exists and is no sweep; name another file" in capsys.readouterr().err


def test_a_case_that_fails_is_a_row_and_exit_code_1(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The other cases have results; running the command again does not change the row."""
    whole, path = case_runs.outcome_alone, tmp_path / "sweep.parquet"

    def broken(case: Case) -> Outcome:
        if case.number == 3:
            raise DynamicsError("no solution")
        return whole(case)

    def all_broken(_: Sequence[Case]) -> list[Outcome]:
        raise DynamicsError("one of them has no solution")

    monkeypatch.setattr(case_runs, "outcome_alone", broken)
    monkeypatch.setattr(case_runs, "outcomes_together", all_broken)
    words = ["sweep", "two_mass", "--runs", "5", "--duration", "1", "--jobs", "1", "--json"]
    for _ in range(2):
        assert main([*words, "-o", str(path)]) == 1
        printed = capsys.readouterr()
        line = "impact-observer: 1 of 5 cases failed, such as case 3: no solution"
        assert printed.err.splitlines()[-1] == line
        metrics = json.loads(printed.out)
        assert metrics["failed"] == metrics["groups"][0]["failed"] == 1
        assert metrics["groups"][0]["runs"] == 5
    table = table_of(path)
    assert table["error"] == ["", "", "", "no solution", ""]
    assert [value is None for value in table["V_end"]] == [False, False, False, True, False]


@pytest.mark.slow
def test_a_row_has_the_results_of_simulate_observe_and_compare(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """simulate, observe and compare with the values of the row come to the same figures."""
    path, plant, bag = tmp_path / "sweep.parquet", tmp_path / "plant", tmp_path / "bag"
    how = ("--duration", "4", "--rate", "20", "--jitter", "0.002", "--missed", "0.1")
    words = ("--laws", "unilateral", "--runs", "1", "--seed", "4", "--jobs", "1")
    assert main(["sweep", "three_mass", *words, *how, "-o", str(path)]) == 0
    assert main(["simulate", "three_mass", *how, "--seed", "4", "-o", str(plant)]) == 0
    law = ("--law", "unilateral", "--initial", "random:4", "--epoch", "1")
    assert main(["observe", str(plant), *law, "-o", str(bag)]) == 0
    capsys.readouterr()
    assert main(["compare", str(bag), "--json"]) == 0
    (metrics,) = json.loads(capsys.readouterr().out).values()
    table = table_of(path)
    for name in ("V_start", "V_end", "V_ratio", "V_largest_rise", "settling_time"):
        assert table[name] == [metrics[name]], name
    for name in ("rate_per_second", "rate_per_impact", "impacts_used", "switches_rejected"):
        assert table[name] == [metrics[name]], name


@pytest.mark.slow
def test_the_summary_is_a_table_and_a_picture(
    serial: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The summary of a finished file is made without running a case."""
    path, plot = tmp_path / "sweep.parquet", tmp_path / "sweep.svg"
    path.write_bytes(serial.read_bytes())
    words = ["--plot", str(plot), "--against", "stiffness-scale"]
    assert main(["sweep", *SMALL, *words, "-o", str(path)]) == 0
    printed = capsys.readouterr().out
    for word in ("jitter [s]", "observer's stiffness-scale", "not settled", "minimum-variance"):
        assert word in printed
    assert f"picture: {plot}" in printed
    assert plot.stat().st_size > 0


@pytest.mark.parametrize(
    ("package", "problem"),
    [
        ("joblib", "sweep needs joblib"),
        ("distributed", "--scheduler needs Dask"),
        ("pyarrow", "sweep needs pyarrow"),
    ],
)
def test_a_missing_package_is_named_with_its_extra(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    package: str,
    problem: str,
) -> None:
    """The error of one line names what to install."""
    import impact_observer.sweep

    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.delitem(sys.modules, "impact_observer.sweep.outcomes_file", raising=False)
    monkeypatch.delattr(impact_observer.sweep, "outcomes_file", raising=False)
    path = tmp_path / "sweep.parquet"
    words = ["--scheduler", "tcp://127.0.0.1:1"] if package == "distributed" else []
    assert main(["sweep", *SMALL, *words, "-o", str(path)]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"impact-observer: {problem}")
    assert re.search(r"; pip install .*pyarrow\n$", error)
    assert len(error.splitlines()) == 1
    assert not path.exists()


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (["-o", "sweep.csv"], "sweep.csv: expected a name that ends in .parquet"),
        (["--laws", "magic"], "law 'magic': not installed"),
        (["--off", "gap=0.4", "--off", "gap=0.5"], "off: gap found twice"),
        (["--against", "jitter"], "there is no picture"),
        (["--plot", "v.gif"], "v.gif: expected a name"),
        (["--plot", "v.png", "--against", "jitter"], "has not several values"),
        (["--mislabelled", "0.1"], "sensor mislabelled"),
        pytest.param(
            ["--scheduler", "nowhere"],
            "--scheduler nowhere: cannot be reached: missing port",
            marks=pytest.mark.slow,  # imports distributed
        ),
    ],
)
def test_what_cannot_be_swept_is_one_line_and_exit_code_2(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    words: list[str],
    problem: str,
) -> None:
    """The error comes before anything runs."""
    if "--scheduler" in words:
        pytest.importorskip("distributed")
    monkeypatch.chdir(tmp_path)
    assert main(["sweep", "two_mass", "-o", "sweep.parquet", *words]) == 2
    error = capsys.readouterr().err
    assert problem in error
    assert len(error.splitlines()) == 1
    assert [*tmp_path.iterdir()] == []


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (["--jitter", "0,late"], "0,late found; expected values with commas, each 0 to 1 s"),
        (["--jitter", "0,2"], "each 0 to 1 s"),
        (["--impacts-only", "perhaps"], "each true | false"),
        (["--off", "gap"], "expected NAME=V,V"),
        (["--jobs", "2", "--scheduler", "tcp://a:1"], "not allowed with"),
        (["--runs", "0"], "1 or more"),
    ],
)
def test_a_wrong_argument_is_one_line(
    capsys: pytest.CaptureFixture[str], words: list[str], problem: str
) -> None:
    """The line has what is expected."""
    with pytest.raises(SystemExit) as end:
        main(["sweep", "two_mass", "-o", "sweep.parquet", *words])
    assert end.value.code == 2
    error = capsys.readouterr().err
    assert problem in error
    assert len(error.splitlines()) == 1
