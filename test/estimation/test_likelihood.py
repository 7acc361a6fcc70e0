# SPDX-License-Identifier: Apache-2.0
"""The likelihood of an impact: the density of the instant at which a gap closes."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import special, stats
from systems import (
    forcing,
    system,
)

from impact_observer.estimation.contact_change import ContactChange
from impact_observer.estimation.gaussian_state import GaussianState
from impact_observer.estimation.impact_filter import ImpactFilter
from impact_observer.model import System

Array = NDArray[np.float64]


def ball(gravity: float) -> System:
    """A mass above a floor at zero."""
    force = forcing(1, [-gravity])
    return system([[1.0]], [[0.0]], [[0.0]], contacts=[([1], 0.0, 0.5)], force=force)


def passages(x: Array, root: Array, gravity: float) -> Array:
    """When each of many such masses hits the floor, s: NaN where it never does."""
    half = np.random.default_rng(3).normal(size=(100_000, 2)) @ root.T
    q, u = (x + np.vstack([half, -half])).T
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((u + np.sqrt(u * u + 2 * gravity * q)) / gravity)


@pytest.mark.parametrize("clock", [1e-9, 5e-3])
@pytest.mark.parametrize("root", [[[0.01, 0], [0, 0.01]], [[0.01, 0], [0.02, 0.01]]])
@pytest.mark.parametrize("deviations", [-1.5, 0.0, 1.0])
def test_likelihood_is_the_density_of_the_first_passage(
    clock: float, root: list[list[float]], deviations: float
) -> None:
    """200000 masses that fall, a histogram of their instants, and the clock's error on top."""
    model, gravity, x, S = ball(9.81), 9.81, np.array([0.0, -2.0]), np.array(root)
    spread = math.hypot(float(np.linalg.norm(S[0])) / 2.0, clock)
    dt = deviations * spread
    Phi = np.array([[1.0, dt], [0.0, 1.0]])
    then = Phi @ x - gravity * np.array([dt * dt / 2, dt])
    filter_, change = ImpactFilter(model), ContactChange(dt, (), (0,), ())
    prior = filter_.joint_prior(change, GaussianState.of(then[None], Phi @ S), clock)
    found = filter_.likelihood(change, prior)
    bin_ = spread / 5
    instants = passages(x, S, gravity)
    low, high = (dt - bin_ / 2 - instants) / clock, (dt + bin_ / 2 - instants) / clock
    density = np.mean(special.ndtr(high) - special.ndtr(low)) / bin_
    assert found.density == pytest.approx(math.log(density), abs=0.06)
    assert found.innovations[0] == pytest.approx(abs(deviations), rel=0.05, abs=0.05)


@pytest.mark.parametrize("speed", [-1.0, -0.3, 0.0, 0.2])
def test_likelihood_is_that_of_a_gap_that_closes(speed: float) -> None:
    """Rice's formula for uniform motion: speeds of large deviation, or hardly closing."""
    S = np.diag([0.1, 0.3])
    filter_, change = ImpactFilter(ball(0.0)), ContactChange(0.0, (), (0,), ())
    prior = filter_.joint_prior(change, GaussianState.of(np.array([[0.0, speed]]), S), 1e-9)
    found = filter_.likelihood(change, prior).density
    closing = -speed * special.ndtr(-speed / 0.3) + 0.3 * stats.norm.pdf(speed / 0.3)
    exact = math.log(stats.norm.pdf(0.0, scale=0.1) * closing)
    assert found == pytest.approx(exact, abs=0.7 if speed > 0 else 0.3)
    faster = filter_.joint_prior(change, GaussianState.of(np.array([[0.0, speed - 1.0]]), S), 1e-9)
    assert filter_.likelihood(change, faster).density > found


def test_likelihood_of_an_outlier_falls_with_its_distance() -> None:
    """Hundreds of deviations off: finite, and less the farther off it is."""
    filter_ = ImpactFilter(ball(9.81))
    found = []
    for gap in (0.2, 1.0, 30.0, 1e6):
        change = ContactChange(0.0, (), (0,), ())
        state = GaussianState.of(np.array([[gap, -2.0]]), 0.01 * np.eye(2))
        found.append(filter_.likelihood(change, filter_.joint_prior(change, state, 1e-9)).density)
    assert np.all(np.isfinite(found))
    assert found == sorted(found, reverse=True)
