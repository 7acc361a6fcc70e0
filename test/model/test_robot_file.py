# SPDX-License-Identifier: Apache-2.0
"""Model files of robots: what is read, and what each mistake says."""

from pathlib import Path

import numpy as np
import pytest
from arms import DOUBLE, PENDULUM, joint, link, model_of, urdf, wall

from impact_observer.cli.main import main
from impact_observer.errors import ModelError, NotLinearError, UsageError
from impact_observer.model import Model, parse_model, read_model
from impact_observer.model.robot_description import RobotDescription


def robot_in(model: Model) -> RobotDescription:
    """The robot of a model."""
    assert model.robot is not None
    return model.robot


def test_the_sample_has_all_that_its_file_declares() -> None:
    """Joints with units, limits and damping of URDF and file, a contact, and deviations."""
    model = read_model("hammer_arm")
    robot = robot_in(model)
    assert robot.joints == ("shoulder", "elbow")
    assert robot.units == ("rad", "rad")
    assert robot.damping.tolist() == [0.35, 0.35]
    assert [each.upper for each in robot.urdf_joints] == [np.inf, 2.6]
    assert [each.velocity for each in robot.urdf_joints] == [20.0, 25.0]
    assert robot.forces == ("/joint_states", "effort")
    assert robot.torque_deviation is not None
    assert robot.torque_deviation.tolist() == [0.02, 0.02]
    assert robot.forcing.frequency.size == 2
    assert model.uncertainty is not None
    assert model.uncertainty.deviation_by_name == {"restitution.wall": 0.05}


def test_the_text_of_a_model_carries_its_urdf() -> None:
    """What a bag carries reads to the same robot without another file."""
    model = read_model("hammer_arm")
    text = model.text({"seed": 3})
    again = parse_model(text, "bag")
    one, two = robot_in(model), robot_in(again)
    assert one.known_urdf.text == two.known_urdf.text
    assert one.parameters == two.parameters
    assert np.array_equal(one.forcing.cosine, two.forcing.cosine)
    assert again.text({"seed": 3}) == text
    assert again.provenance == {"seed": 3}
    assert np.array_equal(again.initial_state()[0], model.initial_state()[0])


@pytest.mark.parametrize(
    "words",
    [
        "sweep {} -o out.parquet",
        "compare --figure {} --plot out.png",
        "fit t.csv {} -o out",
        "demo --model {}",
    ],
)
def test_commands_that_need_a_linear_model_say_so(
    words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One line with the robot, its URDF and the command, and exit code 2."""
    monkeypatch.chdir(tmp_path)
    command, *rest = words.format("hammer_arm").split()
    assert main([command, *rest]) == 2
    line = capsys.readouterr().err
    assert line == (
        "impact-observer: hammer_arm: a robot (urdf: hammer_arm.urdf);"
        f" {command} needs a linear model\n"
    )


def test_python_says_that_a_robot_is_not_linear() -> None:
    """Whoever asks a robot for its linear system gets an error of wrong use."""
    with pytest.raises(NotLinearError, match=r"a robot .*; this needs a linear model"):
        _ = read_model("hammer_arm").system


def test_a_urdf_from_a_topic_is_known_when_it_comes() -> None:
    """Until then nothing is asked of the URDF; then it is checked."""
    text = "name: arm\nurdf: {topic: robot_description}\njoints: [hinge]\n"
    robot = robot_in(parse_model(text, "arm.yaml"))
    assert robot.topic == "robot_description"
    with pytest.raises(UsageError, match="arm"):
        _ = robot.units
    assert robot.with_urdf(PENDULUM).units == ("rad",)
    with pytest.raises(ModelError, match=r"'hinge' is no joint of topic robot_description"):
        robot.with_urdf(DOUBLE)


def test_parameters_are_changed_by_name() -> None:
    """Damping, rotor inertia and restitution, as for a random plant."""
    robot = robot_in(model_of(DOUBLE, "shoulder, elbow", contacts=wall(restitution=0.5)))
    assert set(robot.parameters) == {
        *("damping.shoulder", "damping.elbow", "rotor-inertia.shoulder", "rotor-inertia.elbow"),
        "restitution.wall",
    }
    other = robot.with_parameters({"damping.elbow": 0.2, "restitution.wall": 0.7})
    assert other.damping.tolist() == [0.0, 0.2]
    assert other.contacts[0].rebound.nominal == 0.7
    with pytest.raises(ModelError, match=r"contacts\[0\].restitution"):
        robot.with_parameters({"restitution.wall": 1.2})


def test_deviations_stand_beside_numbers_or_in_the_covariance() -> None:
    """Both forms give names and variances; a deviation elsewhere is an error."""
    model = model_of(
        DOUBLE,
        "shoulder, elbow",
        damping="{elbow: {value: 0.3, deviation: 0.1}}",
        rotor_inertia="{shoulder: {value: 0.1, deviation: 0.01}}",
        uncertainty="{names: [restitution.wall], covariance: [[0.0004]]}",
        contacts=wall(),
    )
    assert model.uncertainty is not None
    assert model.uncertainty.deviation_by_name == pytest.approx(
        {"restitution.wall": 0.02, "damping.elbow": 0.1, "rotor-inertia.shoulder": 0.01}
    )
    with pytest.raises(ModelError, match=r"contacts\[0\].offset"):
        model_of(DOUBLE, "elbow", contacts=wall(offset="{value: 0, deviation: 1}"))


FINGERS = urdf(
    link("a", 1, "0 0 1") + link("b", 1, "0 0 1") + link("c", 1, "0 0 1"),
    joint("left", "base", "a", kind="prismatic")
    + joint("right", "base", "b", kind="prismatic", more='<mimic joint="left" multiplier="-1"/>')
    + joint("lift", "base", "c", kind="floating"),
)
RUBBING = PENDULUM.replace('<axis xyz="0 -1 0"/>', '<axis xyz="0 -1 0"/><dynamics friction="2"/>')


WRONG_STATE = "{position: [0, 0], velocity: [0]}"


@pytest.mark.parametrize(
    ("text", "joints", "keys", "line"),
    [
        (FINGERS, "right", {}, r"joints\[0\]: 'right' mimics 'left'"),
        (FINGERS, "left", {}, r"joints\[0\]: 'left' moves 'right' of .*, which mimics 'left'"),
        (FINGERS, "lift", {}, r"joints\[0\]: 'lift' is a floating joint"),
        (DOUBLE, "end", {}, r"joints\[0\]: 'end' is a fixed joint"),
        (DOUBLE, "knee", {}, r"joints\[0\]: 'knee' is no joint"),
        (DOUBLE, "elbow, elbow", {}, r"joints\[1\]"),
        (DOUBLE, "", {}, "joints"),
        (DOUBLE, "elbow", {"held": "{knee: 1}"}, "held.knee"),
        (DOUBLE, "elbow", {"damping": "{knee: 1}"}, "damping.knee"),
        (DOUBLE, "shoulder", {"damping": "{elbow: 1}"}, "damping.elbow"),
        (DOUBLE, "elbow", {"damping": "{elbow: -1}"}, "damping.elbow"),
        (DOUBLE, "elbow", {"torque_deviation": "[1]"}, "torque_deviation"),
        (DOUBLE, "elbow", {"stiffness": "1"}, "stiffness"),
        (DOUBLE, "elbow", {"contacts": wall(frame="toe")}, r"contacts\[0\].frame"),
        (DOUBLE, "elbow", {"contacts": wall(normal="[1, 1, 0]")}, r"contacts\[0\].normal"),
        (DOUBLE, "elbow", {"contacts": wall(friction=0.3)}, r"contacts\[0\].friction"),
        (DOUBLE, "elbow", {"contacts": wall(contact_time=3)}, r"contacts\[0\].contact_time"),
        (DOUBLE, "elbow", {"forces": "{topic: a, field: current}"}, "forces.field"),
        (DOUBLE, "elbow", {"initial_state": WRONG_STATE}, "initial_state.position"),
        (DOUBLE, "elbow", {"forcing": "{harmonics: [{hertz: 5, sine: [4, 1]}]}"}, "forcing.harm"),
        (RUBBING, "hinge", {}, r"joints\[0\]: 'hinge' has dry friction of 2"),
        ("<robot><joint/></robot>", "hinge", {}, "urdf: .*: joint ''"),
        ("<robot", "hinge", {}, "urdf: the URDF in the model: is not XML"),
    ],
)
def test_a_mistake_is_one_line_that_names_the_key(
    text: str, joints: str, keys: dict[str, str], line: str
) -> None:
    """The line begins with the file and the key."""
    with pytest.raises(ModelError, match=rf"^arm\.yaml: {line}") as caught:
        model_of(text, joints, **keys)
    assert "\n" not in str(caught.value)


def test_a_missing_urdf_names_its_path(tmp_path: Path) -> None:
    """The path is relative to the model file."""
    path = tmp_path / "arm.yaml"
    path.write_text("name: arm\nurdf: missing.urdf\njoints: [hinge]\n", encoding="utf-8")
    with pytest.raises(ModelError, match="urdf"):
        read_model(path)
    (tmp_path / "missing.urdf").write_text(PENDULUM, encoding="utf-8")
    assert robot_in(read_model(path)).origin == "missing.urdf"


def test_joints_that_follow_held_ones_are_held_too() -> None:
    """A mimic joint is where its held joint puts it; all held joints are named."""
    text = FINGERS.replace('multiplier="-1"', 'multiplier="-1" offset="0.5"')
    text = text.replace("</robot>", joint("hip", "c", "d") + link("d", 1, "0 0 1") + "</robot>")
    robot = robot_in(model_of(text, "hip", held="{left: 0.2}"))
    assert robot.holds == {"left": 0.2, "right": pytest.approx(0.3), "lift": 0.0}
