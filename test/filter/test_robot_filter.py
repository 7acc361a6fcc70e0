# SPDX-License-Identifier: Apache-2.0
"""A robot as the filter sees it, against differences of its own motion and jumps."""

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from impact_observer.events import Kind
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.impact_filter import ImpactFilter
from impact_observer.filter.robot_guards import RobotGuards
from impact_observer.filter.robot_motion import RobotMotion
from impact_observer.model import read_model
from impact_observer.model.forcing import Forcing
from impact_observer.robots.robot import Robot, connected_robot
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Matrix, Vector

TORQUES = np.array([2.0, -1.0])


def hammer(torque_deviation: float = 0.0) -> Robot:
    """The sample arm under constant torques."""
    description = read_model("hammer_arm").robot
    assert description is not None
    deviations = np.full(2, torque_deviation)
    robot = Robot(replace(description, torque_deviation=deviations))
    return robot.with_forcing(replace(Forcing.none(2), constant=TORQUES))


def at_wall(robot: Robot) -> Vector:
    """A state on the plane, which moves into it, shape (4,)."""
    q = robot.projected(np.array([-0.6, -0.3]), (0,))
    x = np.concatenate([q, [-3.0, -5.0]])
    assert robot.contact_speeds(x)[0] < -0.5
    return x


def differences(function: Callable[[Vector], Vector], x: Vector, step: float = 1e-6) -> Matrix:
    """Central differences of a function of a state, a column each."""
    steps = step * np.eye(x.size)
    return np.column_stack([(function(x + h) - function(x - h)) / (2 * step) for h in steps])


@pytest.mark.parametrize("seconds", [0.001, 0.03, -0.002])
def test_motion_and_derivative_are_those_of_the_flow(seconds: float) -> None:
    """Fine steps and differences are the oracle."""
    robot = hammer()
    moving, x = RobotMotion(robot), np.array([0.3, -0.8, 2.0, -4.0])
    fine = x
    for _ in range(1000):
        fine = robot.advanced(fine, TORQUES, seconds / 1000)
    found, map_ = moving.moved(0.0, x, seconds, ())
    assert np.allclose(found, fine, atol=1e-7)
    by_flow = differences(lambda each: moving.state_after(0.0, each, seconds, ()), x)
    assert np.allclose(map_, by_flow, atol=1e-4 * abs(seconds) / 0.001)


def test_white_torques_add_what_many_small_kicks_add() -> None:
    """A covariance by hundreds of steps is the oracle."""
    robot = hammer(torque_deviation=0.3)
    moving, x, seconds, count = RobotMotion(robot), np.array([0.3, -0.8, 2.0, -4.0]), 0.02, 400
    P, h = np.zeros((4, 4)), seconds / count
    for _ in range(count):
        x_after, map_ = moving.moved(0.0, x, h, ())
        kick = np.vstack([np.zeros((2, 2)), 0.3 * robot.inverse_mass(x[:2])])
        P, x = map_ @ P @ map_.T + h * kick @ kick.T, x_after
    root = moving.diffusion(0.0, np.array([0.3, -0.8, 2.0, -4.0]), (), seconds)
    size = np.sqrt(np.outer(np.diag(P), np.diag(P)))
    assert np.allclose(root @ root.T / size, P / size, atol=0.02)


def under_efforts(robot: Robot, efforts: Matrix) -> Robot:
    """The robot under ``efforts`` that come live, one row a millisecond from the epoch on."""
    robot, signals = connected_robot(robot.with_forcing(Forcing.none(robot.n)))
    assert signals is not None
    for k, row in enumerate(efforts.tolist()):
        for name, value in zip(robot.coordinates, row, strict=True):
            signals.add_force(name, NS_PER_S + k * 10**6, value)
    signals.follow(NS_PER_S)
    return robot


@pytest.mark.parametrize("seconds", [0.0037, 0.25, -0.1])
def test_efforts_that_change_within_a_step_act_as_each_of_them_would(seconds: float) -> None:
    """A motion by a step for each of the efforts is the oracle: they are smooth, and jump."""
    t = np.linspace(0.0, 0.3, 301)
    jumps = np.sign(np.sin(20 * t))
    efforts = np.stack([4 * np.sin(30 * t) + 2 * jumps, np.cos(50 * t) - jumps], axis=1)
    robot, x = under_efforts(hammer(), efforts), np.array([0.3, -0.8, 2.0, -4.0])
    begin = 0.0 if seconds > 0 else 0.1
    found = RobotMotion(robot).state_after(begin, x, seconds, ())
    low, high = sorted((begin, begin + seconds))
    edges = np.clip(np.arange(0, 301) / 1000, low, high)
    spans = [*enumerate(pairwise(edges.tolist()))][:: 1 if seconds > 0 else -1]
    for k, (since, until) in spans:
        x = robot.advanced(x, efforts[k], math.copysign(until - since, seconds))
    assert np.allclose(found[:2], x[:2], atol=1e-6)  # encoders err by 1e-3
    assert np.allclose(found[2:], x[2:], atol=1e-5)  # and velocities then by 2e-2


def test_the_steps_of_a_motion_are_made_once_however_many_efforts_came(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two seconds of efforts at 1 kHz: as many steps as the motion needs, for all instants."""
    robot = under_efforts(hammer(torque_deviation=0.1), np.zeros((2000, 2)))
    moving, x, made = RobotMotion(robot), np.array([0.3, -0.8, 0.0, 0.0]), list[float]()
    advanced = Robot.advanced

    def counted(*args: object) -> Vector:
        made.append(0.0)
        return advanced(*args)  # type: ignore[arg-type]

    monkeypatch.setattr(Robot, "advanced", counted)
    instants = np.linspace(0.0, 2.0, 21)[1:].tolist()
    for s in instants:
        moving.state_after(0.0, x, s, ())
        moving.diffusion(0.0, x, (), s)
        moving.moved(0.0, x, s, ())
    assert len(made) < 2.0 / moving.longest_step + len(instants) + 1


def test_gap_and_its_bend_are_those_of_the_motion() -> None:
    """First and second differences along the motion are the oracle."""
    robot = hammer()
    filter_ = ImpactFilter(robot)
    member, x = filter_.members.given, at_wall(robot)
    moving = RobotMotion(robot)
    rows = member.gaps((0,), x)
    value, H, D, E = rows.expanded(moving.rates_at(0.0, x, ()), x, moving.forces(0.0))

    def gap(e: float, y: Vector) -> float:
        return float(robot.gaps(moving.state_after(0.0, y, -e, ())[:2])[0])

    h = 1e-4
    assert value[0] == pytest.approx(0.0, abs=1e-12)
    assert H[0, 0] == pytest.approx((gap(h, x) - gap(-h, x)) / (2 * h), rel=1e-5)
    assert E[0] == pytest.approx((gap(h, x) - 2 * gap(0, x) + gap(-h, x)) / h**2, rel=1e-3)
    assert np.allclose(H[0, 1:], differences(lambda y: np.array([gap(0, y)]), x)[0], atol=1e-6)
    late = differences(lambda y: np.array([gap(h, y)]), x)[0]
    early = differences(lambda y: np.array([gap(-h, y)]), x)[0]
    assert np.allclose(D[0], (late - early) / (2 * h), atol=1e-3)


def test_impact_maps_errors_as_a_perturbed_motion_does() -> None:
    """The covariance after a hit is that of motions that hit by themselves."""
    robot = hammer()
    filter_, x, ahead = ImpactFilter(robot), at_wall(robot), 0.004
    moving = RobotMotion(robot)

    def after(start: Vector) -> Vector:
        low, high = 0.0, 2 * ahead
        for _ in range(60):
            middle = (low + high) / 2
            gap = robot.gaps(moving.state_after(0.0, start, middle, ())[:2])[0]
            low, high = (middle, high) if gap > 0 else (low, middle)
        landed = robot.jumped(moving.state_after(0.0, start, low, ()), (0,))
        return moving.state_after(low, landed, 2 * ahead - low, ())

    start = moving.state_after(0.0, x, -ahead, ())
    spread = 1e-5 * np.diag([1.0, 1.0, 10.0, 10.0])
    state = GaussianState.of(start[None], spread)
    prior = filter_.priors(0.0, ahead, [state], [0.0])[0]
    change = ContactChange.of(ahead, (), [(0, Kind.IMPACT)], flown=ahead)
    found = filter_.posterior_of_missed(change, prior)
    found = filter_.priors(ahead, ahead, [found], [0.0])[0]
    by_motion = differences(after, start, 1e-6) @ spread
    expected = by_motion @ by_motion.T
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.allclose(found.root @ found.root.T / size, expected / size, atol=0.01)
    assert np.allclose(found.x, after(start), atol=1e-5)


def test_flight_without_hits_is_clear_and_one_with_a_hit_is_not() -> None:
    """The bound of a gap by values and speeds at both ends."""
    robot = hammer()
    moving, x = RobotMotion(robot), at_wall(robot)
    far, near = (moving.state_after(0.0, x, -s, ()) for s in (0.03, 0.0005))
    flight = RobotGuards(robot, moving, 0.0, ())
    assert flight.is_clear(moving.motion(0.0, far, ()), 0.001)
    assert flight.is_clear(moving.motion(0.0, far, ()), 0.02)
    assert not flight.is_clear(moving.motion(0.0, far, ()), 0.04)
    assert not flight.is_clear(moving.motion(0.0, near, ()), 0.001)


def test_rest_is_where_the_robot_itself_rests() -> None:
    """On the plane, without speed, and so are states near it."""
    robot = hammer()
    member, x = ImpactFilter(robot).members.given, at_wall(robot)
    x, map_, _ = member.stopped(x + 1e-3, (0,), np.zeros((1, 0)))
    assert robot.gaps(x[:2])[0] == pytest.approx(0.0, abs=1e-12)
    assert robot.contact_speeds(x)[0] == pytest.approx(0.0, abs=1e-12)
    W = robot.directions(x[:2])
    assert np.allclose(W.T @ map_[:2, :2], 0.0, atol=1e-12)
    assert np.allclose(W.T @ map_[2:, 2:], 0.0, atol=1e-12)
    assert np.linalg.matrix_rank(map_) == 2
