# SPDX-License-Identifier: Apache-2.0
"""sweep: equal rows from one process, several processes and a cluster."""

import io
import json
import re
import statistics
import sys
from contextlib import redirect_stdout
from itertools import product
from pathlib import Path

import pytest

pytest.importorskip("joblib")
pytest.importorskip("pyarrow")

import numpy as np
import pyarrow.parquet as pq

from impact_observer.cli.main import main
from impact_observer.errors import DynamicsError
from impact_observer.observer import Observer
from impact_observer.states import Matrix

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
    """The small sweep by one process; beside it is what ``--json`` prints."""
    path = tmp_path_factory.mktemp("serial") / "sweep.parquet"
    with redirect_stdout(io.StringIO()) as printed:
        assert main(["sweep", *SMALL, "--jobs", "1", "--json", "-o", str(path)]) == 0
    path.with_suffix(".json").write_text(printed.getvalue(), "utf-8")
    return path


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
        assert main(["sweep", *SMALL, "--dask", address, "-o", str(path)]) == 0
    assert path.read_bytes() == serial.read_bytes()


def test_a_case_that_fails_is_a_row_and_exit_code_1(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The other cases, which run together, have results."""
    path = tmp_path / "sweep.parquet"

    def broken(observer: Observer, replicas: Matrix) -> None:
        if any(np.array_equal(each, third) for each in replicas):
            raise DynamicsError("no solution")
        start_from(observer, replicas)

    start_from, third = Observer.start_from, np.random.default_rng(3).normal(size=4)
    monkeypatch.setattr(Observer, "start_from", broken)
    words = ["sweep", "two_mass", "--runs", "5", "--duration", "1", "--jobs", "1", "--json"]
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
    law = ("--law", "unilateral", "--initial-state", "random:4", "--epoch", "1")
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
def test_the_summary_has_a_row_for_each_combination(
    serial: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Medians are those of the rows; a picture is drawn beside the file."""
    path, plot = tmp_path / "sweep.parquet", tmp_path / "sweep.svg"
    words = ["--jobs", "1", "--plot", str(plot), "-o", str(path)]
    assert main(["sweep", *SMALL, *words]) == 0
    printed = capsys.readouterr().out
    for word in ("jitter [s]", "observer's stiffness-scale", "not settled", "minimum-variance"):
        assert word in printed
    assert f"picture: {plot}" in printed
    assert plot.stat().st_size > 0
    assert main(["sweep", *SMALL, *words, "--json"]) == 2
    assert f"{path}: exists already; remove it" in capsys.readouterr().err
    groups = json.loads(serial.with_suffix(".json").read_text("utf-8"))["groups"]
    assert [(g["law"], g["sensor_jitter"], g["off_stiffness-scale"]) for g in groups] == [
        *product(("geometric", "minimum-variance"), (0.0, 0.001), (1.0, 1.02))
    ]
    ratios = table_of(path)["V_ratio"]
    for group, pair in zip(groups, batched(ratios), strict=True):
        assert group["V_ratio"]["median"] == pytest.approx(statistics.median(pair), rel=1e-12)


def batched(values: list[object]) -> list[tuple[float, float]]:
    """Neighbours in pairs: the two runs of each group."""
    return list(zip(map(float, values[::2]), map(float, values[1::2]), strict=True))  # type: ignore[arg-type]


def test_a_fault_that_a_sensor_has_or_has_not_is_yes_or_no(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In the rows of the summary, and true or false in JSON."""
    words = ["sweep", "two_mass", "--runs", "1", "--duration", "1", "--rate", "5", "--jobs", "1"]
    words += ["--impacts-only", "no,yes", "-o"]
    assert main([*words, str(tmp_path / "a.parquet")]) == 0
    rows = [row.split()[:2] for row in capsys.readouterr().out.splitlines()]
    assert [row[1] for row in rows if row[:1] == ["geometric"]] == ["no", "yes"]
    assert main([*words, str(tmp_path / "b.parquet"), "--json"]) == 0
    groups = json.loads(capsys.readouterr().out)["groups"]
    assert [each["sensor_impacts_only"] for each in groups] == [False, True]


@pytest.mark.slow
def test_runs_that_never_settle_are_not_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Their settling time is never in the table, null in JSON and missing in the file."""
    path = tmp_path / "sweep.parquet"
    words = ["sweep", "two_mass", "--runs", "2", "--duration", "1", "--jobs", "1"]
    words += ["-o", str(path)]
    assert main(words) == 0
    path.unlink()
    row = capsys.readouterr().out.splitlines()[2].split()
    assert row[:4] == ["geometric", "2", "never", "100%"]
    assert main([*words, "--json", "--plot", str(tmp_path / "sweep.png")]) == 0
    (group,) = json.loads(capsys.readouterr().out)["groups"]
    assert group["settling_time"] == {"low": None, "median": None, "high": None}
    assert group["not_settled"] == 1.0
    assert table_of(path)["settling_time"] == [None, None]


@pytest.mark.parametrize(
    ("package", "problem"),
    [
        ("joblib", "sweep needs joblib, pyarrow"),
        ("distributed", "--dask needs Dask"),
        ("pyarrow", "sweep needs joblib, pyarrow"),
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
    for name in ("engine", "cases", "summary"):
        monkeypatch.delitem(sys.modules, f"impact_observer.sweep.{name}", raising=False)
        monkeypatch.delattr(impact_observer.sweep, name, raising=False)
    path = tmp_path / "sweep.parquet"
    words = ["--dask", "tcp://127.0.0.1:1"] if package == "distributed" else []
    assert main(["sweep", *SMALL, *words, "-o", str(path)]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"impact-observer: {problem}")
    assert re.search(rf"; pip install .*{package}.*\n$", error)
    assert len(error.splitlines()) == 1
    assert not path.exists()
