# SPDX-License-Identifier: Apache-2.0
"""export: the states, errors and events of a bag as tables of exact numbers."""

import csv
import math
import struct
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from impact_observer.cli.main import main
from impact_observer.compare.bag_comparison import compare_bag
from impact_observer.compare.table_files import TableBlock, write_table
from impact_observer.events import ImpactEstimate, ImpactEvent, Kind, Ruling, Switch
from impact_observer.io import BagReader, BagWriter
from impact_observer.io.bag_part import TimeZero
from impact_observer.io.messages import bag_messages
from impact_observer.io.recordings import model_of
from impact_observer.resources import shared

TRUTH, ESTIMATE = "/plant/joint_states", "/observer/state"
EPOCH = 1_000_000_000
Table = Mapping[str, Sequence[object]]


@pytest.fixture(scope="module")
def observed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag with ten seconds of two masses, and an observer whose sensor jitters."""
    folder = tmp_path_factory.mktemp("bags")
    plant, bag = str(folder / "plant"), str(folder / "bag")
    how = ("--duration", "5", "--rate", "200", "--jitter", "0.002", "--seed", "3")
    assert main(["simulate", "two_mass", *how, "-o", plant]) == 0
    assert main(["observe", plant, "--initial-state", "random:1", "-o", bag]) == 0
    return folder / "bag"


def exported(bag: Path, file: Path, *options: str) -> Table:
    """The table that a bag becomes, read back by another library."""
    if file.suffix == ".parquet":
        pytest.importorskip("pyarrow")
    assert main(["export", str(bag), "-o", str(file), *options]) == 0
    assert [each.name for each in file.parent.iterdir() if each.name.startswith(".")] == []
    if file.suffix == ".parquet":
        table = pytest.importorskip("pyarrow.parquet").read_table(file)
        return {name: table[name].to_pylist() for name in table.column_names}
    with file.open(newline="", encoding="utf-8") as lines:
        rows = list(csv.DictReader(lines))
    return {name: [row[name] for row in rows] for name in rows[0]}


def bits(values: Sequence[object]) -> bytes:
    """Bits of numbers, also of numbers in texts."""
    return struct.pack(f"{len(values)}d", *(float(str(value)) for value in values))


def of_topic(table: Table, topic: str, column: str) -> list[object]:
    """A column's rows of one topic."""
    return [v for v, own in zip(table[column], table["topic"], strict=True) if own == topic]


def same(column: Sequence[object], wanted: NDArray[np.float64]) -> bool:
    """Whether a column has exactly these numbers."""
    return bits(column) == np.ascontiguousarray(wanted).tobytes()


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_states_are_those_of_the_bag_bit_by_bit(
    observed: Path, tmp_path: Path, suffix: str
) -> None:
    """Rows have stamps as integers, and seconds since the epoch."""
    table = exported(observed, tmp_path / f"states{suffix}")
    head = ["topic", "stamp_ns", "time_s", "q_x1", "q_x2", "u_x1", "u_x2"]
    assert list(table) == head
    with BagReader(observed) as reader:
        states = {TRUTH: reader.joint_states(TRUTH), ESTIMATE: reader.observer_states(ESTIMATE)}
    assert len(table["topic"]) == sum(each.stamps.size for each in states.values()) == 2002
    for topic, each in states.items():
        stamps = [int(str(stamp)) for stamp in of_topic(table, topic, "stamp_ns")]
        assert stamps == each.stamps.tolist()
        assert same(of_topic(table, topic, "time_s"), (each.stamps - EPOCH) / 1e9)
        for k, name in enumerate(each.names):
            assert same(of_topic(table, topic, f"q_{name}"), each.q[:, k])
            assert same(of_topic(table, topic, f"u_{name}"), each.u[:, k])


def test_states_have_the_deviations_of_an_observer_with_a_covariance(tmp_path: Path) -> None:
    """Square roots of the messages' variances; the truth has none, and empty cells."""
    plant, bag = tmp_path / "plant", tmp_path / "bag"
    simulated = ["simulate", "bouncing_ball", "--duration", "1", "--rate", "20"]
    assert main([*simulated, "-o", str(plant)]) == 0
    assert main(["observe", str(plant), "--law", "minimum-variance", "-o", str(bag)]) == 0
    table = exported(bag, tmp_path / "states.csv")
    columns = ("deviation_q_height", "deviation_u_height")
    assert list(table)[-2:] == [*columns]
    with BagReader(bag) as reader:
        messages = [message.covariance for *_, message in reader.messages(ESTIMATE)]
    for k, column in enumerate(columns):
        assert set(of_topic(table, TRUTH, column)) == {""}
        assert same(of_topic(table, ESTIMATE, column), np.sqrt([each[3 * k] for each in messages]))


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_errors_are_what_compare_counts(observed: Path, tmp_path: Path, suffix: str) -> None:
    """Samples between the jumps of truth and estimate are left out; V comes along."""
    table = exported(observed, tmp_path / f"errors{suffix}", "--what", "errors")
    with BagReader(observed) as reader:
        comparison = compare_bag(reader, model_of(reader).system).comparisons["/observer"]
    assert comparison.mismatch.samples > 0
    assert [int(str(stamp)) for stamp in table["stamp_ns"]] == comparison.stamps.tolist()
    assert same(table["V"], comparison.V)
    for k, name in enumerate(("dq_x1", "dq_x2", "du_x1", "du_x2")):
        assert same(table[name], comparison.error[:, k])
    assert set(table["law"]) == {"geometric"}
    assert set(table["topic"]) == {ESTIMATE}


def test_estimates_before_their_events_are_left_out(tmp_path: Path, sample_bag: Path) -> None:
    """Here no estimate contains any event, as of a live observer."""
    file = tmp_path / "errors.csv"
    assert main(["export", str(sample_bag), "-o", str(file), "--what", "errors"]) == 1
    assert not file.exists()


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_events_are_imported_again(tmp_path: Path, suffix: str) -> None:
    """The table has a row for each contact, with stamps to the nanosecond."""
    make, bag = bag_messages(), tmp_path / "bag"
    events = [
        ImpactEvent(5_000_000_001, (Switch("a"), Switch("b", Kind.CLOSE)), 1, 2, 4_000_000_000),
        ImpactEvent(5_123_456_789, (Switch("b", Kind.OPEN),), 2, 2, 4_000_000_000),
    ]
    with BagWriter(bag) as writer:
        for event in events:
            writer.write("/impacts", event.stamp, make.event(event))
    table = exported(bag, tmp_path / f"events{suffix}", "--what", "events")
    assert table["contact"] == ["a", "b", "b"]
    assert table["kind"] == ["impact", "close", "open"]
    assert [int(str(each)) for each in table["sequence"]] == [1, 1, 2]
    assert [int(str(each)) for each in table["episode"]] == [2, 2, 2]
    if suffix == ".csv":
        again = tmp_path / "again"
        file = str(tmp_path / "events.csv")
        assert main(["import", file, "-o", str(again), "--time-zero", "4"]) == 0
        with BagReader(again) as reader:
            found = [(e.stamp, e.switches, e.epoch) for e in reader.events()]
        assert found == [(e.stamp, e.switches, e.epoch) for e in events]


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_impacts_have_a_column_for_each_number_and_its_deviation(
    tmp_path: Path, suffix: str
) -> None:
    """Cells are empty where a law has no deviation, and of a rejected impact."""
    impacts = {
        "/observer/impacts": [
            ImpactEstimate(EPOCH + 5, "a", Ruling.APPLIED, 7, 2.0, 1.0, 3.0, 1.5),
            ImpactEstimate(EPOCH + 6, "b", Ruling.REJECTED, 8),
        ],
        "/smoother/impact_estimates": [
            ImpactEstimate(EPOCH + 5, "a", Ruling.INSERTED, 0, 2, 1, 3, 1.5, 0.1, 0.2, 0.3, 0.4)
        ],
    }
    with BagWriter(tmp_path / "bag") as writer:
        event = ImpactEvent(EPOCH + 5, (Switch("a"),), 7, epoch=EPOCH)
        writer.write("/impacts", event.stamp, bag_messages().event(event))
        for topic, rows in impacts.items():
            for row in rows:
                writer.write(topic, row.stamp, bag_messages().impact_estimate(row))
    table = exported(tmp_path / "bag", tmp_path / f"impacts{suffix}", "--impacts")
    names = ("speed_before", "speed_after", "impulse", "energy_loss")
    head = ["topic", "contact", "verdict", "stamp_ns", "time_s", "sequence"]
    assert list(table) == [*head, *(n + end for n in names for end in ("", "_deviation"))]
    assert table["topic"] == [topic for topic, rows in impacts.items() for _ in rows]
    assert table["verdict"] == ["applied", "rejected", "inserted"]
    assert [float(str(each)) for each in table["time_s"]] == [5e-9, 6e-9, 5e-9]
    for k, name in enumerate(names, start=4):
        wanted = [impacts["/observer/impacts"][0][k], math.nan, (2, 1, 3, 1.5)[k - 4]]
        found = [float(str(each or "nan")) for each in table[name]]
        assert found == pytest.approx(wanted, nan_ok=True)
        deviations = [float(str(each or "nan")) for each in table[f"{name}_deviation"]]
        assert deviations == pytest.approx([math.nan, math.nan, (k - 3) / 10], nan_ok=True)
    only = exported(tmp_path / "bag", tmp_path / "one.csv", "--impacts", "--topics", "smoother")
    assert only["topic"] == ["/smoother/impact_estimates"]


def test_impacts_of_observe_account_for_every_event(tmp_path: Path) -> None:
    """Applied, rejected and inserted ones, in the order of their instants."""
    bag = tmp_path / "bag"
    given = ["--law", "minimum-variance", "--rate", "1", "--clock-error", "0.001"]
    assert main(["observe", str(shared("bags/missed_and_spurious")), *given, "-o", str(bag)]) == 0
    table = exported(bag, tmp_path / "impacts.csv", "--impacts")
    stamps = [int(str(each)) for each in table["stamp_ns"]]
    assert stamps == sorted(stamps)
    with BagReader(bag) as reader:
        sent = sorted(each.sequence for each in reader.events())
    reported = zip(table["sequence"], table["verdict"], strict=True)
    assert (
        sorted(int(str(number)) for number, verdict in reported if verdict != "inserted") == sent
    )
    assert {"applied", "inserted", "rejected"} == {*table["verdict"]}
    for verdict, speed, deviation in zip(
        table["verdict"], table["speed_before"], table["speed_before_deviation"], strict=True
    ):
        assert (verdict == "rejected") == (speed == "") == (deviation == "")


def test_only_the_topics_asked_for_are_exported(
    observed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A topic is chosen by its name or its observer."""
    file = tmp_path / "states.csv"
    table = exported(observed, file, "--topics", "observer")
    assert set(table["topic"]) == {ESTIMATE}
    assert f"1001 rows of states: 1001 of {ESTIMATE}" in capsys.readouterr().out
    joint = "/observer/joint_states"
    file.unlink()
    assert set(exported(observed, file, "--topics", joint, TRUTH)["topic"]) == {joint, TRUTH}


def test_long_bags_are_written_in_row_groups(observed: Path, tmp_path: Path) -> None:
    """Row groups keep the memory constant."""
    pq = pytest.importorskip("pyarrow.parquet")
    exported(observed, tmp_path / "states.parquet")
    found = pq.ParquetFile(tmp_path / "states.parquet")
    assert found.metadata.num_row_groups > 1
    assert found.metadata.num_rows == 2002
    assert found.schema_arrow.metadata[b"epoch_ns"] == b"1000000000"


def test_without_pyarrow_the_extra_is_named(
    observed: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The error is one line; CSV needs no extra."""
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert main(["export", str(observed), "-o", str(tmp_path / "states.parquet")]) == 2
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1
    assert "Parquet needs pyarrow" in error
    assert "pip install pyarrow" in error
    exported(observed, tmp_path / "states.csv")


def test_an_interruption_leaves_an_existing_file_unchanged(tmp_path: Path) -> None:
    """The file is replaced at the end only."""
    path = tmp_path / "x.csv"
    path.write_text("kept")

    def interrupted() -> Iterator[TableBlock]:
        stamps = np.array([1], dtype=np.int64)
        yield TableBlock("/x", TimeZero(0), stamps, {"topic": ["/x"]}, {})
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_table(path, interrupted())
    assert path.read_text() == "kept"
    assert [each.name for each in tmp_path.iterdir()] == ["x.csv"]
