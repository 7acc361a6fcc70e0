# SPDX-License-Identifier: Apache-2.0
"""smooth: a bag in, a bag with the best estimates out."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags")

from impact_observer.cli.main import main
from impact_observer.events import Ruling
from impact_observer.io.messages import read_stamp
from impact_observer.io.reader import BagReader
from impact_observer.resources import shared


@pytest.mark.slow
def test_smoothed_bag_is_compared_drawn_and_exported_as_any_estimate(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Everything is carried along; the error at the start is a thousandth of the motion."""
    output = tmp_path / "smoothed"
    assert main(["smooth", str(shared("bags/jitter")), "-o", str(output)]) == 0
    said = capsys.readouterr().out
    assert "22 applied" in said
    assert "warning" not in said
    assert main(["compare", str(output), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["smoother"]
    assert found["impacts_used"] == 22
    assert 0 < found["V_end"] < found["V_start"] < 2e-3
    assert main(["plot", str(output), "-o", str(tmp_path / "motion.svg")]) == 0
    assert main(["export", str(output), "-o", str(tmp_path / "states.csv")]) == 0
    with BagReader(output) as reader:
        impacts = [message for _, message in reader.messages("/smoother/impacts")]
        verdicts = [*reader.verdicts("/smoother/verdicts")]
        (topic,) = reader.impact_topics()
        estimates = [*reader.impact_estimates(topic)]
        assert {"/impacts", "/plant/joint_states", "/plant/model"} <= reader.topics.keys()
    assert topic == "/smoother/impact_estimates"
    stamps = [read_stamp("stamp", each.header.stamp) for each in impacts]
    reported = [read_stamp("reported", each.reported) for each in impacts]
    assert [each.stamp for each in estimates] == stamps
    assert len(impacts) == len(verdicts) == 22
    assert {*(each.verdict for each in impacts), *(v.ruling for v in verdicts)} == {Ruling.APPLIED}
    assert all(abs(a - b) < 6_000_000 for a, b in zip(stamps, reported, strict=True))
    assert all(0 < each.deviation < 1.1e-3 for each in impacts)


@pytest.mark.slow
def test_a_wrong_restitution_is_warned_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The restitution is 0.7: 22 impacts prove 0.65 wrong."""
    model = tmp_path / "wrong.yaml"
    right = shared("config/two_mass.yaml").read_text(encoding="utf-8")
    assert right.count("restitution: 0.7") == 1
    model.write_text(right.replace("restitution: 0.7", "restitution: 0.65"), "utf-8")
    given = ["--model", str(model), "--rate", "1", "-o", str(tmp_path / "smoothed")]
    assert main(["smooth", str(shared("bags/jitter")), *given]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith("warning: the model does not explain") for line in lines)


@pytest.mark.slow
def test_a_learned_value_that_contradicts_the_declared_one_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The restitution is 0.7, and declared as 0.6 +- 0.02: impacts of two_mass say so."""
    model = tmp_path / "wrong.yaml"
    right = shared("config/two_mass.yaml").read_text(encoding="utf-8")
    model.write_text(right.replace("restitution: 0.7", "restitution: 0.6"), "utf-8")
    given = ["--estimate-parameters", "restitution=0.02", "--rate", "1", "--model", str(model)]
    words = ["observe", str(shared("bags/jitter")), "--law", "minimum-variance", *given]
    assert main([*words, "-o", str(tmp_path / "estimated")]) == 0
    lines = capsys.readouterr().out.splitlines()
    (warning,) = [line for line in lines if "contradict" in line]
    assert re.search(r"restitution\.stop 0\.[67]\d+ \+- \S+ .* 0\.600? \+- 0\.02", warning)


@pytest.mark.slow
def test_smoothing_again_replaces_what_was_smoothed(tmp_path: Path) -> None:
    """The second run uses the same events, with other options."""
    first, second = tmp_path / "first", tmp_path / "second"
    assert main(["smooth", str(shared("bags/jitter")), "-o", str(first)]) == 0
    again = ["smooth", str(first), "--rate", "10", "--clock-error", "0.001", "-o", str(second)]
    assert main(again) == 0
    with BagReader(second) as reader:
        assert reader.topics["/smoother/state"].count == 301
        assert reader.topics["/smoother/impacts"].count == 22


DRILL = """name: drill
bodies: [{name: machine, mass: 1.2}, {name: bit, mass: 0.4}]
springs:
  - {between: [ground, machine], stiffness: 2000, damping: 12}
  - {between: [machine, bit], stiffness: 9000, damping: 6}
forces: [{body: machine, amplitude: 60, frequency: 125.6637}]
stops: [{name: anvil, body: bit, limit: 0.001, side: above, restitution: 0.5998991535303488}]
"""
HITS = """
    12592 112450 169441 260199 273792 362570 380665 463168 519600 610263 623876 712584 730709
    813145 869595 960261 973875 1062584 1080706 1163146 1219597 1310261 1323875 1412583 1430710
    1513143 1569597 1660261 1673870 1762583 1780703 1863144 1919597 2010260 2023877 2112584
    2130707 2213144 2269600 2360262 2373876 2462584 2480707 2563143 2619598 2710261 2723877
    2812582 2830709 2913147 2969598 3060261 3073876 3162582 3180709 3263144 3319598 3410262
    3423876 3512584 3530705 3613144 3669597 3760260 3773876 3862583 3880708 3963141 4019597
    4110260 4123875 4212582 4230707 4313141 4369597 4460260 4473874 4562583 4580713 4663144
    4719597 4810260 4823874 4912583 4930702 5013141 5069598 5160261 5173874 5262582 5280705
    5363143 5419598 5510262 5523876 5612584 5630705 5713143 5769598 5860260 5873873 5962583
    5980706
"""
"""Hits of a drill by its ringing accelerometer, us; three of 106 are missing."""


@pytest.mark.long
@pytest.mark.usefixtures("in_tmp_path")
def test_hits_of_a_drill_are_smoothed_with_a_restitution_that_is_learned(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The declared clock is much better than the hits are: no account of them overflows."""
    Path("drill.yaml").write_text(DRILL, encoding="utf-8")
    rows = [f"{hit},anvil" for hit in HITS.split()]
    Path("hits.csv").write_text("\n".join(["time_us,contact", *rows]), encoding="utf-8")
    assert main(["import", "hits.csv", "--model", "drill.yaml", "-o", "hits"]) == 0
    given = "--estimate-parameters restitution=0.01 --clock-error 5e-6 --rate 50 -o out"
    assert main(["smooth", "hits", *given.split()]) == 0
    said = capsys.readouterr().out
    assert "out: 300 estimates" in said
    assert re.search(r"restitution\.anvil +0\.(6|59)", said)


@pytest.mark.slow
def test_a_ball_with_uncertain_damping_that_comes_to_rest_is_smoothed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With samples while it rests; the damping is that of the plant within its deviation."""
    model, sensor, bag = tmp_path / "ball.yaml", tmp_path / "sensor.yaml", tmp_path / "bag"
    model.write_text(
        "name: ball\nbodies: [{name: z, mass: 1}]\n"
        "springs: [{between: [ground, z], stiffness: 2,"
        " damping: {value: 0.5, deviation: 0.1}}]\n"
        "forces: [{body: z, constant: -9.81}, {body: z, amplitude: 15, frequency: 9}]\n"
        "stops: [{name: floor, body: z, limit: 0, side: below, restitution: 0.5}]\n"
        "initial_state: {position: [0.1], velocity: [0]}\n"
    )
    sensor.write_text(
        "measurements:\n"
        "  - {name: height, topic: /height, joint: z, quantity: position, deviation: 0.001}\n"
    )
    given = f"--measurements {sensor}"
    faults = "--jitter 0.001 --measurement-rate 50"
    assert main(f"simulate {model} --duration 0.8 {faults} {given} -o {bag}".split()) == 0
    assert "persistent" in capsys.readouterr().out
    start = "--clock-error 0.001 --initial-deviation 0.01 --initial-state 0.1,0"
    assert main(f"smooth {bag} {given} {start} -o {tmp_path / 'smoothed'}".split()) == 0
    said = capsys.readouterr().out
    *_, found = re.findall(r"damping\.ground-z \[Ns/m\] +(\S+) \+- (\S+)", said)
    value, deviation = map(float, found)
    assert abs(value - 0.5) < 3 * deviation


@pytest.mark.slow
def test_a_wrong_sign_of_a_sensor_is_named_beside_the_counts_of_its_samples(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Observer and smoother say how many samples are rejected, and what may be wrong."""
    bag, wrong = tmp_path / "bag", tmp_path / "wrong.yaml"
    text = shared("config/measurements/encoder.yaml").read_text(encoding="utf-8")
    wrong.write_text(text.replace("quantity: position", "quantity: position, position: {x1: -1}"))
    given = ["--measurements", "encoder", "--measurement-rate", "20", "-o", str(bag)]
    assert main(["simulate", "two_mass", "--duration", "6", "--jitter", "0.0005", *given]) == 0
    for sensor, is_wrong in (("encoder", False), (str(wrong), True)):
        for command in ("smooth", "observe --law minimum-variance"):
            output = tmp_path / f"{command[:6]}_{is_wrong}"
            capsys.readouterr()
            options = ["--measurements", sensor, "--clock-error", "0.0005", "--rate", "10"]
            assert main([*command.split(), str(bag), *options, "-o", str(output)]) == 0
            said = capsys.readouterr().out
            assert ("warning: " in said) is is_wrong
            assert "encoder" in said


@pytest.mark.slow
@pytest.mark.parametrize(("clock", "is_warned"), [(1e-3, False), (2e-4, True)])
def test_shifts_above_the_declared_clock_error_are_warned_of_and_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], clock: float, is_warned: bool
) -> None:
    """Stamps jitter by 1 ms. A fifth of it is declared."""
    declared = ["--clock-error", f"{clock}", "-o", str(tmp_path / "out")]
    assert main(["smooth", str(shared("bags/jitter")), *declared]) == 0
    said = capsys.readouterr().out
    assert ("warning" in said) is is_warned
    with BagReader(tmp_path / "out") as reader:
        states = reader.observer_states("/smoother/state")
        truth = reader.joint_states("/plant/joint_states")
        messages = [message for _, message in reader.messages("/smoother/state")]
    assert any(each.synchronized for each in messages) != is_warned
    within = np.abs(states.q - truth.q) <= 2 * states.deviations[:, :2]
    assert np.mean(within) > 0.9


def test_a_phase_of_a_ground_is_learned_from_a_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The phase of a table; identify finds this phase from the same hits."""
    model, text = tmp_path / "table.yaml", (shared("config") / "ball_on_table.yaml").read_text()
    wrong = "62.83185307179586, phase: {value: 0.03, deviation: 0.03}"
    model.write_text(text.replace("62.83185307179586", wrong))
    given = [str(shared("bags/ball_on_table")), "--model", str(model), "--clock-error", "1e-5"]
    assert main(["smooth", *given, "--rate", "9", "-o", str(tmp_path / "out")]) == 0
    assert "ground-phase.table.1 [rad]  -0.03" in capsys.readouterr().out
    free = "--free ground-phase.table.1"
    given[-1] = "1e-8"  # the stamps are exact, and outweigh the prior
    assert main(["identify", *given, *free.split(), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["parameters"]["ground-phase.table.1"]
    assert found["value"] == pytest.approx(-0.03, abs=1e-6)
    assert found["standard_error"] < 3e-4
