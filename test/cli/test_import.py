# SPDX-License-Identifier: Apache-2.0
"""import: a CSV file of impact times becomes a bag that observe runs on."""

from pathlib import Path

import pytest

from impact_observer.cli.main import main
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.io import BagReader
from impact_observer.io.recordings import model_of

STOP = (Switch("stop"),)
EPOCH = 1_000_000_000
TABS = "1.500000000\tstop\t1\r\n \t\t\r\n2.5\tstop\topen"
QUOTED = '"2500.0","stop","open"\n'


def written(folder: Path, text: str) -> Path:
    """A file with a text, byte for byte."""
    path = folder / "rig.csv"
    path.write_bytes(text.encode())
    return path


def imported(folder: Path, text: str, *options: str) -> list[ImpactEvent]:
    """The events from the text of a file."""
    path = written(folder, text)
    assert main(["import", str(path), "-o", str(folder / "bag"), *options]) == 0
    with BagReader(folder / "bag") as reader:
        return list(reader.events())


def refused(
    folder: Path, text: str, capsys: pytest.CaptureFixture[str], *options: str, code: int = 2
) -> str:
    """The error line for a text, without the file's name; no bag is left."""
    path = written(folder, text)
    assert main(["import", str(path), "-o", str(folder / "bag"), *options]) == code
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1
    assert not (folder / "bag").exists()
    start = f"impact-observer: {path}"
    assert error.startswith(start)
    return error[len(start) :].strip()


def test_observe_runs_on_an_imported_bag(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The bag has its model; without truth ``observe`` asks for a rate."""
    events = imported(tmp_path, "0.53\n2.7\n3.1\n", "--model", "two_mass")
    assert [event.stamp for event in events] == [1_530_000_000, 3_700_000_000, 4_100_000_000]
    assert all(event.switches == STOP for event in events)
    assert [event.sequence for event in events] == [1, 2, 3]
    assert {event.epoch for event in events} == {EPOCH}
    with BagReader(tmp_path / "bag") as reader:
        assert model_of(reader).system.name == "two_mass"
    bags = [str(tmp_path / "bag"), "-o", str(tmp_path / "observed")]
    assert main(["observe", *bags]) == 2
    assert "carries no truth to sample with; give --rate" in capsys.readouterr().err
    assert main(["observe", *bags, "--rate", "50"]) == 0
    assert "3 applied" in capsys.readouterr().out


@pytest.mark.parametrize(
    "text",
    [
        "time,contact,kind\n0.5,stop,impact\n1.5,stop,close\n2.5,stop,open\n",
        "0.5,stop\n1.5,stop,CLOSE\n2.5,stop,2\n",
        "kind;force;Time;contact\n;3,7;0,5;stop\nClose;;1,5;stop\nopen;;2,5;stop\n",
        "\ufefftime\tcontact\tkind\r\n\r\n# no ; here\r\n5e-1\tstop\r\n" + TABS,
        "# by a logger\ntime [ms],contact,kind\n500,stop\n1500, stop ,close\n" + QUOTED,
        "time_ns,contact,kind\n500000000,stop,\n1500000000,stop,close\n2500000000,stop,open\n",
    ],
)
def test_common_dialects_of_csv_are_read(tmp_path: Path, text: str) -> None:
    """Headers in any order or none, three separators, decimal commas, comments, BOM, CRLF."""
    events = imported(tmp_path, text)
    assert [event.stamp - EPOCH for event in events] == [500_000_000, 1_500_000_000, 2_500_000_000]
    kinds = [(event.switches[0].contact, event.switches[0].kind) for event in events]
    assert kinds == [("stop", Kind.IMPACT), ("stop", Kind.CLOSE), ("stop", Kind.OPEN)]


def test_rows_of_equal_time_are_one_event(tmp_path: Path) -> None:
    """Times count as equal to the nanosecond, in any notation."""
    text = "0.5,left\n0.500000000,right\n0.500000001,left\n0.5000000014,right,close\n"
    first, second = imported(tmp_path, text, "--model", "three_mass")
    assert first.switches == (Switch("left"), Switch("right"))
    assert second.switches == (Switch("left"), Switch("right", Kind.CLOSE))
    assert second.stamp - first.stamp == 1


@pytest.mark.slow
def test_time_zero_has_the_chosen_stamp(tmp_path: Path) -> None:
    """Times since 1970 are stamps; others begin at 1 s; the epoch may be another instant."""
    cases: list[tuple[str, tuple[str, ...], int, int]] = [
        ("0,stop", (), EPOCH, EPOCH),
        ("1700000000.123456789,stop", (), 1_700_000_000_123_456_789, 0),
        ("1700000000.5,stop", ("--epoch", "1700000000"), 1_700_000_000_500_000_000, 17 * 10**17),
        ("0.25,stop", ("--time-zero", "7.5"), 7_750_000_000, 7_500_000_000),
        ("0.25,stop", ("--time-zero", "7.5", "--epoch", "7"), 7_750_000_000, 7_000_000_000),
        ("0.25,stop", ("--time-zero", "0"), 250_000_000, 0),
        ("250,stop", ("--time-unit", "ms"), EPOCH + 250_000_000, EPOCH),
    ]
    for k, (text, options, stamp, epoch) in enumerate(cases):
        folder = tmp_path / str(k)
        folder.mkdir()
        (event,) = imported(folder, text, *options)
        assert (event.stamp, event.epoch) == (stamp, epoch)


def test_rows_are_sorted_on_demand(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Without the option unsorted rows are an error; ignored columns are named."""
    text = "time,contact,peak,note\n2.5,stop,1,a\n0.5,stop,2,b\n"
    assert "`sort`" in refused(tmp_path, text, capsys)
    events = imported(tmp_path, text, "--sort")
    assert [event.stamp for event in events] == [1_500_000_000, 3_500_000_000]
    printed = capsys.readouterr().out
    assert "2 events of 2 rows, times in s, stamps 1.500000000 to 3.500000000 s" in printed
    assert "time 0 is stamp 1.000000000 s, epoch 1.000000000 s" in printed
    assert "columns left out: peak, note" in printed


@pytest.mark.parametrize(
    ("text", "options", "said"),
    [
        ("", (), "time[, contact[, kind]]"),
        ("\n# nothing\n\n", (), "time[, contact[, kind]]"),
        ("time,contact\n", (), "time[, contact[, kind]]"),
        ("0.5,stop\n\n0.6x,stop\n", (), "line 3: '0.6x'"),
        ("0.5,stop\nnan,stop\n", (), "line 2: 'nan'"),
        ("0.5,stop\n1e99999999999999999999,stop\n", (), "line 2: '1e99999999999999999999'"),
        ("time,contact\n1,stop\n,stop\n", (), "line 3: ''"),
        ("0.5,stop\n1e12,stop\n", (), "line 2: '1e12'"),
        ("# x\n0.5\n", (), "line 2: names no contact"),
        ("1.0\t1.0\t\n1.9\t1.9\t\n", (), "line 1: names no contact"),
        ("0.5,\n0.7,3\n", (), "line 1: names no contact"),
        ("time,contact\n0.5,1\n", (), "contact '1': a number"),
        ("time,contact\n0.5,\n", ("--model", "three_mass"), "one of right, left"),
        ("0.5,anvil\n", ("--model", "two_mass"), "line 1: contact 'anvil'"),
        ("0.5,stop,hit\n", (), "line 1: kind 'hit'"),
        ("time,contact\n0.5,stop,0\n", (), "line 2: 3 columns"),
        ("time,contact,contact\n1,a,b\n", (), "two columns contact"),
        ("0.5,stop\n0.5,stop\n", (), "line 2: impact of 'stop' stands in line 1"),
        ("-1,stop\n", ("--time-zero", "1"), "0.000000000 s; expected"),
        ("-1,stop\n", ("--time-zero", "1"), "--time-zero 2"),
        ("0,stop\n", ("--time-zero", "0"), "0.000000000 s; expected more than 0"),
        ("0.5,stop\n", ("--epoch", "9"), "1.500000000 s; expected 9."),
        ('0.5,stop\n"0.6,stop\n', (), "line 2: a quotation mark"),
        ("1,stop\n", ("--time-column", "t"), "no column t in time, contact"),
        ("1,stop\n", ("--frame-rate", "25"), "--frame-rate"),
    ],
)
def test_a_mistake_is_one_line_with_its_number(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    text: str,
    options: tuple[str, ...],
    said: str,
) -> None:
    """The error has what was found; the exit code is 2, and no bag is left."""
    assert said in refused(tmp_path, text, capsys, *options)


@pytest.mark.parametrize(
    ("text", "stamps"),
    [
        ("0.500000000\n1.300000000\n", [500, 1300]),
        ("0.500000000 stop\n1.300000000 stop\n", [500, 1300]),
        ("0.5\t0.53\tstop\n\\\t100.0\t2200.0\n1.3\t1.33\tstop\n", [500, 1300]),
        ("0.5\t0.5\t\n1.3\t1.3\t\n", [500, 1300]),
        ("0,5\n1,3\n12\n", [500, 1300, 12000]),
        ("frame,contact\n50,stop\n130,stop\n", [500, 1300]),
        ("0.5000\n1.3000\n1.4000\n1.5000\n1.7", [500, 1300, 1400, 1500]),
    ],
    ids=["bare", "blank", "labels", "empty_labels", "decimal_commas", "frames", "cut"],
)
def test_impact_times_come_in_the_same_tables_as_signals(
    tmp_path: Path, text: str, stamps: list[int]
) -> None:
    """Also as labels of Audacity: start, end, label; a last line that is cut is left out."""
    options = ["--frame-rate", "100"] if "frame" in text else []
    events = imported(tmp_path, text, "--model", "two_mass", *options)
    assert [event.stamp - EPOCH for event in events] == [10**6 * each for each in stamps]


STATES = "time,q_x1,u_x1,x2,u_x2\n0.25,1,2,3,4\n0.5,5,6,7,8\n"


def test_true_states_of_a_file_are_those_of_the_bag(tmp_path: Path) -> None:
    """The exported states and events of a run are equal after their import."""
    plant, again = tmp_path / "plant", tmp_path / "again"
    assert main(["simulate", "two_mass", "--duration", "3", "--rate", "20", "-o", str(plant)]) == 0
    for what in ("states", "events"):
        file = tmp_path / f"{what}.csv"
        assert main(["export", str(plant), "-o", str(file), "--what", what]) == 0
    files = [str(tmp_path / "events.csv"), "--truth", str(tmp_path / "states.csv")]
    assert main(["import", *files, "--model", "two_mass", "-o", str(again)]) == 0
    with BagReader(plant) as one, BagReader(again) as other:
        assert [each.stamp for each in one.events()] == [each.stamp for each in other.events()]
        first, second = (bag.joint_states("/plant/joint_states") for bag in (one, other))
    assert first.stamps.tolist() == second.stamps.tolist()
    assert first.q.tolist() == second.q.tolist()
    assert first.u.tolist() == second.u.tolist()


def test_positions_may_be_called_as_their_coordinates(tmp_path: Path) -> None:
    """At an impact the event comes first, as the state is the one after the impact."""
    (tmp_path / "truth.csv").write_text(STATES)
    options = ("--model", "two_mass", "--truth", str(tmp_path / "truth.csv"))
    imported(tmp_path, "0.5,stop\n", *options)
    with BagReader(tmp_path / "bag") as reader:
        states = reader.joint_states("/plant/joint_states")
        topics = [raw.topic for raw in reader.raw(["/impacts", "/plant/joint_states"])]
    assert states.q.tolist() == [[1, 3], [5, 7]]
    assert states.u.tolist() == [[2, 4], [6, 8]]
    assert topics == ["/plant/joint_states", "/impacts", "/plant/joint_states"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("time,x1,x2\n0,1,2\n", "line 1"),
        ("time,x1,q_x1,u_x1,x2,u_x2\n0,1,1,1,1,1\n", "line 1: columns q_x1 and x1"),
        (STATES.replace("7", "nan"), "line 3: x2 is 'nan'"),
        (STATES.replace("0.25", "0.75"), "line 3: the clock steps back by 0.25 s"),
        ("0.5,1,2,3,4\n0.6,1,2,3,4\n", "line 1: columns column2"),
    ],
)
def test_a_mistake_in_true_states_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, said: str
) -> None:
    """The error names file and line; no bag is left."""
    truth, path = tmp_path / "truth.csv", written(tmp_path, "0.5,stop\n")
    truth.write_text(text)
    options = ["--model", "two_mass", "--truth", str(truth), "-o", str(tmp_path / "bag")]
    assert main(["import", str(path), *options]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert line.startswith(f"impact-observer: {truth}, ")
    assert said in line
    assert not (tmp_path / "bag").exists()


def test_true_states_need_a_model(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The model names the coordinates."""
    truth, path = tmp_path / "truth.csv", written(tmp_path, "0.5,stop\n")
    truth.write_text(STATES)
    assert main(["import", str(path), "--truth", str(truth), "-o", str(tmp_path / "bag")]) == 2
    assert "true states without a model; name it with --model" in capsys.readouterr().err


@pytest.mark.parametrize("rate", [16000, 1000, 3])
def test_a_signal_is_not_taken_for_impacts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], rate: int
) -> None:
    """Equally spaced rows, up to rounding, with a column of numbers; uneven ones are impacts."""
    rows = [f"{k / rate:.6f},{k % 7 - 9.81}" for k in range(200)]
    model = ("--model", "bouncing_ball")
    said = refused(tmp_path, "\n".join(["time,az", *rows]), capsys, *model)
    assert "detect" in said
    rows[50] = f"{50 / rate + 1e-5:.6f},1"
    text = "\n".join(["time,az", *rows])
    assert len(imported(tmp_path, text, *model)) == 200
