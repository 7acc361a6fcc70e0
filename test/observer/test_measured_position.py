# SPDX-License-Identifier: Apache-2.0
"""The law measured-position: velocities from encoders, whose V falls as promised."""

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from arms import DOUBLE, model_of, wall
from numpy.typing import NDArray

pytest.importorskip("pinocchio", reason="not installed: extra robots")

from robot_runs import encoders

from impact_observer.cli.main import main
from impact_observer.errors import UsageError
from impact_observer.events import Kind
from impact_observer.model import Model, System, read_model
from impact_observer.model.measurement import Measurement
from impact_observer.observer import Observer, make_observer, synchronization
from impact_observer.observer.laws.measured_position import MeasuredPosition
from impact_observer.observer.samples import SensorSample
from impact_observer.options import Options
from impact_observer.plant import Plant, simulate
from impact_observer.resources import shared
from impact_observer.robots import Robot, VelocityObserver
from impact_observer.robots.velocity_observer import MARGIN
from impact_observer.stamps import NS_PER_S, from_seconds, grid

EPOCH = 5 * NS_PER_S
WRONG = np.array([2.0, -3.0])
"""Error of the velocities at the start, rad/s."""
Array = NDArray[np.float64]


def hammer() -> Model:
    """The sample, whose torques are known."""
    model = read_model("hammer_arm")
    assert model.robot is not None
    return replace(model, robot=replace(model.robot, forces=None))


def pressed() -> Model:
    """A double pendulum that bounces, rests on a wall, slides along it and leaves."""
    contacts = wall(restitution=0.3, offset=0.25)
    forcing = "{constant: [-3, -1]}"
    return model_of(DOUBLE, "shoulder, elbow", contacts=contacts, forcing=forcing)


def observer_of(robot: Robot, q: Array, u: Array, sensors: list[Measurement]) -> Observer:
    """The observer of a ``robot`` that knows its torques, with one replica at ``(q, u)``."""
    system = cast(System, robot)
    law = MeasuredPosition(system)
    return Observer(system, law, q, u, epoch=EPOCH, ensemble=1, measurements=sensors)


def measure_all(observer: Observer, stamp: int, q: Array) -> None:
    """Give exact samples of all encoders."""
    observer.measure([SensorSample(i, stamp, value) for i, value in enumerate(q.tolist())])


@pytest.mark.parametrize(
    ("model", "start", "seconds", "kinds"),
    [
        (hammer(), [-0.5, 0.3, -2.0, -1.0], 0.3, {Kind.IMPACT}),
        (pressed(), [0.8, 0.3, 0.0, 0.0], 0.8, {Kind.IMPACT, Kind.CLOSE}),
        (pressed(), [0.8, 0.3, 0.0, 0.0], 0.35, {Kind.IMPACT}),
    ],
    ids=["hammer", "bounces and a rest", "first hit"],
)
def test_v_falls_in_each_interval_of_exact_samples_as_promised(
    model: Model, start: list[float], seconds: float, kinds: set[Kind]
) -> None:
    """From a wrong start through hits and a lasting contact; V is that of the plant's velocity."""
    robot, rate = Robot(model), 1000.0
    q, u = np.split(np.array(start), 2)
    stamps = grid(EPOCH, EPOCH + from_seconds(seconds), rate)
    run = simulate(Plant(robot, q, u, epoch=EPOCH), stamps)
    assert {switch.kind for event in run.events for switch in event.switches} == kinds
    observer = observer_of(robot, q, u + WRONG, [*encoders(model)])
    events, V = [*run.events], list[float]()
    for stamp, x in zip(stamps.tolist(), run.states, strict=True):
        while events and events[0].stamp <= stamp:
            observer.receive(events.pop(0))
        measure_all(observer, stamp, x[:2])
        found = observer.estimate(stamp)
        np.testing.assert_allclose(found.q, x[:2], rtol=0, atol=1e-12)
        V.append(robot.kinetic_energy(x[:2], x[2:] - found.u))
    assert V[0] == pytest.approx(robot.kinetic_energy(q, WRONG))
    falls = np.array(V[1:]) / np.array(V[:-1])
    assert np.all(falls <= math.exp(-2 * MARGIN / rate))


def test_dense_samples_lead_to_the_velocity_observer_in_continuous_time() -> None:
    """The difference of the two after 50 ms of flight is of first order in the interval."""
    model = hammer()
    robot = Robot(model)
    start, seconds, last = np.array([0.3, 0.8, 1.0, -2.0]), 0.05, EPOCH + NS_PER_S // 20
    fine = grid(EPOCH, last, 40_000.0)
    plant = simulate(Plant(robot, start[:2], start[2:], epoch=EPOCH), fine)
    truth, count = plant.states, (fine.size - 1) // 2
    assert not plant.events
    exact = VelocityObserver(robot, start[2:] + WRONG)
    for k in range(count):
        middle = (fine[2 * k + 1] - EPOCH) / NS_PER_S
        positions = truth[2 * k : 2 * k + 3, :2]
        exact.step(positions, seconds / count, robot.torques(middle))
    assert exact.distance(truth[-1, :2], truth[-1, 2:]) > 0.01
    differences = []
    for every in (80, 40, 20):
        observer = observer_of(robot, start[:2], start[2:] + WRONG, [*encoders(model)])
        for stamp, x in zip(fine[::every].tolist(), truth[::every], strict=True):
            measure_all(observer, stamp, x[:2])
        differences.append(float(np.linalg.norm(observer.estimate(last).u - exact.velocity)))
    assert differences[0] < 0.02 * np.linalg.norm(exact.velocity - truth[-1, 2:])
    np.testing.assert_allclose(np.divide(differences[1:], differences[:-1]), 0.5, atol=0.05)


def test_a_constant_error_of_one_joint_decays_by_the_exponential_of_its_interval() -> None:
    """A mass that slides freely: its growth rate is zero, so the gain is the margin."""
    text = DOUBLE.replace('type="continuous"', 'type="prismatic"')
    robot = Robot(model_of(text, "shoulder, elbow", gravity="[0, 0, 0]"))
    observer = observer_of(robot, np.zeros(2), np.array([1.0, 0.0]), [*encoders_of(robot)])
    for k, moments in enumerate((0, 30_000_000, 100_000_000)):
        observer.measure([SensorSample(0, EPOCH + moments, 0.0)])
        left = math.exp(-MARGIN * moments * 1e-9)
        assert observer.estimate(EPOCH + moments).u[0] == pytest.approx(left, rel=1e-6), k


def encoders_of(robot: Robot) -> list[Measurement]:
    """Exact encoders of all joints."""
    return [
        Measurement(name, "/joint_states", name, "position", deviation=0.0)
        for name in robot.coordinates
    ]


def test_samples_that_are_no_position_of_one_joint_are_left_out_with_the_reason() -> None:
    """A gap, a velocity, and the sum of two positions."""
    robot = Robot(hammer())
    others = [
        Measurement("height", "/height", field="data", gap="wall", deviation=0.1),
        Measurement("gyro", "/joint_states", "elbow", "velocity", deviation=0.1),
        Measurement(
            "sum", "/sum", field="data", position={"shoulder": 1.0, "elbow": 1.0}, deviation=0.1
        ),
    ]
    observer = observer_of(robot, np.array([0.3, 0.8]), WRONG, others)
    observer.measure([SensorSample(i, EPOCH + 10**6, 0.1) for i in range(3)])
    assert [each["unused"] for each in observer.samples.counts] == [1, 1, 1]
    reasons = {each.reason for each in observer.samples.take()}
    assert reasons == {"measured-position uses positions of single joints alone"}


def test_turns_and_scale_of_an_encoder_count() -> None:
    """A continuous joint modulo a turn; a gear of two to one on the elbow."""
    robot = Robot(hammer())
    first, _ = encoders_of(robot)
    geared = Measurement(
        "gear", "/gear", field="data", position={"elbow": 2.0}, offset=0.1, deviation=0.1
    )
    observer = observer_of(robot, np.array([0.3, 0.8]), np.zeros(2), [first, geared])
    stamp = EPOCH + 10**6
    observer.measure([SensorSample(0, stamp, 0.31 - math.tau), SensorSample(1, stamp, 1.74)])
    np.testing.assert_allclose(observer.estimate(stamp).q, [0.31, 0.82], atol=1e-12)


def test_replicas_agree_after_three_hits(monkeypatch: pytest.MonkeyPatch) -> None:
    """The flag needs no covariance: all replicas follow the same encoders and events."""
    monkeypatch.setattr(synchronization, "AGREED", 0.01)
    robot = Robot(pressed())
    system, q = cast(System, robot), np.array([0.8, 0.3])
    stamps = grid(EPOCH, EPOCH + from_seconds(0.51), 500.0)
    run = simulate(Plant(robot, q, np.zeros(2), epoch=EPOCH), stamps)
    observer = Observer(
        system,
        MeasuredPosition(system),
        q,
        np.zeros(2),
        epoch=EPOCH,
        measurements=encoders_of(robot),
    )
    events, obstacles = [*run.events], list[str]()
    for stamp, x in zip(stamps.tolist(), run.states, strict=True):
        while events and events[0].stamp <= stamp:
            observer.receive(events.pop(0))
            obstacles.append(observer.obstacle(observer.last_event))
        measure_all(observer, stamp, x[:2])
    expected = [f"agreement at {k} of 3 impacts in a row" for k in (1, 2)]
    assert obstacles == [*expected, ""]
    assert observer.estimate(int(stamps[-1])).synchronized


@pytest.mark.parametrize(
    ("model", "joints", "expected"),
    [
        ("two_mass", None, "takes only robots"),
        ("hammer_arm", 1, r"no encoder of the joint 'elbow' found; expected one of every joint"),
        ("hammer_arm", 0, r"does not follow from impact times alone"),
    ],
)
def test_what_the_law_cannot_observe_is_said_in_one_line(
    model: str, joints: int | None, expected: str
) -> None:
    """Linear models, a robot without an encoder, and one with too few."""
    sensors = encoders(read_model("hammer_arm"))[:joints] if joints is not None else ()
    options = Options("measured-position", initial_state="zero")
    with pytest.raises(UsageError, match=expected) as error:
        make_observer(model, options, measurements=sensors)
    assert "\n" not in str(error.value)
    assert "measured-position" in str(error.value) or not joints


@pytest.mark.long
def test_observe_and_compare_the_sample_by_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Velocities after hits err by 0.08 rad/s, with encoders of 1 mrad at 200 Hz."""
    bag, output = str(shared("bags/hammer_arm")), str(tmp_path / "found")
    given = ["--measurements", "hammer_arm", "--ensemble", "2", "-o", output]
    assert main(["observe", bag, "--law", "measured-position", *given]) == 0
    said = capsys.readouterr()
    assert "measured-position, 801 estimates, verdicts: 3 applied" in said.out
    assert "considered" not in said.out
    assert main(["compare", output, "--json"]) == 0
    (found,) = json.loads(capsys.readouterr().out).values()
    assert found["velocity_after_hits"] < 0.12
    assert main(["compare", output]) == 0
    printed = capsys.readouterr().out
    assert "undefined" not in printed
    assert "1/impact" not in printed
    assert main(["plot", output, "-o", str(tmp_path / "picture.png")]) == 0


@pytest.mark.parametrize(
    ("law", "without", "said"),
    [
        ("minimum-variance", ("torque_dev",), "warning: the model has no torque_deviation"),
        ("minimum-variance", ("torque_dev", "forces"), "warning: the model has no forces, so its"),
        ("measured-position", ("torque_dev",), ""),
    ],
)
def test_torques_that_are_not_known_are_said_where_deviations_are_published(
    law: str,
    without: tuple[str, ...],
    said: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Of a model without ``torque_deviation``, and without ``forces``, in one line."""
    config = Path(__file__).parents[2] / "config"
    lines = (config / "hammer_arm.yaml").read_text(encoding="utf-8").splitlines()
    kept = [line for line in lines if not line.startswith(without)]
    assert len(kept) == len(lines) - len(without)
    model = tmp_path / "arm.yaml"
    model.write_text("\n".join(kept), encoding="utf-8")
    shutil.copy(config / "hammer_arm.urdf", tmp_path)
    bag, given = config.parent / "bags" / "hammer_arm", ["--start", "1", "--duration", "0.2", "-o"]
    words = ["observe", str(bag), "--law", law, "--model", str(model)]
    words += ["--measurements", "hammer_arm", *given, str(tmp_path / "estimates")]
    assert main(words) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len([line for line in lines if said and line.startswith(said)]) == bool(said)
