# SPDX-License-Identifier: Apache-2.0
"""Products in twice the digits, against fractions."""

from fractions import Fraction

import numpy as np
import pytest
from numpy.typing import NDArray

from impact_observer.kernel import difference, dots, product

Array = NDArray[np.float64]


def exact(A: Array, B: Array) -> list[list[Fraction]]:
    """``A B`` without any rounding."""
    left = [[Fraction(a) for a in row] for row in A.tolist()]
    right = [[Fraction(b) for b in column] for column in B.T.tolist()]
    return [
        [sum((a * b for a, b in zip(row, column, strict=True)), Fraction(0)) for column in right]
        for row in left
    ]


def graded(rng: np.random.Generator, *shape: int) -> Array:
    """Numbers of very different size."""
    return np.asarray(rng.normal(size=shape) * 10.0 ** rng.integers(-4, 5, size=shape))


@pytest.mark.parametrize(("n", "columns"), [(1, 1), (2, 2), (3, 7), (5, 1), (40, 4)])
def test_product_has_twice_the_digits(n: int, columns: int) -> None:
    """Relative to the sum of sizes of the terms."""
    rng = np.random.default_rng(n)
    A, B = graded(rng, n, n), graded(rng, n, columns)
    assert worst(A, B) < 2.0**-95


def worst(A: Array, B: Array) -> float:
    """Largest error of a product, relative to the sizes of its terms."""
    (rounded, rest), sizes = product(A, B), np.abs(A) @ np.abs(B)
    errors = [
        abs(Fraction(high) + Fraction(low) - entry) / (Fraction(size) or 1)
        for highs, lows, row, over in zip(
            rounded.tolist(), rest.tolist(), exact(A, B), sizes.tolist(), strict=True
        )
        for high, low, entry, size in zip(highs, lows, row, over, strict=True)
    ]
    return float(max(errors))


def test_columns_are_multiplied_in_twice_the_digits() -> None:
    """The terms cancel but for their last digits."""
    X = np.array([[1.0, 3.0], [1.0, 1 / 3]])
    Y = np.array([[1.0, 1 / 3], [-1.0, -3.0]]), np.array([[1e-20, 0.0], [0.0, 2e-18]])
    expected = [1e-20, float(Fraction(2e-18) * Fraction(1 / 3))]
    np.testing.assert_allclose(np.add(*dots(X, Y))[0], expected, rtol=1e-14)


def test_difference_of_what_is_nearly_the_same_keeps_its_digits() -> None:
    """``0.1 * 3`` is not ``0.3``."""
    Y, Z = ((np.array([[each]]), np.zeros((1, 1))) for each in (0.3, 0.1))
    expected = float(Fraction(0.3) - 3 * Fraction(0.1))
    assert difference(Y, Z, np.array([3.0]))[0, 0] == expected != 0
