# SPDX-License-Identifier: Apache-2.0
"""The white torques that stand for efforts which are held from sample to sample."""

import math
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from impact_observer.model import read_model
from impact_observer.robots.robot import Robot, connected_robot, observed
from impact_observer.states import Matrix, Vector

EPOCH = 1_000_000_000


def under(efforts: Matrix, rate: float) -> Robot:
    """A robot under ``efforts``, shape (samples, 2), from the epoch on, without a deviation."""
    model = read_model("hammer_arm")
    assert model.robot is not None
    undeclared = replace(model.robot, torque_deviation=None)
    robot, live = connected_robot(observed(replace(model, robot=undeclared)))
    assert live is not None
    for k, row in enumerate(efforts.tolist()):
        for name, value in zip(robot.coordinates, row, strict=True):
            live.add_force(name, EPOCH + round(k / rate * 1e9), value)
    live.follow(EPOCH)
    return robot


def impulses(effort: Vector, fine: int, apart: int) -> Vector:
    """Impulses that held samples lack in ``apart`` periods, N m by period, by a fine sum.

    ``effort`` has ``fine`` values in each period.
    """
    lacks = effort.reshape(-1, fine) - effort[::fine, None]
    return np.convolve(lacks.mean(axis=1), np.ones(apart), "valid")


@pytest.mark.parametrize("rate", [200.0, 1000.0])
def test_white_torques_make_the_largest_impulses_that_held_samples_lack(rate: float) -> None:
    """Of a swinging torque: a fine sum of its errors, over all numbers of periods, is the oracle.

    The other joint holds still.
    """
    fine, amplitude, frequency, samples = 20, 4.0, 5.0, 513
    t = np.arange(samples * fine) / (rate * fine)
    effort = amplitude * np.sin(2 * math.pi * frequency * t + 0.3)
    robot = under(np.column_stack([effort[::fine], np.full(samples, 7.0)]), rate)
    found = robot.white_torques(512 / rate)
    most = max(
        np.mean(impulses(effort, fine, m) ** 2) / (m * rate) for m in range(1, samples // 2)
    )
    assert found[0] == pytest.approx(math.sqrt(most), rel=0.1)
    assert found[1] == 0.0
    assert robot.has_white_torques


def test_white_torques_are_those_of_the_samples_before() -> None:
    """Later samples change nothing, nor does the time at which samples come."""
    efforts = np.random.default_rng(3).normal(size=(400, 2))
    whole, half = under(efforts, 1000.0), under(efforts[:201], 1000.0)
    for t in (0.0, 0.001, 0.0155, 0.1, 0.2):
        assert np.array_equal(whole.white_torques(t), half.white_torques(t))
    assert not whole.white_torques(0.0).any()
    assert whole.white_torques(0.2) == pytest.approx(math.sqrt(0.0005) * np.ones(2), rel=0.2)
