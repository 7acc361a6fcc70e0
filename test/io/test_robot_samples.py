# SPDX-License-Identifier: Apache-2.0
"""A simulated robot in a bag: impacts, truth, encoders with efforts, and its model."""

import json
from pathlib import Path

import numpy as np
import pytest
from arms import DOUBLE, model_of, wall

from impact_observer.cli.main import main
from impact_observer.io import interfaces
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import events_in
from impact_observer.io.recordings import model_of as model_in
from impact_observer.plant import random_plant
from impact_observer.robots.robot import Robot

pytest.importorskip("pinocchio", reason="not installed: extra robots")


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three seconds of the sample, with encoders at 200 Hz."""
    path = tmp_path_factory.mktemp("robot") / "bag"
    words = "simulate hammer_arm --duration 3 --rate 200 --measurements hammer_arm"
    assert main([*words.split(), "--measurement-rate", "200", "-o", str(path)]) == 0
    return path


def test_encoders_are_the_truth_with_noise_and_efforts_those_of_the_drives(bag: Path) -> None:
    """One message has both joints; the noise has the declared deviation."""
    with BagReader(bag) as reader:
        truth = reader.joint_states(interfaces.PLANT_JOINT_STATES.topic)
        positions = dict(zip(truth.stamps.tolist(), truth.q, strict=True))
        messages = [*reader.messages("/joint_states")]
        model = model_in(reader)
    assert model.robot is not None
    assert len(messages) == 601
    errors = []
    for _, message in messages:
        stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        assert list(message.name) == ["shoulder", "elbow"]
        errors.append(message.position - positions[stamp])
        drives = model.robot.forcing((stamp - 10**9) * 1e-9)
        assert np.allclose(message.effort, drives, atol=1e-12)
    assert np.std(errors) == pytest.approx(0.001, rel=0.1)
    assert abs(np.mean(errors)) < 1e-4


def test_commands_that_read_any_bag_read_this_one(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Check and export do; identify says that it needs a linear model."""
    assert main(["check", str(bag), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["content"]["model"]["name"] == "hammer_arm"
    assert main(["export", str(bag), "--what", "states", "-o", str(tmp_path / "s.csv")]) == 0
    capsys.readouterr()
    assert main(["identify", str(bag), "--free", "restitution"]) == 2
    assert capsys.readouterr().err.endswith("; identify needs a linear model\n")


def test_impacts_of_a_robot_are_imported_with_the_names_of_its_contacts(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A table of impact times becomes a bag; the name of no contact is an error."""
    table, imported = tmp_path / "events.csv", tmp_path / "imported"
    assert main(["export", str(bag), "--what", "events", "-o", str(table)]) == 0
    words = ["import", str(table), "--model", "hammer_arm", "-o"]
    assert main([*words, str(imported)]) == 0
    with BagReader(bag) as one, BagReader(imported) as two:
        assert [each.stamp for each in events_in(one)] == [each.stamp for each in events_in(two)]
    table.write_text(table.read_text().replace("wall", "floor"))
    capsys.readouterr()
    assert main([*words, str(tmp_path / "other")]) == 2
    assert "floor" in capsys.readouterr().err


def test_a_random_plant_has_drawn_parameters() -> None:
    """Damping and restitution of the draw act; impossible draws are drawn again."""
    model = model_of(
        DOUBLE,
        "shoulder, elbow",
        damping="{elbow: {value: 0.3, deviation: 0.1}}",
        contacts=wall(restitution="{value: 0.95, deviation: 0.1}"),
    )
    for seed in range(10):
        drawn = random_plant(model, seed)
        assert isinstance(drawn.system, Robot)
        assert drawn.system.damping[1] == drawn.values["damping.elbow"]
        assert drawn.system.eps[0] == drawn.values["restitution.wall"] <= 1.0


def test_observer_follows_the_truth_of_a_bag(bag: Path, tmp_path: Path) -> None:
    """Estimates at the stamps of the true states, through both hits, within four deviations."""
    made = tmp_path / "made"
    words = f"observe {bag} --law minimum-variance --measurements hammer_arm"
    assert main([*words.split(), "--clock-error", "1e-6", "-o", str(made)]) == 0
    with BagReader(made) as reader:
        truth = reader.joint_states(interfaces.PLANT_JOINT_STATES.topic)
        found = reader.observer_states(interfaces.OBSERVER_STATES.topic)
        hits = np.array([each.stamp for each in events_in(reader)])
    assert hits.size
    assert np.array_equal(found.stamps, truth.stamps)
    z = (found.x - truth.x) / found.deviations
    since = (truth.stamps[:, None] - hits).astype(float)
    settled = ~np.any((since > -1e6) & (since < 3e6), axis=1)  # the jump is within a sample
    assert np.percentile(np.abs(z[settled]), 99) < 4
    assert 0.5 < np.sqrt(np.mean(z[settled] ** 2)) < 1.5


@pytest.mark.parametrize("law", ["geometric", "open-loop"])
def test_other_laws_refuse_a_robot_in_one_line(
    bag: Path, tmp_path: Path, law: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The line names the law and the one that does."""
    words = f"observe {bag} --law {law} --measurements hammer_arm -o {tmp_path / 'made'}"
    assert main(words.split()) == 2
    said = capsys.readouterr().err.strip()
    assert f"law {law}: takes no robot, as hammer_arm is; expected --law minimum-variance" in said
