# SPDX-License-Identifier: Apache-2.0
"""The plant against Moreau's time stepping, whose error falls with its step."""

import numpy as np
import pytest
from systems import EPOCH, crossed, forcing, sample, system
from time_stepping import stepped

from impact_observer.model import Model, parse_model
from impact_observer.plant import Plant
from impact_observer.stamps import NS_PER_S

SHAKEN = """\
name: shaken
bodies: [{name: x1, mass: 1}, {name: x2, mass: 2}]
grounds: [{name: table, motion: {harmonics: [{amplitude: 0.05, frequency: 6, phase: 0.4}]}}]
springs:
  - {between: [table, x1], stiffness: 50, damping: 0.7}
  - {between: [x1, x2], stiffness: 40, damping: 0.3}
forces: [{body: x2, amplitude: 4, frequency: 2.5}]
stops: [{name: plate, between: [table, x1], gap: 0.1, restitution: 0.9}]
initial_state: {position: [0.1, 0], velocity: [0, 0.5]}
"""


def model_named(name: str) -> Model:
    """A sample model, or one on a table that moves."""
    return parse_model(SHAKEN, name) if name == "shaken" else sample(name)


def test_steps_bounce_a_ball_at_the_times_of_the_closed_form() -> None:
    """Ten impacts, late by a step each at most and half a step on average."""
    ball = system(1, 0, 0, contacts=[([1], 0.0, 0.9)], force=forcing(1, -9.81))
    first = np.sqrt(2 / 9.81)
    exact = first + np.concatenate([[0], np.cumsum(2 * first * 0.9 ** np.arange(1, 10))])
    for h in (4e-3, 1e-3):
        found = stepped(ball, np.ones(1), np.zeros(1), h, float(exact[-1]) + 0.1)
        times = np.array([t for t, _ in found.impacts])
        assert np.mean(np.abs(times - exact)) < 8 * h


@pytest.mark.parametrize(
    ("name", "seconds"),
    [("two_mass", 8.0), ("three_mass", 10.0), ("yielding_stop", 6.0), ("shaken", 2.0)],
)
def test_impacts_and_states_of_the_plant_are_those_of_ever_shorter_steps(
    name: str, seconds: float
) -> None:
    """The same contacts in the same order; errors fall with the step, to first order."""
    model = model_named(name)
    plant = Plant(model.system, *model.initial_state(), epoch=EPOCH)
    expected = [each for each in crossed(plant, seconds) if each.contacts]
    assert len(expected) >= 3
    instants = np.array([-each.instant.until(EPOCH) for each in expected])
    last = plant.states(np.array([EPOCH + round(seconds * NS_PER_S)]))[0]
    late, off = [], []
    for h in (4e-3, 1e-3):
        found = stepped(model.system, *model.initial_state(), h, seconds)
        assert [i for _, i in found.impacts] == [i for each in expected for i in each.contacts]
        times = np.array([t for t, _ in found.impacts])
        late.append(float(np.mean(np.abs(times - instants))))
        off.append(float(np.linalg.norm(found.state - last)))
    assert late[0] < 5 * 4e-3
    assert late[1] < late[0] / 2
    assert off[1] < off[0] / 2
