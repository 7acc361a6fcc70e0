# SPDX-License-Identifier: Apache-2.0
"""Derivatives of a robot's flights and jumps, against differences of its integrated motion."""

import numpy as np
import pytest
from arms import random_arm
from scipy.integrate import solve_ivp

pytest.importorskip("pinocchio", reason="not installed: extra robots")

from impact_observer.filter.robot_family import RobotFamily
from impact_observer.filter.robot_motion import RobotMotion
from impact_observer.robots import Robot
from impact_observer.states import Vector
from impact_observer.trajectory.linearised_robot import LinearisedRobot
from impact_observer.trajectory.linearised_system import FlightEnd

STEP = 1e-6


def linearised(robot: Robot, *names: str) -> LinearisedRobot:
    """Of a robot, whose parameters of these ``names`` are uncertain."""
    family = RobotFamily.named(robot, names)
    return LinearisedRobot(family, family.nominal, RobotMotion(robot))


def moved(robot: Robot, x: Vector, s: float) -> Vector:
    """The motion without torques, by an integrator of scipy."""
    if s == 0:
        return x
    zero = np.zeros(robot.n)
    made = solve_ivp(lambda _, y: robot.rates(y, zero), (0, s), x, rtol=1e-12, atol=1e-13)
    return np.asarray(made.y[:, -1])


def closing(robot: Robot, seed: int) -> Vector:
    """A state on the first plane that moves towards it."""
    x = np.random.default_rng(seed).normal(size=2 * robot.n)
    q = robot.projected(0.3 * x[: robot.n], (0,))
    u = x[robot.n :]
    return np.concatenate([q, u if robot.directions(q, (0,))[:, 0] @ u < 0 else -u])


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("is_measured", [False, True])
def test_jump_of_a_gap_that_is_zero_is_the_saltation(seed: int, is_measured: bool) -> None:
    """The derivative by state, and by an instant that follows from the gap."""
    model = random_arm(seed)
    robot = Robot(model)
    x, made = closing(robot, seed), linearised(robot)
    map_, xi = made.jump(made.begin(0.0, x), FlightEnd(0.0, (0,), (0,)), is_measured=is_measured)
    n, w = robot.n, robot.directions(x[: robot.n], (0,))[:, 0]
    whole = map_.Phi + np.outer(xi, np.append(w / (w @ x[n:]), np.zeros(n)))
    wanted = robot.saltation(x, robot.torques(0.0), 0)
    np.testing.assert_allclose(whole, wanted, atol=1e-9 * np.abs(wanted).max())
    np.testing.assert_allclose(map_.x, robot.jumped(x, (0,)), atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_guard_follows_the_gap_along_the_motion(seed: int) -> None:
    """Its value, rows, rate and bend are those of differences of gaps."""
    robot = Robot(random_arm(seed))
    x, made = closing(robot, seed), linearised(robot)
    n = robot.n
    guard = made.guard(made.begin(0.0, x), (0,), hit=True)

    def gap(start: Vector, s: float = 0.0) -> float:
        return float(robot.gaps(moved(robot, start, s)[:n], (0,))[0])

    rows = [(gap(x + e) - gap(x - e)) / (2 * STEP) for e in STEP * np.eye(2 * n)]
    np.testing.assert_allclose(guard.rows[0], rows, atol=1e-8)
    h = 1e-4
    assert guard.value[0] == pytest.approx(gap(x), abs=1e-12)
    assert guard.rate[0] == pytest.approx((gap(x, h) - gap(x, -h)) / (2 * h), rel=1e-5)
    bend = (gap(x, h) - 2 * gap(x) + gap(x, -h)) / h**2
    assert guard.bend[0] == pytest.approx(bend, rel=1e-3, abs=1e-3)


def test_contacts_that_stay_closed_are_at_rest_afterwards() -> None:
    """A plastic impact, and the projection of a state that is nearly at rest."""
    robot = Robot(random_arm(2))
    x, made = closing(robot, 2), linearised(robot)
    map_, _ = made.jump(made.begin(0.0, x), FlightEnd(0.0, (0,), (0,), held=(0,)))
    assert abs(robot.contact_speeds(map_.x)[0]) < 1e-12
    near = map_.x + 1e-5
    placed = made.on_stops(near, (0,))
    assert abs(robot.gaps(placed.x[: robot.n], (0,))[0]) < 1e-12
    assert abs(robot.contact_speeds(placed.x)[0]) < 1e-12
    again = made.at_rest(placed.x, (0,))
    np.testing.assert_allclose(again.x, placed.x, atol=1e-12)
    np.testing.assert_allclose(again.Phi @ placed.Phi, placed.Phi, atol=1e-4)


@pytest.mark.parametrize("kind", ["damping", "rotor-inertia"])
def test_flight_and_load_follow_other_parameters(kind: str) -> None:
    """Differences of robots with other parameters, free and while a contact is closed."""
    robot = Robot(random_arm(2))
    name = f"{kind}.{robot.coordinates[0]}"
    value, n = robot.description.parameters[name], robot.n
    x, made = closing(robot, 2), linearised(robot, name)
    x[n:] = robot.stopped(x[:n], x[n:], (0,))
    ends = [robot.with_parameters({name: value + sign * 1e-5}) for sign in (1, -1)]
    slope = (moved(ends[0], x, 0.02) - moved(ends[1], x, 0.02)) / 2e-5
    found = made.flow(0.0, x, 0.02, ()).Gamma[:, 0]
    np.testing.assert_allclose(found, slope, atol=1e-3 * np.abs(slope).max())
    at = made.begin(0.0, x)._replace(closed=(0,))
    loads = [each.loads(x[:n], x[n:], np.zeros(n), (0,))[0] for each in ends]
    guard = made.guard(at, (0,), hit=False)
    assert guard.rows[0, 2 * n] == pytest.approx((loads[0] - loads[1]) / 2e-5, rel=1e-4)
