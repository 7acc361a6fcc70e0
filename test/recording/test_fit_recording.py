# SPDX-License-Identifier: Apache-2.0
"""fit: from a recording of a simulated rig to numbers, a table of impacts and a picture."""

import csv
import io
from collections.abc import Callable
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
import pytest
from scipy.io import wavfile
from two_masses import MODEL

from impact_observer.cli.main import main
from impact_observer.io import BagReader, BagWriter, Quality
from impact_observer.io.messages import bag_messages
from impact_observer.io.typestores import typestore
from impact_observer.model import read_model
from impact_observer.plant import Run, simulate
from impact_observer.recording.fit_page import fit_recording
from impact_observer.recording.impacts_in_recording import Task, read_recording
from impact_observer.stamps import grid

EPOCH = 10**9
SECONDS = 22.0
FILES = {"fitted.yaml", "impacts.csv", "motion.png", "smoothed"}
UNKNOWN = "{value: 0.6, deviation: 0.1}"


@pytest.fixture(scope="module")
def run() -> Run:
    """The plant, whose restitution is 0.7."""
    return simulate("two_mass", grid(EPOCH, EPOCH + int(SECONDS * 1e9), 100.0))


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the model of the rig, whose restitution is known roughly."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig.yaml").write_text(MODEL.replace("RESTITUTION", UNKNOWN))
    return tmp_path


def instants(run: Run) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Instants of the impacts, s since the epoch."""
    return np.array([(each.stamp - EPOCH) / 1e9 for each in run.events])


def typed_times(run: Run, folder: Path) -> Path:
    """A table of times with four digits, below two lines of words."""
    path = folder / "times.txt"
    path.write_text("hits of the rig\n\n" + "\n".join(f"{t:.4f}" for t in instants(run)))
    return path


def oscilloscope(run: Run, folder: Path) -> Path:
    """A CSV of a ringing accelerometer at 1 kHz, with semicolons and decimal commas."""
    t = np.arange(int(SECONDS * 1000)) / 1000
    a = 0.05 * np.random.default_rng(1).normal(size=t.size) + 9.81
    for hit, speed in zip(instants(run), speeds(run), strict=True):
        s = np.maximum(t - hit, 0.0)
        a += 20 * speed * np.exp(-s / 0.02) * np.sin(2 * np.pi * 150 * s)
    path = folder / "scope.csv"
    rows = "\n".join(f"{x:.3f};{y:.4f}".replace(".", ",") for x, y in zip(t, a, strict=True))
    path.write_text(f"t [s];a [m/s^2]\n{rows}\n")
    return path


def sound(run: Run, folder: Path) -> Path:
    """A WAV of clicks that fade within some milliseconds."""
    rate = 4000
    t = np.arange(int(SECONDS * rate)) / rate
    x = 0.002 * np.random.default_rng(2).normal(size=t.size)
    for hit, speed in zip(instants(run), speeds(run), strict=True):
        s = np.maximum(t - hit, 0.0)
        x += 0.1 * speed * np.exp(-s / 0.002) * np.sin(2 * np.pi * 1000 * s)
    path = folder / "hits.wav"
    wavfile.write(path, rate, (32767 * np.clip(x, -1, 1)).astype(np.int16))
    return path


def bag(_run: Run, folder: Path) -> Path:
    """A bag of the plant."""
    with redirect_stdout(io.StringIO()):
        words = ["simulate", "two_mass", "--duration", str(SECONDS), "--rate", "1", "-o"]
        assert main([*words, str(folder / "bag")]) == 0
    return folder / "bag"


def switch_line(run: Run, folder: Path, *, opens: bool, volts: float) -> Path:
    """A CSV at 1 kHz of a switch that closes, or ``opens``, for some ms at a hit, with noise."""
    t = np.arange(int(SECONDS * 1000)) / 1000
    closed = np.zeros(t.size, dtype=bool)
    for hit in instants(run):
        closed[(t >= hit) & (t < hit + 0.004)] = True
    level = volts * (closed != opens)
    if volts > 1:
        level = level + 0.02 * volts * np.random.default_rng(3).normal(size=t.size)
    path = folder / "switch.csv"
    rows = "\n".join(f"{x:.3f},{y:g}" for x, y in zip(t, level, strict=True))
    path.write_text(f"time,line\n{rows}\n")
    return path


def sensor_bag(
    run: Run, folder: Path, type_name: str, *, stepping_back: bool = False, opens: bool = False
) -> str:
    """A bag of a sensor that reports each hit, and once more 2 ms later; returns its name."""
    types, make = typestore().types, bag_messages()
    hits = [(each.stamp + late, not late) for each in run.events for late in (0, 2_000_000)]
    rows = [(stamp, stamp, is_closed) for stamp, is_closed in hits]
    if stepping_back:
        rows.append((hits[-1][0] + 1, hits[0][0], False))
    with BagWriter(folder / "bag") as writer:
        writer.declare("/sensor", type_name=type_name, quality=Quality(reliable=False))
        for log_time, stamp, is_closed in rows:
            if type_name.endswith("Header"):
                message = types[type_name](stamp=make.time(stamp), frame_id="hit")
            else:
                message = types[type_name](data=is_closed != opens)
            writer.write("/sensor", log_time, message)
    return "bag"


def speeds(run: Run) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """True contact speeds before the impacts, m/s: of x2, whose stop does not move."""
    fine = simulate("two_mass", np.array([EPOCH, *(each.stamp - 1 for each in run.events)]))
    return np.asarray(fine.states[1:, 3])


@pytest.mark.parametrize(
    "recorded", [typed_times, bag, pytest.param(oscilloscope, marks=pytest.mark.slow)]
)
def test_one_command_gives_numbers_table_and_picture(
    recorded: Callable[[Run, Path], Path], run: Run, rig: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The restitution, the speed before each impact, and all files; few lines."""
    recording = recorded(run, rig)
    assert main(["fit", recording.name, "rig.yaml", "-o", "out"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) <= 15
    assert any(line.startswith("fits: ") for line in lines)
    made = {path.name for path in (rig / "out").iterdir()}
    assert made - {"sources.yaml"} == FILES
    fitted = read_model(rig / "out" / "fitted.yaml")
    assert fitted.system.eps[0] == pytest.approx(0.7, abs=0.01)
    with BagReader(rig / "out" / "smoothed") as reader:
        (topic,) = reader.impact_topics()
        found = [*reader.impact_estimates(topic)]
    truth = speeds(run)
    assert len(found) == truth.size
    estimates = np.array([each.speed_before for each in found])
    deviations = np.array([each.speed_before_deviation for each in found])
    error = np.abs(estimates - truth)
    assert np.all((error < 0.02 * truth) | (error < 2 * deviations))
    with (rig / "out" / "impacts.csv").open() as file:
        table = [*csv.DictReader(file)]
    assert [float(row["speed_before"]) for row in table] == pytest.approx(estimates)


@pytest.mark.long
def test_the_sources_that_are_written_repeat_the_detection(run: Run, rig: Path) -> None:
    """The same impacts by ``--sources out/sources.yaml``."""
    recording = oscilloscope(run, rig).name
    assert main(["fit", recording, "rig.yaml", "-o", "out"]) == 0
    words = ["fit", recording, "rig.yaml", "-o", "again", "--sources", "out/sources.yaml"]
    assert main(words) == 0
    first, again = ((rig / each / "impacts.csv").read_text() for each in ("out", "again"))
    assert first == again


def test_a_model_that_does_not_fit_is_marked_and_everything_is_written(
    run: Run, rig: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A restitution that is taken as typed, 0.65: exit code 1, and the number is named."""
    (rig / "rig.yaml").write_text(MODEL.replace("RESTITUTION", "0.65"))
    recording = typed_times(run, rig).name
    assert main(["fit", recording, "rig.yaml", "-o", "out", "--epoch", "1"]) == 1
    assert "restitution.stop" in capsys.readouterr().out
    with (rig / "out" / "impacts.csv").open() as file:
        assert {row["model"] for row in csv.DictReader(file)} == {"does not fit"}
    assert {path.name for path in (rig / "out").iterdir()} == FILES
    assert read_model(rig / "out" / "fitted.yaml").misfit


def test_numbers_that_times_do_not_tell_are_counted(
    run: Run, rig: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A gap and a force that both are larger by one factor make the same times.

    With ``--epoch`` the phase is no number to identify.
    """
    text = MODEL.replace("RESTITUTION", UNKNOWN)
    text = text.replace("limit: 0.5", "limit: {value: 0.5, deviation: 0.05}")
    (rig / "rig.yaml").write_text(
        text.replace("amplitude: 4", "amplitude: {value: 4, deviation: 0.4}")
    )
    words = [typed_times(run, rig).name, "rig.yaml", "-o", "out", "--epoch", "1"]
    assert main(["fit", *words]) == 0
    assert "2 of these 3 numbers" in capsys.readouterr().out


def test_a_value_far_from_its_prior_is_doubted(
    run: Run, rig: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A gap that is six declared deviations away, though the model fits."""
    text = MODEL.replace("RESTITUTION", UNKNOWN)
    (rig / "rig.yaml").write_text(
        text.replace("limit: 0.5", "limit: {value: 0.59, deviation: 0.015}")
    )
    recording = typed_times(run, rig).name
    assert main(["fit", recording, "rig.yaml", "-o", "out", "--epoch", "1"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith("doubt: gap.stop") for line in lines)


def test_a_known_epoch_keeps_the_phase_and_no_start_is_needed(run: Run, rig: Path) -> None:
    """With ``--epoch`` the phase is no number to identify; a start in the fitted stop goes."""
    text = MODEL.replace("limit: 0.5", "limit: {value: 0.52, deviation: 0.05}")
    start = "initial_state: {position: [0, 0.51], velocity: [0, 0]}\n"
    (rig / "rig.yaml").write_text(text.replace("RESTITUTION", UNKNOWN) + start)
    assert main(["fit", typed_times(run, rig).name, "rig.yaml", "-o", "out", "--epoch", "1"]) == 0
    assert "phase" not in (rig / "out" / "fitted.yaml").read_text().split("provenance")[1]
    assert read_model(rig / "out" / "fitted.yaml").position is None


def said_before_the_fit(recording: Path, sources: Path | None = None) -> list[str]:
    """What is said of a recording; the fit is then interrupted, and leaves no folder."""
    said, out = list[str](), Path("out")

    def interrupt(what: str) -> None:
        if what.startswith("rig: "):
            shown = {"motion.png", "sources.yaml"} & {each.name for each in out.iterdir()}
            said.extend(sorted(shown))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fit_recording(recording, "rig.yaml", out, sources=sources, say=said.append, show=interrupt)
    assert not out.exists()
    return said


@pytest.mark.parametrize("recorded", [oscilloscope, sound])
def test_the_signal_is_shown_before_the_fit_begins(
    recorded: Callable[[Run, Path], Path], run: Run, rig: Path
) -> None:
    """Count, options and picture."""
    said = said_before_the_fit(recorded(run, rig))
    assert any(f"{len(run.events)} impacts of stop; --threshold" in each for each in said)
    assert said[-2:] == ["motion.png", "sources.yaml"]


def test_doubts_of_a_recording_are_said_before_the_fit_begins(run: Run, rig: Path) -> None:
    """A message stamped before an earlier one is left out."""
    recording = rig / sensor_bag(run, rig, "std_msgs/msg/Header", stepping_back=True)
    said = said_before_the_fit(recording)
    assert any(each.startswith("doubt: ") and "/sensor" in each for each in said)


def test_the_first_time_of_a_signal_does_not_matter(run: Run, rig: Path) -> None:
    """An oscilloscope before its trigger, and a logger that has run for an hour."""
    header, *rows = oscilloscope(run, rig).read_text().splitlines()
    times = [float(row.split(";")[0].replace(",", ".")) for row in rows]
    model, found = read_model(rig / "rig.yaml"), []
    for begin in (0.0, -10.5, 3600.0):
        moved = (f"{t + begin:.3f};".replace(".", ",") for t in times)
        values = (row.split(";")[1] for row in rows)
        table = rig / f"from{begin:g}.csv"
        table.write_text("\n".join([header, *map("".join, zip(moved, values, strict=True))]))
        recorded = read_recording(Task(table, model), rig / f"{table.stem}_bag")
        with BagReader(recorded.bag) as reader:
            stamps = np.array([each.stamp for each in reader.events()])
        assert 0 < stamps[0] - recorded.epoch < SECONDS * 1e9
        found.append(stamps - stamps[0])
    assert found[0].size == len(run.events)
    for each in found:
        assert each == pytest.approx(found[0], abs=1000)


@pytest.mark.parametrize(
    ("type_name", "sources"),
    [
        ("std_msgs/msg/Header", ""),
        ("std_msgs/msg/Bool", ""),
        ("std_msgs/msg/UInt8", "sources: [{contact: stop, topic: /sensor, kind: switch}]"),
    ],
)
def test_sensors_without_a_threshold_need_none(
    type_name: str, sources: str, run: Run, rig: Path
) -> None:
    """Arrivals and switches of a microcontroller: each hit is one impact."""
    (rig / "sensors.yaml").write_text(sources)
    recording = rig / sensor_bag(run, rig, type_name)
    said = said_before_the_fit(recording, rig / "sensors.yaml" if sources else None)
    assert any(f"{len(run.events)} impacts of stop" in each for each in said)


@pytest.mark.parametrize("opens", [False, True])
@pytest.mark.parametrize("volts", [1.0, 5.0])
def test_a_line_with_two_levels_is_a_switch_of_short_contacts(
    volts: float, opens: bool, run: Run, rig: Path
) -> None:
    """A column of 0 and 1, and a noisy line of 5 V, of switches that close or open at a hit."""
    said = said_before_the_fit(switch_line(run, rig, opens=opens, volts=volts))
    words = "switch, inverted" if opens else "switch"
    assert any(f"{len(run.events)} impacts of stop; {words}, dead" in each for each in said)


def test_a_switch_in_a_bag_that_opens_at_a_hit_is_inverted(run: Run, rig: Path) -> None:
    """Contacts are shorter than flights."""
    said = said_before_the_fit(rig / sensor_bag(run, rig, "std_msgs/msg/Bool", opens=True))
    assert any(f"{len(run.events)} impacts of stop; switch, inverted" in each for each in said)


def test_a_switch_without_a_message_is_named(
    rig: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A topic that nobody published on; exit code 1, and no folder."""
    with BagWriter(rig / "bag") as writer:
        writer.declare("/sensor", type_name="std_msgs/msg/Bool", quality=Quality(reliable=False))
    assert main(["fit", "bag", "rig.yaml", "-o", "out", "--epoch", "1"]) == 1
    assert "/sensor" in capsys.readouterr().err
    assert not (rig / "out").exists()


def test_forces_of_one_frequency_keep_their_phases_to_each_other(run: Run, rig: Path) -> None:
    """Without an epoch two forces half a turn apart are late by one time."""
    pair = (
        "forces: [{body: x2, amplitude: 6, frequency: 2.5},"
        " {body: x2, amplitude: 2, frequency: 2.5, phase: 3.141592653589793}]"
    )
    (force,) = (line for line in MODEL.splitlines() if line.startswith("forces"))
    text = MODEL.replace(force, pair).replace("RESTITUTION", UNKNOWN)
    (rig / "rig.yaml").write_text(text)
    assert main(["fit", typed_times(run, rig).name, "rig.yaml", "-o", "out"]) == 0
    fitted = read_model(rig / "out" / "fitted.yaml")
    assert fitted.system.eps[0] == pytest.approx(0.7, abs=0.01)
    cosine, sine = fitted.system.forcing.cosine[:, 1], fitted.system.forcing.sine[:, 1]
    first, second = np.arctan2(-sine, cosine)
    assert np.cos(second - first) == pytest.approx(-1.0)
    assert fitted.uncertainty is not None
    correlation = fitted.uncertainty.correlation(["forcing-phase.1", "forcing-phase.2"])
    assert correlation == pytest.approx(np.ones((2, 2)))


def test_a_phase_that_impacts_do_not_tell_is_uncertain_by_half_a_turn(run: Run, rig: Path) -> None:
    """A force of another frequency that hardly moves the rig."""
    weak = "forces: [{body: x1, amplitude: 1.0e-5, frequency: 3.7}, "
    (rig / "rig.yaml").write_text(MODEL.replace("forces: [", weak).replace("RESTITUTION", UNKNOWN))
    assert main(["fit", typed_times(run, rig).name, "rig.yaml", "-o", "out"]) == 0
    fitted = read_model(rig / "out" / "fitted.yaml")
    assert fitted.system.eps[0] == pytest.approx(0.7, abs=0.01)
    assert fitted.uncertainty is not None
    deviation = fitted.uncertainty.deviation_by_name["forcing-phase.1"]
    assert deviation == pytest.approx(np.pi, rel=1e-2)


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["hits.m4a", "rig.yaml"], "hits.m4a"),
        *(([f"hits{each}", "rig.yaml"], "CSV or WAV") for each in (".mat", ".xlsx", ".tdms")),
        (["two.csv", "rig.yaml"], "--sources"),
        (["times.txt", "hammer_arm"], "hammer_arm"),
        (["times.txt", "rig.yaml", "--sources", "odd.yaml"], "table.rows"),
        (["named.csv", "rig.yaml"], "table: {"),
    ],
)
def test_what_cannot_be_used_is_one_line(
    words: list[str], named: str, run: Run, rig: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 2, the name of the thing at fault, and no folder."""
    typed_times(run, rig)
    rows = "\n".join(f"{k / 100},{k % 7},{k % 5}" for k in range(200))
    (rig / "two.csv").write_text(f"time,a,b\n{rows}\n")
    (rig / "named.csv").write_text("notes,none\n1,2\n2,3\n")
    (rig / "odd.yaml").write_text("table: {rows: 3}\n")
    for suffix in (".m4a", ".mat", ".xlsx", ".tdms"):
        (rig / f"hits{suffix}").touch()
    assert main(["fit", *words, "-o", "out"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert named in line
    assert not (rig / "out").exists()


def test_a_silent_signal_is_named(rig: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The sensor that has no impact; exit code 1, and no folder."""
    (rig / "silent.csv").write_text("time,a\n" + "\n".join(f"{k / 100},0" for k in range(200)))
    assert main(["fit", "silent.csv", "rig.yaml", "-o", "out"]) == 1
    assert "/a" in capsys.readouterr().err
    assert not (rig / "out").exists()


def test_where_nothing_fits_the_frequencies_of_forces_are_named(
    run: Run, rig: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Hertz were written for rad/s."""
    text = MODEL.replace("RESTITUTION", UNKNOWN).replace("frequency: 2.5", "frequency: 0.398")
    (rig / "rig.yaml").write_text(text)
    assert main(["fit", typed_times(run, rig).name, "rig.yaml", "-o", "out"]) == 1
    assert "0.0633 Hz" in capsys.readouterr().out
