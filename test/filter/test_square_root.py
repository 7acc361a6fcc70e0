# SPDX-License-Identifier: Apache-2.0
"""Square roots of covariances, and the Kalman correction by them."""

import numpy as np
import pytest
from numpy.typing import NDArray

from impact_observer.filter.square_root import correction, innovation_root, product, triangular

Array = NDArray[np.float64]


def random_root(seed: int, d: int) -> Array:
    """A root of some covariance."""
    return np.random.default_rng(seed).normal(size=(d, d))


@pytest.mark.parametrize("columns", [2, 5, 9])
def test_triangular_root_is_of_the_same_covariance(columns: int) -> None:
    """Fewer columns than rows, as many, more."""
    root = np.random.default_rng(1).normal(size=(5, columns))
    found = triangular(root)
    np.testing.assert_allclose(found @ found.T, root @ root.T, atol=1e-13)
    np.testing.assert_array_equal(found, np.tril(found))
    assert found.shape == (5, 5)


@pytest.mark.parametrize("k", [1, 3])
def test_correction_is_that_of_the_kalman_filter(k: int) -> None:
    """Gain, innovation and covariance by the formulas in P, well-conditioned here."""
    root, noise = random_root(2, 5), 0.3 * random_root(3, k)
    H = np.random.default_rng(4).normal(size=(k, 5))
    P, R = root @ root.T, noise @ noise.T
    expected = H @ P @ H.T + R
    K = np.linalg.solve(expected, H @ P).T
    found = correction(root, H, noise)
    np.testing.assert_allclose(found.change(np.eye(k)), K, atol=1e-12)
    np.testing.assert_allclose(found.innovation @ found.innovation.T, expected, atol=1e-12)
    alone = innovation_root(root, H, noise)
    np.testing.assert_allclose(alone @ alone.T, expected, atol=1e-12)
    np.testing.assert_allclose(found.root @ found.root.T, P - K @ H @ P, atol=1e-12)


def test_correction_keeps_digits_where_variances_differ_by_eighteen_decades() -> None:
    """One number equal to another within 1e-9: the sum of both is measured, exactly but for 1e-12.

    By hand, with a = 1 and b = 1e-9: the variance left of either is b^2 + r^2, r = 1e-12.
    """
    root, noise = np.diag([1.0, 1e-9]), np.array([[1e-12]])
    found = correction(root, np.array([[1.0, 1.0]]), noise).root
    for row in found:
        assert np.linalg.norm(row) == pytest.approx(1e-9, rel=1e-6)
    assert np.linalg.norm(found.sum(axis=0)) == pytest.approx(1e-12, rel=1e-3)


def test_measurement_of_an_exact_state_changes_nothing() -> None:
    """No covariance, hardly any noise: gain zero, and no NaN."""
    found = correction(np.zeros((2, 2)), np.array([[1.0, 2.0]]), np.array([[1e-150]]))
    assert not found.gain.any()
    assert not found.root.any()


def test_product_has_the_moments_of_normal_numbers() -> None:
    """``e D x + 1/2 E e^2`` by Isserlis' theorem, written in covariances."""
    rng = np.random.default_rng(5)
    root = np.vstack([[0.7, 0, 0, 0], rng.normal(size=(3, 4))])
    D, E = rng.normal(size=(2, 3)), rng.normal(size=2)
    P = root @ root.T
    forms = []
    for row, second in zip(D, E, strict=True):
        A = np.zeros((4, 4))
        A[0, 1:] = A[1:, 0] = row / 2
        A[0, 0] = second / 2
        forms.append(A)
    mean, noise = product(root, D, E)
    np.testing.assert_allclose(mean, [np.trace(A @ P) for A in forms], atol=1e-13)
    expected = [[2 * np.trace(A @ P @ B @ P) for B in forms] for A in forms]
    np.testing.assert_allclose(noise @ noise.T, expected, atol=1e-12)
