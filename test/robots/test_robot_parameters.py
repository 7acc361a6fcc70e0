# SPDX-License-Identifier: Apache-2.0
"""Derivatives by the parameters of a robot against differences of robots."""

from collections.abc import Callable

import numpy as np
import pytest
from arms import random_arm

from impact_observer.robots.robot import Robot
from impact_observer.robots.robot_parameters import jump_by_parameters, rates_by_parameters
from impact_observer.states import Matrix, Vector

pytest.importorskip("pinocchio", reason="not installed: extra robots")


@pytest.mark.parametrize("contacts", [(), (0,), (0, 1)])
@pytest.mark.parametrize("seed", range(3))
def test_derivatives_by_parameters_are_those_of_differences(
    seed: int, contacts: tuple[int, ...]
) -> None:
    """Of accelerations with closed contacts, and of impacts, by all parameters."""
    model = random_arm(seed, 4, contacts=2)
    assert model.robot is not None
    description = model.robot
    robot, names = Robot(description), [*description.parameters]
    x, tau = np.random.default_rng(seed).normal(size=8), np.ones(4)

    def slopes(function: Callable[[Robot], Vector]) -> Matrix:
        columns = []
        for name in names:
            value = description.parameters[name]
            ends = [
                function(Robot(description.with_parameters({name: value + sign * 1e-5})))
                for sign in (1, -1)
            ]
            columns.append((ends[0] - ends[1]) / 2e-5)
        return np.transpose(columns)

    found = rates_by_parameters(robot, x, tau, names, contacts)
    expected = slopes(lambda other: other.rates(x, tau, contacts))
    assert np.allclose(found, expected, rtol=1e-5, atol=1e-5 * np.max(np.abs(expected)))
    if contacts:
        found = jump_by_parameters(robot, x, contacts, names)
        expected = slopes(lambda other: other.jumped(x, contacts))
        assert np.allclose(found, expected, rtol=1e-6, atol=1e-7 * np.max(np.abs(expected)))


def test_a_robot_with_other_parameters_is_that_of_its_model_file() -> None:
    """Masses, accelerations and impacts, while the robot itself stays as it is."""
    robot = Robot(random_arm(2, 3))
    values = {name: 0.5 * value for name, value in robot.description.parameters.items()}
    x, tau, mass = np.random.default_rng(2).normal(size=6), np.ones(3), robot.mass(np.ones(3))
    other, read = robot.with_parameters(values), Robot(robot.description.with_parameters(values))
    assert np.array_equal(other.mass(np.ones(3)), read.mass(np.ones(3)))
    assert np.array_equal(other.rates(x, tau), read.rates(x, tau))
    assert np.array_equal(other.jumped(x, (0,)), read.jumped(x, (0,)))
    assert np.array_equal(robot.mass(np.ones(3)), mass)
