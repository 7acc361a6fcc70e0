# SPDX-License-Identifier: Apache-2.0
"""Products that leave out zeros, against those of full matrices."""

import numpy as np
import pytest
from numpy.typing import NDArray

from impact_observer.dynamics.few import Factor, product_with

Array = NDArray[np.float64]
SIZES = pytest.mark.parametrize(
    ("n", "width"), [(1, 0), (3, 1), (31, 1), (32, 0), (40, 1), (60, 5), (60, 30), (60, 59)]
)


def positive(n: int, width: int) -> Array:
    """A positive definite matrix with ``width`` diagonals below the main one."""
    drawn = np.random.default_rng(n + width).normal(size=(n, n))
    differences = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    found = np.where(differences <= width, drawn + drawn.T, 0.0)
    return np.asarray(found + 10.0 * (width + 1) * np.eye(n))


@SIZES
def test_a_product_is_that_of_the_full_matrix(n: int, width: int) -> None:
    """Rows without symmetry, too."""
    rng = np.random.default_rng(n)
    A, x = positive(n, width) * rng.normal(size=(n, n)), rng.normal(size=n)
    np.testing.assert_allclose(product_with(A)(x), A @ x, atol=1e-13 * np.abs(A).max())


@SIZES
@pytest.mark.parametrize("columns", [None, 1, 3])
def test_a_factor_solves_like_the_full_one(n: int, width: int, columns: int | None) -> None:
    """Vectors stay vectors, and what is given stays as it was."""
    M = positive(n, width)
    factor, full = Factor(M), np.linalg.cholesky(M)
    B = np.random.default_rng(n).normal(size=n if columns is None else (n, columns))
    given = B.copy()
    np.testing.assert_allclose(factor.solved(B), np.linalg.solve(full, B), atol=1e-13)
    back = factor.solved_transposed(B)
    np.testing.assert_allclose(back, np.linalg.solve(full.T, B), atol=1e-13)
    np.testing.assert_array_equal(B, given)
    if columns is None:
        np.testing.assert_allclose(factor.transposed(B), full.T @ B, atol=1e-12)
