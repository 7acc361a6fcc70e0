# SPDX-License-Identifier: Apache-2.0
"""The recorded bags: their contents, and the estimates from them, offline and live."""

import csv
import json
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rigs import accelerometer_bag, switch_bag
from ruamel.yaml import YAML

from impact_observer.cli.main import main
from impact_observer.compare.bag_comparison import compare_bag
from impact_observer.compare.comparison import Comparison
from impact_observer.events import ImpactEvent, Kind, Ruling, Verdict
from impact_observer.io.live_inputs import give_recorded
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import events_in, model_of
from impact_observer.model import read_model
from impact_observer.model.live_signals import connected
from impact_observer.observer import Options, make_observer
from impact_observer.observer.laws import BUILT_IN
from impact_observer.plant import Plant, simulate
from impact_observer.resources import shared
from impact_observer.sensor_faults import SENSOR_FAULTS

BAGS = shared("bags")
ROUNDED = 2
"""By how much the stamps of a bag that is made again may differ, ns."""
NUMBERS = YAML(typ="safe").load(shared("bags/expected.yaml"))
EXPECTED, FAULTY, ROBOTS = (NUMBERS[key] for key in ("ideal", "faulty", "robots"))
ROWS = re.findall(
    r"^\| `(\w+)` .*?`impact-observer ([^`]*)`", (BAGS / "README.md").read_text(), re.MULTILINE
)
COMMANDS = {name: command.split() for name, command in ROWS if name not in EXPECTED}
OF_ROBOTS = {name: COMMANDS.pop(name) for name in ROBOTS}
SIMULATED = [name for name, command in COMMANDS.items() if command[0] == "simulate"]
_AXES = "linear_acceleration.x linear_acceleration.y linear_acceleration.z"
RIGS: dict[str, tuple[Callable[[Path], Path], str, str]] = {
    "switch": (switch_bag, "/switch", "data"),
    "accelerometer": (accelerometer_bag, "/imu", _AXES),
}
TWO = ("geometric", "minimum-variance")
DECIDING = (Ruling.APPLIED, Ruling.REJECTED, Ruling.INSERTED)


@pytest.mark.parametrize("name", EXPECTED)
def test_a_recorded_bag_holds_a_run_of_its_model(name: str) -> None:
    """Its events and true states are those of a new simulation of the model in it."""
    with BagReader(shared(f"bags/{name}")) as reader:
        model, events = model_of(reader), events_in(reader)
        truth = reader.joint_states("/plant/joint_states")
        system, live = connected(model.system)
        assert not [*give_recorded(reader, live)]
    assert model.system.name == name
    assert model.provenance["version"] in {"0.1.0", "0.4.0"}
    plant = Plant(system, *model.initial_state(), epoch=events[0].epoch, live=live)
    run = simulate(plant, truth.stamps)
    assert len(events) == EXPECTED[name]["impacts"]
    assert [e.switches for e in events] == [e.switches for e in run.events]
    stamps = [e.stamp for e in events]
    np.testing.assert_allclose(stamps, [e.stamp for e in run.events], rtol=0, atol=1)
    np.testing.assert_allclose(np.hstack([truth.q, truth.u]), run.states, rtol=0, atol=1e-9)


def observed(bag: Path, law: str, options: str, output: Path) -> tuple[Comparison, list[Verdict]]:
    """The comparison and the verdicts of an observer, run on a bag as a user does."""
    given = ["--law", law, "--initial-state", "random:1", "--ensemble", "2", *options.split()]
    arguments = ["observe", str(bag), *given]
    assert main([*arguments, "-o", str(output)]) == 0
    with BagReader(output) as reader:
        comparison = compare_bag(reader, model_of(reader).system).comparisons["/observer"]
        return comparison, list(reader.verdicts("/observer/verdicts"))


@pytest.mark.slow
@pytest.mark.parametrize("name", EXPECTED)
@pytest.mark.parametrize(
    "law", [law if law in TWO else pytest.param(law, marks=pytest.mark.long) for law in BUILT_IN]
)
def test_estimates_from_a_recorded_bag_have_the_expected_error(
    name: str, law: str, tmp_path: Path
) -> None:
    """V at the end over V at the start, for every law."""
    comparison, _ = observed(BAGS / name, law, "--rate 5", tmp_path / "out")
    if law == "minimum-variance" or law not in EXPECTED[name]:  # rounding of stamps remains
        assert comparison.ratio is not None
        assert 0 < comparison.ratio <= EXPECTED[name]["minimum-variance"]
        return
    assert comparison.ratio == pytest.approx(EXPECTED[name][law], rel=1e-6)
    if law != "open-loop":
        assert comparison.largest_rise <= 1e-9


def test_there_is_a_bag_for_every_fault_of_the_sensor() -> None:
    """The table has a command for each bag, and there are expected figures for each."""
    folders = {path.name for path in BAGS.iterdir() if path.is_dir()}
    assert folders == {*EXPECTED, *FAULTY, *ROBOTS}
    assert COMMANDS.keys() == FAULTY.keys()
    assert {*SIMULATED, *RIGS} == FAULTY.keys()
    options = {word for command in COMMANDS.values() for word in command}
    assert {f"--{each.name.replace('_', '-')}" for each in SENSOR_FAULTS} <= options


def received(reader: BagReader) -> list[tuple[int, ImpactEvent]]:
    """The events of a bag with their times of reception, ns."""
    logged = (each.log_time for each in reader.raw(["/impacts"]))
    return list(zip(logged, reader.events(), strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("name", SIMULATED)
def test_a_bag_of_a_faulty_sensor_is_what_its_command_makes(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Events, their times of reception, true states and faults are the same.

    A stamp that lies between two nanoseconds may be rounded to either on another machine.
    """
    monkeypatch.chdir(BAGS)
    given = ["--duration", "30", "--rate", "2", "--seed", "1", "-o", str(tmp_path / "bag")]
    assert main([*COMMANDS[name], *given]) == 0
    with BagReader(BAGS / name) as recorded, BagReader(tmp_path / "bag") as made:
        for old, new in zip(received(recorded), received(made), strict=True):
            assert abs(old[0] - new[0]) <= ROUNDED
            assert abs(old[1].stamp - new[1].stamp) <= ROUNDED
            assert replace(old[1], stamp=0) == replace(new[1], stamp=0)
        model, new_model = model_of(recorded), model_of(made)
        states, truth = (each.joint_states("/plant/joint_states") for each in (recorded, made))
    assert model.provenance["version"] in {"0.1.0", "0.4.0"}
    assert model.provenance["seed"] == 1
    assert model.provenance["sensor"] == new_model.provenance["sensor"]
    assert model.system.name == new_model.system.name
    assert (states.stamps == truth.stamps).all()
    np.testing.assert_allclose(states.q, truth.q, rtol=0, atol=1e-9)
    np.testing.assert_allclose(states.u, truth.u, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ROBOTS)
def test_a_bag_of_a_robot_is_what_its_command_makes(name: str, tmp_path: Path) -> None:
    """Hits, true states, encoders and efforts are the same."""
    pytest.importorskip("pinocchio", reason="not installed: extra robots")
    assert main([*OF_ROBOTS[name], "-o", str(tmp_path / "bag")]) == 0
    sensed = []
    for path in (BAGS / name, tmp_path / "bag"):
        with BagReader(path) as reader:
            truth, model = reader.joint_states("/plant/joint_states"), model_of(reader)
            messages = [message for _, message in reader.messages("/joint_states")]
            rows = np.array([np.hstack([each.position, each.effort]) for each in messages])
            events = [each.stamp for each in events_in(reader)]
        sensed.append((events, rows, np.hstack([truth.q, truth.u]), model.provenance))
    (events, rows, states, known), (new_events, new_rows, new_states, new_known) = sensed
    assert len(events) == ROBOTS[name]["impacts"]
    np.testing.assert_allclose(events, new_events, rtol=0, atol=ROUNDED)
    np.testing.assert_allclose(rows, new_rows, rtol=0, atol=1e-9)
    np.testing.assert_allclose(states, new_states, rtol=0, atol=1e-9)
    assert {k: v for k, v in known.items() if k != "version"} == {
        k: v for k, v in new_known.items() if k != "version"
    }


@pytest.mark.long
@pytest.mark.parametrize("name", ROBOTS)
def test_velocities_after_hits_of_a_robot_are_known(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By the commands that a user types; all that can be drawn and exported is."""
    pytest.importorskip("pinocchio", reason="not installed: extra robots")
    numbers, made = ROBOTS[name], tmp_path / "made"
    words = ["observe", str(BAGS / name), "--law", "minimum-variance"]
    assert main([*words, *numbers["observe"].split(), "-o", str(made)]) == 0
    errors = tmp_path / "errors.csv"
    capsys.readouterr()
    assert main(["compare", str(made)]) == 0
    assert "V = 1/2 du' M du + 1/2 dq' M dq / s^2 at the true q" in capsys.readouterr().out
    assert main(["compare", str(made), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["minimum-variance"]
    assert found["velocity_after_hits"] < numbers["after_hits"]
    assert np.mean(found["coverage"]) > numbers["coverage"]
    counts = [numbers[each] for each in ("applied", "rejected", "inserted")]
    rejected, inserted = found["switches_rejected"], found["impacts_inserted"]
    assert [found["impacts_used"], rejected, inserted] == counts
    assert main(["export", str(made), "--what", "errors", "-o", str(errors)]) == 0
    with errors.open(encoding="utf-8") as file:
        rows = [*csv.DictReader(file)]
    assert len(rows) == found["samples"]
    assert float(rows[-1]["V"]) == found["V_end"]
    assert main(["plot", str(made), "-o", str(tmp_path / "a.svg")]) == 0
    assert "rad/s" in (tmp_path / "a.svg").read_text("utf-8")
    capsys.readouterr()
    assert main(["compare", str(made), "--laws", "geometric"]) == 2
    assert "a robot" in capsys.readouterr().err


@pytest.mark.long
def test_the_page_of_robots_goes_from_a_model_to_a_picture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By its commands as they stand there."""
    pytest.importorskip("pinocchio", reason="not installed: extra robots")
    page = (shared("docs") / "robots.md").read_text("utf-8")
    commands = re.findall(r"^    impact-observer (.*)$", page, re.MULTILINE)
    assert len(commands) == 5
    monkeypatch.chdir(tmp_path)
    assert [main(command.split()) for command in commands] == [0] * 5
    assert Path("motion.png").read_bytes().startswith(b"\x89PNG")


def recorded(path: Path, topic: str, field: str) -> tuple[list[int], Any]:
    """Log times of a sensor's messages, and the values in them, shape (messages, any)."""
    with BagReader(path) as reader:
        read, get = reader.decoder(topic), attrgetter(*field.split())
        raw = list(reader.raw([topic]))
    return [each.log_time for each in raw], np.array([get(read(each.data)) for each in raw])


@pytest.mark.parametrize("name", RIGS)
def test_a_bag_of_a_rig_is_what_its_sensor_records(name: str, tmp_path: Path) -> None:
    """The same messages at the same times, except for rounding."""
    make, topic, field = RIGS[name]
    times, values = recorded(BAGS / name, topic, field)
    new_times, new_values = recorded(make(tmp_path / "bag"), topic, field)
    assert len(times) >= 4 * EXPECTED["two_mass"]["impacts"]
    np.testing.assert_allclose(times, new_times, rtol=0, atol=ROUNDED)
    np.testing.assert_allclose(values, new_values, rtol=0, atol=1e-6)


def detected(name: str, path: Path) -> Path:
    """The bag that ``detect`` makes of a rig's, by the command in the table."""
    command, _, *options = COMMANDS[name]
    assert main([command, str(BAGS / name), *options, "-o", str(path)]) == 0
    return path


@pytest.mark.slow
@pytest.mark.parametrize(("name", "late"), [("switch", 0), ("accelerometer", 20_000)])
def test_every_impact_is_detected_in_the_bag_of_a_rig(
    name: str, late: int, tmp_path: Path
) -> None:
    """Never as persistent contact: to the nanosecond, or to 20 us of a signal at 1 kHz."""
    with (
        BagReader(BAGS / "two_mass") as ideal,
        BagReader(detected(name, tmp_path / "bag")) as reader,
    ):
        true, events = events_in(ideal), events_in(reader)
    assert [e.switches for e in events] == [e.switches for e in true]
    assert {e.switches[0].kind for e in events} == {Kind.IMPACT}
    assert max(abs(a.stamp - b.stamp) for a, b in zip(events, true, strict=True)) <= late


def test_events_that_arrive_late_and_out_of_order_change_nothing() -> None:
    """The final estimate is equal bit for bit to that from events without delay."""
    ends = []
    for name in ("transport", "two_mass"):
        with BagReader(BAGS / name) as reader:
            events = list(reader.events())
        observer = make_observer(read_model("two_mass").system, Options(initial_state="random:1"))
        for event in events:
            observer.receive(event)
        ends.append(([e.sequence for e in events], observer.estimate(31_000_000_000)))
    (late, found), (ordered, wanted) = ends
    assert late != ordered == sorted(late)
    assert found.q.tobytes() == wanted.q.tobytes()
    assert found.u.tobytes() == wanted.u.tobytes()


def rulings(verdicts: list[Verdict]) -> Counter[Ruling]:
    """The number of final verdicts of each kind on events and inserted impacts."""
    last = {(v.stamp, v.sequence, v.contact): v.ruling for v in verdicts}
    return Counter(
        ruling
        for (_, sequence, _), ruling in last.items()
        if sequence or ruling == Ruling.INSERTED
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", FAULTY)
@pytest.mark.parametrize("law", TWO)
def test_estimates_from_a_faulty_sensor_have_the_expected_error(
    name: str, law: str, tmp_path: Path
) -> None:
    """V at the end over V at the start, and the number of final verdicts of each kind."""
    numbers = FAULTY[name]
    bag = detected(name, tmp_path / "bag") if name in RIGS else BAGS / name
    comparison, verdicts = observed(bag, law, numbers["observe"], tmp_path / "out")
    ratio, counts = comparison.ratio, rulings(verdicts)
    if law == "geometric":  # it accepts every event
        assert ratio == pytest.approx(numbers[law], rel=1e-6)
        assert counts == {Ruling.APPLIED: len(verdicts)}
        return
    assert ratio is not None
    assert 0 < ratio <= numbers[law]
    assert comparison.V.max() <= 10 * comparison.V[0]
    expected = {each: numbers.get(each.name.lower(), counts[each]) for each in DECIDING}
    assert {each: counts[each] for each in DECIDING} == expected
