# SPDX-License-Identifier: Apache-2.0
"""Damping and rotor inertia of robots with deviations: errors are as large as is published."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

pytest.importorskip("pinocchio", reason="not installed: extra robots")

from robot_runs import EPOCH, Truth, observer_of

from impact_observer.cli.main import main
from impact_observer.model import Model, parse_model, read_model
from impact_observer.plant.random_parameters import random_plant
from impact_observer.robots import Robot

DEVIATIONS = {
    "damping.shoulder": 0.1,
    "damping.elbow": 0.1,
    "rotor-inertia.shoulder": 0.05,
    "rotor-inertia.elbow": 0.01,
}
RUNS, SECONDS = 5, 1.4
"""Draws of the plant, each with one or two hits."""


class Consistency(NamedTuple):
    """How errors compare with their published covariances.

    Attributes:
        nees: mean of ``e' P^-1 e`` over the number of states.
        covered: share of the errors within two deviations.
    """

    nees: float
    covered: float


def arm(**deviations: float) -> Model:
    """The sample arm, whose parameters of these names have deviations."""
    model = read_model("hammer_arm")
    assert model.robot is not None
    names, squares = [*deviations], np.square([*deviations.values()]).tolist()
    text = model.text().replace("restitution.wall", ", ".join([*names, "restitution.wall"]))
    before, _ = text.split("covariance:")
    return parse_model(f"{before}covariance: {np.diag([*squares, 0.0025]).tolist()}\n", "arm")


def consistency(declared: Model, drawn: Model) -> Consistency:
    """Of observers of a ``declared`` model, where plants are drawn from another one."""
    squares, inside = list[float](), list[np.ndarray]()
    for seed in range(RUNS):
        plant = random_plant(drawn, seed).system
        assert isinstance(plant, Robot)
        recording = Truth.of_plant(plant, drawn.initial_state(), 200.0, SECONDS).recorded(seed)
        observer, events = observer_of(declared, recording), [*recording.events]
        samples = iter(recording.samples)
        for stamp, truth in zip(recording.truth.stamps, recording.truth.states, strict=True):
            while events and events[0].stamp <= stamp:
                observer.receive(events.pop(0))
            observer.measure([next(samples) for _ in range(2)])
            found = observer.estimate(int(stamp))
            if stamp < EPOCH + 2 * 10**8:
                continue
            error = np.concatenate([found.q, found.u]) - truth
            squares.append(error @ np.linalg.solve(found.covariance, error) / error.size)
            inside.append(np.abs(error) <= 2 * np.sqrt(np.diag(found.covariance)))
    return Consistency(float(np.mean(squares)), float(np.mean(inside)))


@pytest.mark.long
@pytest.mark.parametrize("kind", ["damping", "rotor-inertia"])
def test_errors_of_plants_with_drawn_parameters_are_as_large_as_published(kind: str) -> None:
    """With the deviation in the model; without it errors are far outside."""
    drawn = arm(**{name: each for name, each in DEVIATIONS.items() if name.startswith(kind)})
    considered, exact = consistency(drawn, drawn), consistency(arm(), drawn)
    assert 0.5 < considered.nees < 2
    assert considered.covered > 0.8
    assert exact.nees > 2 * considered.nees
    assert exact.covered < considered.covered - 0.05


def test_considered_parameters_are_named_with_their_units(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """None is taken for exact."""
    model, bag = tmp_path / "arm.yaml", tmp_path / "bag"
    model.write_text(arm(**{"damping.elbow": 0.1, "rotor-inertia.shoulder": 0.02}).text())
    given = "--measurements hammer_arm"
    assert main(f"simulate {model} --duration 0.1 --rate 100 {given} -o {bag}".split()) == 0
    capsys.readouterr()
    law = "--law minimum-variance --clock-error 0.0002 --epoch 1"
    assert main(f"observe {bag} {given} {law} -o {tmp_path / 'estimates'}".split()) == 0
    said = " ".join(capsys.readouterr().out.split())
    for each in (
        "damping.elbow [N m s/rad] 0.30 +- 0.1",
        "rotor-inertia.shoulder [kg m^2] 0.100 +- 0.02",
        "restitution.wall 0.400 +- 0.05",
    ):
        assert each in said
