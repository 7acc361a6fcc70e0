# SPDX-License-Identifier: Apache-2.0
"""Smoothing a recording of a robot: by its hits, encoders and efforts, before and after."""

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pinocchio", reason="not installed: extra robots")

from impact_observer.cli.main import main
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import impact_estimates, model_of
from impact_observer.io.state_arrays import ObserverStates, joined
from impact_observer.plant import simulate
from impact_observer.plant.master import make_plant
from impact_observer.resources import shared
from impact_observer.robots.robot import robot_of

BAG = str(shared("bags/hammer_arm"))
GIVEN = ["--measurements", "hammer_arm", "--clock-error", "0.0002", "--duration", "1.6"]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The estimates of the observer, and the smoothed ones: one hit."""
    folder = tmp_path_factory.mktemp("smoothed")
    one, two = folder / "observed", folder / "smoothed"
    law = ["--law", "minimum-variance"]
    assert main(["observe", BAG, *GIVEN, *law, "-o", str(one)]) == 0
    assert main(["smooth", BAG, *GIVEN, "-o", str(two)]) == 0
    return one, two


@pytest.mark.long
def test_smoothed_states_of_a_robot_are_nearer_to_the_truth(
    made: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    """Velocities after a hit by a factor of two, positions too, within their deviations."""
    capsys.readouterr()
    assert main(["compare", *map(str, made), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    filtered, smoothed = found["minimum-variance"], found["smoother"]
    assert smoothed["velocity_after_hits"] < filtered["velocity_after_hits"] / 2
    assert np.all(np.array(smoothed["rms"]) < 0.8 * np.array(filtered["rms"]))
    assert min(smoothed["coverage"]) > 0.9
    assert smoothed["impacts_used"] == 1


@pytest.mark.slow
def test_smoothing_learns_the_restitution_from_the_encoders_after_a_hit(
    made: tuple[Path, Path],
) -> None:
    """That of the plant, which is not the model's, ten times better than declared."""
    with BagReader(made[1]) as reader:
        true = model_of(reader).provenance["true_parameters"]
        estimates = joined(block for _, block in reader.blocks(["/smoother/state"]))
        state = next(message for _, message in reader.messages("/smoother/state"))
    assert isinstance(estimates, ObserverStates)
    assert list(state.parameter_name) == ["restitution.wall"]
    (value,), (deviation,) = state.parameter, state.parameter_deviation
    assert isinstance(true, dict)
    assert deviation < 0.005
    assert abs(value - true["restitution.wall"]) < 3 * deviation


@pytest.mark.slow
def test_the_hit_of_a_robot_is_that_of_the_plant(made: tuple[Path, Path]) -> None:
    """Speeds and impulse within three deviations, with the restitution of the plant."""
    with BagReader(made[0]) as reader:
        model, event = model_of(reader), next(iter(reader.events()))
        true = model.provenance["true_parameters"]
    assert isinstance(true, dict)
    robot = robot_of(model).with_parameters(true)
    plant = make_plant(robot, *model.initial_state(), epoch=event.epoch)
    switchings = simulate(plant, np.array([event.stamp + 10_000_000])).switchings
    hit = next(each for each in switchings if np.any(each.before != each.after))
    q, before, after = hit.before[:2], hit.before[2:], hit.after[2:]
    w, change = robot.directions(q, (0,))[:, 0], robot.mass(q) @ (after - before)
    truth = [-w @ before, w @ after, change @ w / (w @ w)]
    for bag in made:
        with BagReader(bag) as reader:
            ((found,),) = impact_estimates(reader).values()
        errors = np.abs(np.array(found[4:7]) - truth)
        assert np.all(errors < 3 * np.array(found[8:11]))
        assert np.all(np.array(found[8:11]) < 0.2 * np.abs(truth))


def test_smoothing_a_robot_without_encoders_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its motion does not follow from impact times alone."""
    assert main(["smooth", BAG, "-o", str(tmp_path / "made")]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "expected its encoders, --measurements FILE" in line
