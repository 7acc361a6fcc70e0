"""Divided differences of the exponential, for distinct, close and equal points."""

import math

import numpy as np
import precise
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from systems import examples, numbers

from impact_observer.kernel import divided

Points = tuple[complex, ...]


def found_at(points: Points, s: float) -> complex:
    """One divided difference."""
    return complex(divided(np.array(points)[:, None], np.array([s]))[0, 0])


S = np.array([1e-9, 1e-3, 0.3, 1.0, 4.0])
POINTS = {
    "differences": (-0.1 + 3j, -0.1 - 3j, 2j),
    "pair meets": (-0.5 + 1e-9j, -0.5 - 1e-9j, 1j),
    "resonance": (1j, -1j, 1j),
    "near resonance": (-1e-8 + 1j, -1e-8 - 1j, 1j * (1 + 1e-12)),
    "all in one": (0j, 0j, 0j),
    "all nearly in one": (-1e-5 + 0j, 1e-5j, -1e-5j),
    "at the border of the series": (-0.05 + 0.1j, -0.05 - 0.1j, 0.1j),
    "just beyond it": (-0.25 + 0.51j, -0.3 - 0.01j, 0.1 + 0j),
    "stiff": (-1e-3 + 0j, -30 + 0j, 2j),
    "free body, slow drive": (0j, 0j, 1e-7j),
}


@pytest.mark.parametrize("points", POINTS.values(), ids=list(POINTS))
def test_divided_differences_agree_with_ninety_digits(
    points: tuple[complex, complex, complex],
) -> None:
    """Every order of the points gives the same number, within rounding."""
    a, b, c = points
    for s in S.tolist():
        one = precise.divided_difference(points[:2], s)
        two = precise.divided_difference(points, s)
        for pair in ((a, b), (b, a)):
            assert abs(found_at(pair, s) - one) < 2e-15 * s
        for order in ((a, b, c), (c, a, b), (b, c, a), (c, b, a)):
            assert abs(found_at(order, s) - two) < 5e-15 * s**2


@examples(50)
@given(st.tuples(*[numbers(-2, 0)] * 3), st.tuples(*[numbers(-4, 4)] * 3), numbers(0, 3))
def test_divided_differences_agree_with_ninety_digits_anywhere(
    real: tuple[float, ...], imaginary: tuple[float, ...], s: float
) -> None:
    """Points on a grid coincide often, in one part or in both."""
    points = tuple(complex(x, y) for x, y in zip(real, imaginary, strict=True))
    expected = precise.divided_difference(points, s)
    assert abs(found_at(points, s) - expected) <= 1e-14 * s**2
    expected = precise.divided_difference(points[:2], s)
    assert abs(found_at(points[:2], s) - expected) <= 4e-15 * s


RAMPS = {
    "oscillating": (-0.1 + 3j, -0.1 - 3j, 0j, 0j),
    "slow": (-1e-6 + 1e-3j, -1e-6 - 1e-3j, 0j, 0j),
    "critical": (-0.5 + 0j, -0.5 + 0j, 0j, 0j),
    "nearly critical": (-0.5 + 1e-9j, -0.5 - 1e-9j, 0j, 0j),
    "overdamped and stiff": (-1e-3 + 0j, -30 + 0j, 0j, 0j),
    "free body": (0j, 0j, 0j, 0j),
    "free body with drag": (0j, -0.7 + 0j, 0j, 0j),
    "at the border of the series": (-0.1 + 1j, -0.1 - 1.01j, 0j, 0j),
    "five points": (-0.1 + 1j, -0.1 - 1j, 0j, 2j, -2j),
    "five points, three in one": (-0.1 + 1j, -0.1 - 1j, 0j, 0j, 0j),
}


@pytest.mark.parametrize("points", RAMPS.values(), ids=list(RAMPS))
def test_divided_differences_of_more_points_agree_with_ninety_digits(
    points: tuple[complex, ...],
) -> None:
    """A ramp on a mode has four points, two of them zero; any order gives the same number."""
    k = len(points) - 1
    for s in S:
        expected = precise.divided_difference(points, s)
        for order in (points, points[::-1], points[1:] + points[:1]):
            found = found_at(order, float(s))
            assert abs(found - expected) < 1e-14 * s**k / math.factorial(k)


def test_divided_differences_of_many_points_are_those_of_each() -> None:
    """One column a triple, one row an instant."""
    points = np.array(list(POINTS.values())).T
    together = divided(points, S)
    assert together.shape == (S.size, len(POINTS))
    for j, triple in enumerate(POINTS.values()):
        for i, s in enumerate(S.tolist()):
            assert together[i, j] == found_at(triple, s)


@pytest.mark.parametrize(
    ("points", "s"),
    [
        (np.zeros((1, 2)), np.ones(1)),
        (np.zeros((9, 2)), np.ones(1)),
        (np.zeros(3), np.ones(1)),
        (np.full((2, 1), np.nan), np.ones(1)),
        (np.zeros((2, 1)), np.array([np.inf])),
        (np.zeros((2, 1)), np.ones((1, 1))),
    ],
)
def test_wrong_arrays_are_refused(points: NDArray[np.complex128], s: NDArray[np.float64]) -> None:
    """Of another shape, or not finite."""
    with pytest.raises(ValueError, match=r"points|s:"):
        divided(points.astype(complex), s)
