# SPDX-License-Identifier: Apache-2.0
"""The certificate of the observer of velocities: V never rises, for any switching."""

import numpy as np
import pytest
from arms import DOUBLE, model_of, random_arm, wall

from impact_observer.errors import UsageError
from impact_observer.plant import Plant
from impact_observer.robots.robot import Robot
from impact_observer.robots.velocity_observer import VelocityObserver, growth_rate
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Stamps

pytest.importorskip("pinocchio", reason="not installed: extra robots")


def robot_of(seed: int, contacts: int = 2) -> Robot:
    """A random arm."""
    model = random_arm(seed, contacts=contacts)
    assert model.robot is not None
    return Robot(model.robot)


@pytest.mark.parametrize("seed", range(40))
def test_v_never_rises_for_any_switching(seed: int) -> None:
    """A random arm, torque, start and sequence of impacts: V falls by the promised factor.

    The sets of contacts that are switched have G - E G E >= 0. Impacts come at any position.
    """
    robot, rng = robot_of(seed), np.random.default_rng(seed)
    n, h, margin = robot.n, 1e-3, 2.0
    x, tau = rng.normal(size=2 * n) * np.repeat([1.0, 2.0], n), rng.normal(size=n)
    observer = VelocityObserver(robot, 3 * rng.normal(size=n), margin=margin)
    first = before = observer.distance(x[:n], x[n:])
    jumps = 0
    for _ in range(50):
        middle = robot.advanced(x, tau, h / 2)
        end = robot.advanced(middle, tau, h / 2)
        observer.step(np.array([x[:n], middle[:n], end[:n]]), h, tau)
        x = end
        after = observer.distance(x[:n], x[n:])
        assert after <= before * np.exp(-2 * margin * h) * (1 + 1e-6) + 1e-10 * first
        before = after
        contacts = ((), (0,), (1,), (0, 1))[rng.choice(4, p=[0.7, 0.1, 0.1, 0.1])]
        if contacts and robot.is_nonexpansive(x[:n], contacts):
            x = np.concatenate([x[:n], robot.velocity_after(x[:n], x[n:], contacts)])
            observer.correct(x[:n], contacts)
            after = observer.distance(x[:n], x[n:])
            assert after <= before + 1e-12 * first
            before, jumps = after, jumps + 1
    assert jumps >= 1


def test_the_estimate_finds_the_velocity_of_a_plant_that_slides_along_a_wall() -> None:
    """Impacts, bounces to rest, lasting contact and release; V never rises."""
    model = model_of(
        DOUBLE,
        "shoulder, elbow",
        contacts=wall(restitution=0.3, offset=0.25),
        forcing="{constant: [-3, -1]}",
    )
    assert model.robot is not None
    robot = Robot(model.robot)
    plant = Plant(robot, np.array([0.8, 0.3]), np.zeros(2), epoch=NS_PER_S)
    observer, tau = (
        VelocityObserver(robot, np.array([2.0, -3.0]), margin=2.0),
        np.array([-3.0, -1]),
    )

    def times(begin: int, end: int) -> Stamps:
        count = 2 * max(1, round((end - begin) / 2_000_000))
        return np.linspace(begin, end, count + 1).astype(np.int64)

    now, last, seen = NS_PER_S, 3 * NS_PER_S, set[bool]()
    first = before = observer.distance(np.array([0.8, 0.3]), np.zeros(2))
    while now < last:
        coming = plant.next_switching(last)
        until = last if coming is None else coming.instant.stamp
        stamps = times(now, until)
        states = plant.states(stamps[:-1])
        final = plant.states(stamps[-1:]) if coming is None else coming.before[None]
        states = np.vstack([states, final])
        closed = plant.closed
        seen.add(bool(closed))
        for k in range(0, len(stamps) - 1 if until > now else 0, 2):
            seconds = (stamps[k + 2] - stamps[k]) * 1e-9
            observer.step(states[k : k + 3, :2], seconds, tau, closed)
            after = observer.distance(states[k + 2, :2], states[k + 2, 2:])
            assert after <= before + 1e-8 * first
            before = after
        if coming is not None:
            plant.cross(coming)
            if coming.contacts:
                observer.correct(coming.before[:2], coming.contacts)
                if coming.closed:
                    observer.velocity = robot.velocity_after(
                        coming.after[:2], observer.velocity, coming.closed, plastic=True
                    )
                after = observer.distance(coming.after[:2], coming.after[2:])
                assert after <= before + 1e-8 * first
                before = after
        now = until
    assert seen == {False, True}
    assert before < 1e-3 * first


def test_without_a_gain_an_error_may_grow() -> None:
    """The growth rate is positive somewhere, and 0 for one joint, whose mass is constant."""
    rates = []
    for seed in range(5):
        robot, rng = robot_of(seed), np.random.default_rng(seed)
        q, u = rng.normal(size=(2, robot.n))
        C, M = robot.coriolis(q, u), robot.mass(q)
        found = growth_rate(robot, q, u)
        e = rng.normal(size=(200, robot.n))
        quotient = np.einsum("ki,ij,kj->k", e, -(C + C.T), e) / np.einsum("ki,ij,kj->k", e, M, e)
        assert np.max(quotient) <= found + 1e-12
        rates.append(found)
    assert max(rates) > 0.1


def test_a_margin_below_zero_is_refused() -> None:
    """The line names the argument."""
    with pytest.raises(UsageError, match="margin"):
        VelocityObserver(robot_of(0), np.zeros(robot_of(0).n), margin=-1.0)
