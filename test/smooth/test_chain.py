# SPDX-License-Identifier: Apache-2.0
"""Smoothing of a linear chain: against conditioning on all measurements at once."""

import numpy as np
import pytest
from conditioning import conditioned
from hypothesis import given
from hypothesis import strategies as st
from systems import examples

from impact_observer.errors import DynamicsError
from impact_observer.smooth.chain import Chain, Normal, Step
from impact_observer.smooth.used_samples import measured


def random_chain(rng: np.random.Generator, count: int, exact: float) -> tuple[Normal, list[Step]]:
    """A first state and steps of varying size; some lose directions, some measure nothing."""
    d = int(rng.integers(1, 5))
    first = Normal(rng.normal(size=d), np.tril(rng.normal(size=(d, d))))
    steps = []
    for _ in range(count):
        after, k = int(rng.integers(1, 5)), int(rng.integers(0, 3))
        A = rng.normal(size=(after, d)) / 2
        A[:, rng.integers(d)] *= rng.random() < 0.7  # as a jump without rebound
        noise = rng.normal(size=(after, int(rng.integers(0, 3))))
        H, y = rng.normal(size=(k, after)), rng.normal(size=k)
        steps.append(Step(A, rng.normal(size=after), noise, H, y, exact * np.eye(k)))
        d = after
    return first, steps


@examples(200)
@given(st.integers(0, 10**6), st.integers(1, 12))
def test_states_are_those_of_conditioning_on_all_measurements(seed: int, count: int) -> None:
    """In mean and covariance, with jumps that lose directions; and the evidence is its density."""
    first, steps = random_chain(np.random.default_rng(seed), count, 0.3)
    chain = Chain(first, count, lambda k: steps[k])
    found = dict(chain.states())
    means, covariances, density = conditioned(first, steps)
    for k in range(-1, count):
        np.testing.assert_allclose(found[k].mean, means[k + 1], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(found[k].covariance, covariances[k + 1], rtol=1e-9, atol=1e-9)
    assert chain.evidence == pytest.approx(density, rel=1e-9, abs=1e-9)


@examples(100)
@given(st.integers(0, 10**6))
def test_many_measurements_of_a_state_are_as_good_as_a_few(seed: int) -> None:
    """Their rows are turned into as many as the state has numbers; states and evidence stay."""
    rng = np.random.default_rng(seed)
    d, k = int(rng.integers(1, 5)), int(rng.integers(1, 12))
    first = Normal(rng.normal(size=d), np.tril(rng.normal(size=(d, d))))
    H, y = rng.normal(size=(k, d)), rng.normal(size=k)
    deviations = 10 ** rng.uniform(-2, 1, size=k)
    few = measured(H, y, deviations)
    assert len(few.y) == min(k, d)
    one = Step.unmeasured(np.eye(d), np.zeros(d))
    every = one._replace(H=H, y=y, V=np.diag(deviations))
    chains = [Chain(first, 1, [step].__getitem__) for step in (few, every)]
    (a, b) = (dict(chain.states()) for chain in chains)
    np.testing.assert_allclose(a[0].mean, b[0].mean, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(a[0].covariance, b[0].covariance, rtol=1e-8, atol=1e-9)
    assert chains[0].evidence == pytest.approx(chains[1].evidence, rel=1e-9, abs=1e-7)


@examples(50)
@given(st.integers(0, 10**6), st.integers(1, 12))
def test_later_measurements_never_widen_a_state(seed: int, count: int) -> None:
    """``P_s <= P_f``: the smoothed covariance is below that of the measurements until then."""
    first, steps = random_chain(np.random.default_rng(seed), count, 0.1)
    found = dict(Chain(first, count, lambda k: steps[k]).states())
    for k in range(count):
        filtered = dict(Chain(first, k + 1, lambda i: steps[i]).states())[k]
        less = filtered.covariance - found[k].covariance
        assert np.min(np.linalg.eigvalsh(less)) >= -1e-9 * max(1.0, np.max(np.abs(less)))
    last = dict(Chain(first, count, lambda i: steps[i]).states())[count - 1]
    np.testing.assert_array_equal(found[count - 1].mean, last.mean)


@examples(60)
@given(st.integers(0, 10**6), st.integers(1, 8))
def test_exact_measurements_do_no_harm(seed: int, count: int) -> None:
    """Measurements to 1e-6 of errors of one; against decimal arithmetic.

    The data are those of a motion of the chain.
    """
    rng = np.random.default_rng(seed)
    first, steps = random_chain(rng, count, 1e-6)
    z = first.mean + first.root @ rng.normal(size=first.root.shape[1])
    for k, each in enumerate(steps):
        z = each.A @ z + each.b + each.N @ rng.normal(size=each.N.shape[1])
        steps[k] = each._replace(y=each.H @ z + each.V @ rng.normal(size=len(each.y)))
    found = dict(Chain(first, count, lambda k: steps[k]).states())
    means, covariances, _ = conditioned(first, steps, precise=True)
    for k in range(-1, count):
        np.testing.assert_allclose(found[k].mean, means[k + 1], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(found[k].covariance, covariances[k + 1], rtol=1e-9, atol=1e-9)


def test_innovation_without_variance_is_refused() -> None:
    """The evidence of an exact measurement of an exact state would be infinite."""
    exact = Normal(np.zeros(1), np.zeros((1, 1)))
    still = Step.unmeasured(np.eye(1), np.zeros(1))
    step = still._replace(H=np.eye(1), y=np.ones(1), V=np.zeros((1, 1)))
    with pytest.raises(DynamicsError, match=r"has the variance 0; expected more"):
        list(Chain(exact, 1, [step].__getitem__).states())
