# SPDX-License-Identifier: Apache-2.0
"""The likelihood of an impact: the density of the instant at which a gap closes."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import integrate, special, stats
from systems import (
    forcing,
    system,
)

from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.impact_filter import EventQuery, ImpactFilter
from impact_observer.model import Forcing, System
from impact_observer.model.force_samples import Samples

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
    found = filter_.conditioning.likelihood(change, GaussianState.of(then[None], Phi @ S), clock)
    bin_ = spread / 5
    instants = passages(x, S, gravity)
    low, high = (dt - bin_ / 2 - instants) / clock, (dt + bin_ / 2 - instants) / clock
    density = np.mean(special.ndtr(high) - special.ndtr(low)) / bin_
    assert found.density == pytest.approx(math.log(density), abs=0.06)
    assert found.innovations[0] == pytest.approx(abs(deviations), rel=0.05, abs=0.05)


@pytest.mark.parametrize("speed", [-1.0, -0.3, 0.0, 0.2])
@pytest.mark.parametrize("correlation", [-0.9, 0.0, 0.9])
@pytest.mark.parametrize("gap", [0.0, 0.15])
def test_likelihood_is_that_of_a_gap_that_closes(
    speed: float, correlation: float, gap: float
) -> None:
    """The integral of Rice over gap and speed: speeds of large deviation, or hardly closing."""
    cross = math.sqrt(1.0 - correlation**2)
    S = np.array([[0.1, 0.0], [0.3 * correlation, 0.3 * cross]])
    filter_, change = ImpactFilter(ball(0.0)), ContactChange(0.0, (), (0,), ())
    state = GaussianState.of(np.array([[gap, speed]]), S)
    found = filter_.conditioning.likelihood(change, state, 1e-9).density
    both = stats.multivariate_normal([gap, speed], S @ S.T)
    closing, _ = integrate.quad(lambda u: -u * both.pdf([0.0, u]), -4.0, 0.0, limit=200)
    assert found == pytest.approx(math.log(closing), abs=1e-5)


def test_likelihood_of_an_outlier_falls_with_its_distance() -> None:
    """Hundreds of deviations off: finite, and less the farther off it is."""
    filter_ = ImpactFilter(ball(9.81))
    found = []
    for gap in (0.2, 1.0, 30.0, 1e6):
        change = ContactChange(0.0, (), (0,), ())
        state = GaussianState.of(np.array([[gap, -2.0]]), 0.01 * np.eye(2))
        found.append(filter_.conditioning.likelihood(change, state, 1e-9).density)
    assert np.all(np.isfinite(found))
    assert found == sorted(found, reverse=True)


@pytest.mark.parametrize("faster", [1.0, 40.0])
def test_a_release_that_measures_nothing_is_as_likely_in_any_unit_of_time(faster: float) -> None:
    """A force that jumps releases a body; the density of the instant scales with the model."""
    time, force = np.array([0.0, 1.0, 9.0]) / faster, faster**2 * np.array([[-3.0], [3.0], [3.0]])
    steps = Forcing.of_samples(Samples(time, force, "previous"))
    stop = [([1], 0.0, 0.5)]
    filter_ = ImpactFilter(system(1, 0.1 * faster, faster**2, contacts=stop, force=steps))
    state = GaussianState.of(np.zeros((1, 2)), np.diag([0.0, 0.0]), (0,))
    release = EventQuery(ContactChange(1.0 / faster, (0,), (), ()), state, 1e-9)
    (found,) = filter_.likelihoods([release])
    assert not found.innovations
    assert found.density == pytest.approx(math.log(faster), abs=1e-9)
