# SPDX-License-Identifier: Apache-2.0
"""The filter's flights by the kernel: against matrix exponentials and the general methods."""

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy import linalg
from systems import examples, sample, system, systems

from impact_observer.dynamics.flow.equations import state_matrix
from impact_observer.estimation.contact_change import ContactChange
from impact_observer.estimation.gaussian_state import GaussianState
from impact_observer.estimation.impact_filter import ImpactFilter
from impact_observer.model import System
from impact_observer.observer.laws.fallback import FallbackReplica

FREE = systems(max_n=4, contacts=(1, 3))


@given(FREE, st.integers(0, 999), st.sampled_from([1e-3, 0.3, 2.0]))
@examples(24)
def test_a_fallback_replica_after_a_flight_and_an_impact_is_that_of_both_steps(
    model: System, seed: int, s: float
) -> None:
    """With the covariance that white accelerations give, its lag, and the gap before."""
    filter_, random, t = ImpactFilter(model), np.random.default_rng(seed), 0.25
    replica, hit = FallbackReplica(filter_), seed % model.m
    begun = replica.begin(random.normal(size=2 * model.n), np.eye(2 * model.n), ())
    begun = begun._replace(errors=random.normal(size=begun.errors.shape))
    before = replica.motion(t, begun, ())(s)
    speed = model.contact_speed(before.x[model.n :])[hit]
    assume(abs(speed) > 1e-3)  # a root's columns may be turned, and then others separate
    after = replica.after(ContactChange(t + s, (), (hit,), ()), before)
    struck = replica.struck(hit, t, s, begun)
    assume(struck is not None)
    assert struck is not None
    found, gap = struck
    size = 1 + np.abs(after.x).max() + np.abs(after.errors).max()
    np.testing.assert_allclose(gap, before.gap(model, hit), rtol=1e-8, atol=1e-9 * size)
    np.testing.assert_allclose(found.x, after.x, atol=1e-11 * size)
    np.testing.assert_allclose(found.largest, after.largest, atol=1e-11 * size)
    np.testing.assert_allclose(found.lag, after.lag, atol=1e-8 * size)
    covariance, wanted = (each.unit @ each.unit.T for each in (found, after))
    np.testing.assert_allclose(covariance, wanted, atol=1e-8 * size**2)


@given(FREE, st.integers(0, 999))
@examples(24)
def test_an_estimate_flies_on_exactly_or_is_left_to_others(model: System, seed: int) -> None:
    """By the matrix exponential; not where a gap is negative on the way, as samples of it show."""
    random, s, size = np.random.default_rng(seed), 0.5, 2 * model.n
    root, differences = random.normal(size=(size + 1, 5)), random.normal(size=(size + 1, 2))
    x = 0.3 * random.normal(size=size)
    filter_ = ImpactFilter(model)
    assume(filter_.members.given.moving.arena is not None)
    state = GaussianState(x, np.zeros(1), root, differences)
    at = np.linspace(0.0, s, 2001)
    gaps = filter_.predict(0.2, state).motion.states(at)[:, : model.n] @ model.W + model.q_r
    assume(abs(gaps.min()) > 1e-6)
    found = filter_.flown(0.2, s, 0.0, state)
    if gaps.min() < 0 and gaps[0].min() > 1e-6:
        assert found is None
        return
    assume(found is not None)
    assert found is not None
    Phi = linalg.expm(s * state_matrix(model))
    scale = 1 + np.abs(Phi).max() * np.abs(root).max()
    np.testing.assert_allclose(found.root[:size], Phi @ root[:size], atol=1e-11 * scale)
    np.testing.assert_allclose(found.root[size:], root[size:])
    np.testing.assert_allclose(
        found.differences[:size], Phi @ differences[:size], atol=1e-10 * scale
    )
    wanted = filter_.predict(0.2, state).state(s)
    np.testing.assert_allclose(found.x, wanted, atol=1e-12 * (1 + np.abs(wanted).max()))


def test_a_gap_that_closes_in_the_last_moments_counts_as_open() -> None:
    """A stamp has an error: the impact may have been a little earlier."""
    model = sample("bouncing_ball").system
    filter_ = ImpactFilter(model)
    state = GaussianState(np.array([0.1, -1.0]), np.zeros(0), np.eye(2), np.zeros((2, 0)))
    falls = (-1 + np.sqrt(1 + 2 * 9.81 * 0.1)) / 9.81
    assert filter_.flown(0.0, falls + 1e-3, 1e-4, state) is None
    assert filter_.flown(0.0, falls + 1e-3, 2e-3, state) is not None


def test_a_gap_that_was_closed_in_the_last_moments_and_is_open_again_was_an_impact() -> None:
    """That may have been missed: others decide it."""
    model = system(np.eye(1), np.zeros((1, 1)), np.eye(1), contacts=[([1.0], 1 - 1e-4, 0.5)])
    filter_ = ImpactFilter(model)
    state = GaussianState(np.array([1.0, 0.0]), np.zeros(0), np.eye(2), np.zeros((2, 0)))
    assert filter_.flown(0.0, np.pi, 0.1, state) is not None
    assert filter_.flown(0.0, np.pi + 0.05, 0.1, state) is None
