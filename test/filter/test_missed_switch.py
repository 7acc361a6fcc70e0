# SPDX-License-Identifier: Apache-2.0
"""Missed impacts: state and covariance after a jump at the own root of the gap."""

import numpy as np
import pytest
from numpy.typing import NDArray
from systems import chain, forcing, sample, system

from impact_observer.events import Kind, Ruling
from impact_observer.filter.branching import Extent
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.filter_bank import FilterBank
from impact_observer.filter.forecast import Dip
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.hypotheses import Hypothesis
from impact_observer.filter.impact_filter import ImpactFilter
from impact_observer.filter.missed_switch import insert_switch
from impact_observer.filter.uncertainty import Uncertainty
from impact_observer.model import System

Array = NDArray[np.float64]


def flown(model: System, now: Array, x: Array, s: Array) -> Array:
    """States (samples, 2n) each ``s`` seconds on from its ``now``: Runge and Kutta, 8 steps."""
    n, inverse, h = model.n, np.linalg.inv(model.M), s / 8

    def rate(at: Array, y: Array) -> Array:
        force = model.forcing.derivatives(at, 0)[0]
        pull = force - y[:, :n] @ model.K.T - y[:, n:] @ model.C.T
        return np.hstack([y[:, n:], pull @ inverse.T])

    step = h[:, None]
    for _ in range(8):
        one = rate(now, x)
        two = rate(now + h / 2, x + step / 2 * one)
        three = rate(now + h / 2, x + step / 2 * two)
        four = rate(now + h, x + step * three)
        x, now = x + step / 6 * (one + 2 * two + 2 * three + four), now + h
    return x


def thrown(model: System, t: float, x: Array, i: int) -> Array:
    """States (samples, 2n) at ``t`` after impacts, each at its own root."""
    n, w, s = model.n, model.W[:, i], np.zeros(len(x))
    now = np.full(len(x), t)
    for _ in range(4):
        y = flown(model, now, x, s)
        s = s - (y[:, :n] @ w + model.q_r[i]) / (y[:, n:] @ w)
    y, push = flown(model, now, x, s), np.linalg.solve(model.M, w)
    y[:, n:] -= np.outer((1 + model.eps[i]) * (y[:, n:] @ w), push / (w @ push))
    return flown(model, now + s, y, -s)


@pytest.mark.parametrize("deviation", [1e-3, 1e-2, 5e-2])
def test_missed_impact_leaves_the_moments_of_nonlinear_jumps(deviation: float) -> None:
    """Of 8000 states that hit at an instant of their own: mean and covariance, to its noise."""
    model, t = sample("two_mass").system, 0.3
    x = np.array([0.1, 0.5, -0.4, 1.6])
    rng = np.random.default_rng(5)
    root = deviation * np.tril(rng.normal(size=(4, 4)) / 4 + np.eye(4))
    filter_ = ImpactFilter(model)
    state = filter_.posterior_of_missed(
        ContactChange(t, (), (0,), ()), GaussianState.of(x[None], root)
    )
    drawn = rng.normal(size=(4000, 4)) @ root.T
    after = thrown(model, t, x + np.vstack([drawn, -drawn]), 0)
    mean, covariance = after.mean(axis=0), np.cov(after.T)
    P = state.root @ state.root.T
    deviations = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose((state.x - mean) / deviations, 0.0, atol=max(0.5 * deviation, 1e-3))
    scaled = (P - covariance) / np.outer(deviations, deviations)
    np.testing.assert_allclose(scaled, 0.0, atol=0.06 + deviation)


def test_missed_impact_that_is_early_jumps_at_its_own_root() -> None:
    """A gap that is not yet zero: the state then is that of a plant that hits a little later."""
    model, t = sample("two_mass").system, 0.3
    x = np.array([0.1, 0.499, -0.4, 1.6])
    state = ImpactFilter(model).posterior_of_missed(
        ContactChange(t, (), (0,), ()),
        GaussianState.of(x[None], 1e-9 * np.eye(4)),
    )
    expected = thrown(model, t, x[None], 0)[0]
    np.testing.assert_allclose(state.x, expected, atol=1e-6)
    np.testing.assert_allclose(state.x[1], 0.499 - 1e-3, atol=2e-2)


@pytest.mark.parametrize("closed", [(), (1,)])
def test_missed_impact_of_a_gap_that_stands_still_has_a_finite_state(
    closed: tuple[int, ...],
) -> None:
    """Neither a speed nor an acceleration tells when: some time constants bound the error.

    Three bodies in a row, of which the one in the middle is pushed; by the kernel, and while
    another contact is closed by the general methods.
    """
    contacts = [([1.0, 0.0, 0.0], 0.0, 0.5), ([0.0, 0.0, 1.0], 0.0, 0.5)]
    push = forcing(3, [0.0, 1.0, 0.0])
    filter_ = ImpactFilter(chain(3, damping=2.0, contacts=contacts, force=push))
    state = filter_.begin(GaussianState.of(np.zeros((1, 6)), 0.1 * np.eye(6), closed))
    after = filter_.posterior_of_missed(ContactChange(1.0, closed, (0,), closed), state)
    assert np.all(np.abs(after.x) < 100.0)
    assert np.all(np.linalg.norm(after.root, axis=1) < 1000.0)


def between_stops() -> tuple[System, GaussianState]:
    """A body between two stops of unlike restitution, which is closed at the first."""
    model = system([[1.0]], [[0.1]], [[4.0]], contacts=[([1], 0.2, 0.6), ([-1], 0.3, 0.5)])
    x = np.array([[-0.2, 1.0]])
    return model, GaussianState.of(x, 0.5 * np.eye(2), (0,))


def test_no_impact_is_inserted_that_the_impact_law_does_not_allow() -> None:
    """Both stops at once."""
    model, state = between_stops()
    dip = Dip(1, Kind.IMPACT, 0, 0.0, 0.0, 0.1, 5.0, -20.0, over=True, began=0.0)
    assert insert_switch(ImpactFilter(model), 0.0, state, dip) is None


def test_hypotheses_in_which_an_event_is_impossible_are_dropped() -> None:
    """Of one that is closed at the other stop it is spurious; the others go on."""
    model, held = between_stops()
    free = GaussianState.of(np.array([[0.3, 1.0]]), 1e-3 * np.eye(2))
    bank = FilterBank(ImpactFilter(model), Uncertainty(model_error=0.0, mislabelled=0.0), (1e-6,))
    change = ContactChange.of(1.0, (), [(1, Kind.IMPACT)])
    hypotheses = [Hypothesis(held, 1e-6, -0.1), Hypothesis(free, 1e-6, -2.3)]
    extent = Extent(np.ones(2), np.ones(2))
    found = bank.update(change, hypotheses, lambda: (), extent)
    rulings = {h.state.closed: h.ledger.notes[-1].ruling for h in found}
    assert rulings[()] is Ruling.APPLIED
    assert rulings.get((0,), Ruling.REJECTED) is Ruling.REJECTED
