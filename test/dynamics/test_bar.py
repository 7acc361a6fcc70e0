# SPDX-License-Identifier: Apache-2.0
"""A bar of finite elements, clamped at one end: many modes, most of them stiff."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import integrate
from systems import Harmonic, chain, flow_of, forcing, run, system

from impact_observer.dynamics import Phases
from impact_observer.model import System
from impact_observer.stamps import seconds_between

Array = NDArray[np.float64]

GAP, SECONDS = 0.05, 8.5
FORCE, FREQUENCY = 0.4, 1.0


def bar(n: int) -> System:
    """Of length, stiffness, mass and cross-section 1; a force at the end drives it to a stop."""
    ends = np.ones(n)
    ends[-1] = 0.5
    beside = np.eye(n, k=1) + np.eye(n, k=-1)
    K = n * (2 * np.diag(ends) - beside)
    M = (4 * np.diag(ends) + beside) / (6 * n)
    last = np.eye(n)[-1]
    force = forcing(n, np.zeros(n), [Harmonic(FREQUENCY, [0.0] * n, (FORCE * last).tolist())])
    return system(M, 0.2 * M + 1e-2 * K, K, contacts=[(-last, GAP, 0.0)], force=force)


def integrated(model: System) -> list[float]:
    """When the bar hits and leaves its stop, s, by an integrator; the end follows or is held."""
    n = model.n
    found: list[float] = []
    x, t, held = np.zeros(2 * n), 0.0, False
    while t < SECONDS:
        r = n - held
        inverse = np.asarray(np.linalg.inv(model.M[:r, :r]), dtype=np.float64)

        def derivative(s: float, x: Array, inverse: Array = inverse, r: int = r) -> Array:
            q, u = x[:n], x[n:]
            push = model.forcing(s) - model.C @ u - model.K @ q
            return np.concatenate([u, inverse @ push[:r], np.zeros(n - r)])

        def ends(s: float, x: Array, r: int = r) -> float:
            if r == n:
                return float(GAP - x[n - 1])
            rate = derivative(s, x)[n:]
            push = model.forcing(s) - model.C @ x[n:] - model.K @ x[:n]
            return float((push - model.M @ rate)[-1])

        ends.terminal, ends.direction = True, -1.0  # type: ignore[attr-defined]
        part = integrate.solve_ivp(
            derivative, (t, SECONDS), x, method="DOP853", rtol=1e-10, atol=1e-12, events=ends
        )
        t, x, held = part.t[-1], part.y[:, -1].copy(), not held
        if held:
            kick = np.linalg.inv(model.M)[:, -1]
            x[n:] -= kick * (x[-1] / kick[-1])
        found += [t] if t < SECONDS else []
    return found


def test_bar_hits_and_leaves_its_stop_when_an_integrator_says_so() -> None:
    """Elastic waves travel in the bar all the time."""
    model = bar(6)
    found = run(model, np.zeros(6), np.zeros(6), seconds=SECONDS, rate=2.0)
    instants = [
        seconds_between(found.epoch, each.instant.stamp) + each.instant.remainder
        for each in found.switchings
    ]
    expected = integrated(model)
    assert len(instants) == len(expected) >= 4
    np.testing.assert_allclose(instants, expected, rtol=0, atol=1e-8)


def test_release_of_a_fine_bar_is_found_where_its_load_is_zero() -> None:
    """What a load is rounded against does not grow with all that stiff elements might do."""
    n = 80
    model = bar(n)
    found = run(model, np.zeros(n), np.zeros(n), seconds=5.0, rate=1.0)
    (release,) = (each for each in found.switchings if not each.closed)
    t = seconds_between(found.epoch, release.instant.stamp) + release.instant.remainder
    q, u = release.before[:n], release.before[n:]
    loads = Phases(model).phase((0,)).loads
    load = -loads @ (model.forcing(t) - model.C @ u - model.K @ q)
    assert abs(load[0]) < 1e-9


@pytest.mark.parametrize("n", [20, 50])
def test_states_one_by_one_are_those_of_many_modes_alone(n: int) -> None:
    """Bit by bit, though modes die away and are left out."""
    model = bar(n)
    x = np.random.default_rng(n).normal(size=2 * n)
    moving = flow_of(model).start(0.3, x)
    s = np.array([0.0, 1e-3, 0.1, 1.0, 10.0])
    alone = np.array([moving.state(at) for at in s.tolist()])
    np.testing.assert_array_equal(moving.states(s), alone)
    np.testing.assert_allclose(moving.states(s), alone, rtol=0, atol=1e-12)


def test_modes_that_have_died_away_are_not_missed() -> None:
    """Of forty strongly damped masses, against the transition of their state."""
    model = chain(40, stiffness=10.0, damping=8.0)
    x = np.random.default_rng(5).normal(size=80)
    moving = flow_of(model).start(0.0, x)
    for s in (0.0, 5.0, 50.0, 500.0):
        exact = flow_of(model).transition(s / 2) @ moving.state(s / 2)
        np.testing.assert_allclose(moving.state(s), exact, rtol=1e-9, atol=1e-15)
