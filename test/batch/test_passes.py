# SPDX-License-Identifier: Apache-2.0
"""The passes through linear steps, against dense Gaussian conditioning."""

from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from impact_observer.batch.noise_sizes import NoiseDensity
from impact_observer.batch.passes import (
    Gaussian,
    LinearStep,
    MeasuredRow,
    NoiseSizes,
    backward,
    forward,
)

Array = NDArray[np.float64]
N, D, K = 5, 4, 24
"""Unknowns, numbers of a state, and steps."""


class Dense(NamedTuple):
    """All unknowns as linear functions of independent numbers, and what is measured."""

    means: list[Array]
    roots: list[Array]
    H: Array
    values: Array
    deviation: Array

    def conditioned(self, X: Array, mean: Array) -> tuple[Array, Array]:
        """Mean and covariance of a function ``X`` of the numbers, by the normal equations."""
        S = self.H @ self.H.T + np.diag(self.deviation**2)
        gain = X @ self.H.T @ np.linalg.inv(S)
        return mean - gain @ self.values, X @ X.T - gain @ S @ gain.T

    @property
    def log_density(self) -> float:
        """Logarithm of the density of all that is measured."""
        S = self.H @ self.H.T + np.diag(self.deviation**2)
        square = self.values @ np.linalg.solve(S, self.values)
        return -0.5 * float(square + np.linalg.slogdet(2 * np.pi * S)[1])


def chain(rng: np.random.Generator) -> tuple[Gaussian, list[LinearStep]]:
    """Return a prior and random steps, of which every second is a jump."""
    steps = [
        LinearStep(
            0.6 * rng.normal(size=(D, N)),
            rng.normal(size=D),
            rng.normal(size=(D, 1 if k % 2 else D)),
            is_jump=bool(k % 2),
            rows=[MeasuredRow(rng.normal(size=N), float(rng.normal()), 0.5, bool(k % 3))],
        )
        for k in range(K)
    ]
    return Gaussian(rng.normal(size=N), rng.normal(size=(N, N))), steps


def dense(prior: Gaussian, steps: list[LinearStep], sizes: NoiseSizes) -> Dense:
    """Return the same chain, every noise a number of its own."""
    noises = [step.noise.shape[1] for step in steps]
    X, mean = np.zeros((N, N + sum(noises))), prior.mean.copy()
    X[:, :N] = prior.root
    means, roots, H, values, deviation, first = [mean.copy()], [X.copy()], [], [], [], N
    for step, q in zip(steps, noises, strict=True):
        X[:D], mean[:D] = step.T @ X, step.T @ mean + step.offset
        size = sizes.scatter if step.is_jump else sizes.model
        X[:D, first : first + q] = size * step.noise
        first += q
        means.append(mean.copy())
        roots.append(X.copy())
        for row in step.rows:
            H.append(row.h @ X)
            values.append(row.value + row.h @ mean)
            deviation.append(row.deviation * (sizes.clock if row.is_instant else 1.0))
    return Dense(means, roots, np.array(H), np.array(values), np.array(deviation))


@pytest.mark.parametrize("sizes", [(0.3, 0.2, 0.1), (0.05, 0.0, 0.2), (0.3, 0.0, 0.0)])
@pytest.mark.parametrize("seed", range(3))
def test_nodes_and_neighbours_are_those_of_dense_conditioning(
    seed: int, sizes: tuple[float, float, float]
) -> None:
    """Means, covariances, those of both ends of a step, and the density of all measurements."""
    prior, steps = chain(np.random.default_rng(seed))
    own = NoiseSizes(*sizes)
    oracle, way = dense(prior, steps, own), forward(prior, steps, own)
    found = backward(prior, way)
    for k in range(K + 1):
        mean, covariance = oracle.conditioned(oracle.roots[k], oracle.means[k])
        root = found.nodes.root[k]
        np.testing.assert_allclose(found.nodes.mean[k], mean, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(root @ root.T, covariance, rtol=1e-5, atol=1e-8)
    both = np.vstack([oracle.roots[8], oracle.roots[7]])
    _, covariance = oracle.conditioned(both, np.zeros(2 * N))
    np.testing.assert_allclose(found.joint[7] @ found.joint[7].T, covariance, atol=1e-9)
    assert way.log_density == pytest.approx(oracle.log_density, rel=1e-8)


@pytest.mark.parametrize("sizes", [(0.3, 0.2, 0.1), (0.05, 0.0, 0.2), (0.02, 0.3, 0.0)])
def test_the_density_of_other_sizes_is_that_of_dense_conditioning(
    sizes: tuple[float, float, float],
) -> None:
    """From a pass whose sizes are 2 to 15 times other ones, or have a kind of noise less."""
    prior, steps = chain(np.random.default_rng(4))
    passed = NoiseSizes(0.3, 0.1, 0.0)
    density = NoiseDensity(prior, steps, forward(prior, steps, passed), passed)
    oracle = dense(prior, steps, NoiseSizes(*sizes))
    assert density.log_density(NoiseSizes(*sizes)) == pytest.approx(oracle.log_density, rel=1e-8)


def test_an_exact_measurement_leaves_no_variance_along_its_row() -> None:
    """Without noise of the sensor and of the motion."""
    prior, (step, *_) = chain(np.random.default_rng(1))
    row = MeasuredRow(np.eye(N)[0], 2.0, 0.0)
    steps = [step._replace(rows=[row]), *[step._replace(T=np.eye(D, N), rows=())] * 2]
    found = backward(prior, forward(prior, steps, NoiseSizes(1.0)))
    assert found.nodes.mean[1][0] == pytest.approx(-2.0)
    np.testing.assert_allclose(found.nodes.root[1][0], 0.0, atol=1e-12)


def test_a_motion_that_grows_without_bounds_is_not_finite() -> None:
    """Its errors of the model overflow, though the pass has none and is finite."""
    prior, steps = chain(np.random.default_rng(2))
    grown, sizes = [step._replace(noise=1e200 * step.noise) for step in steps], NoiseSizes(0.3)
    for each, is_finite in ((steps, True), (grown, False)):
        way = forward(prior, each, sizes)
        assert np.isfinite(way.log_density)
        assert NoiseDensity(prior, each, way, sizes).is_finite == is_finite
