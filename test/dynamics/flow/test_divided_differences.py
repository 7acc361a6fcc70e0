"""Divided differences of the exponential, for distinct, close and equal points."""

import math

import numpy as np
import precise
import pytest
from hypothesis import given
from hypothesis import strategies as st
from systems import examples, numbers

from impact_observer.dynamics.flow.divided_differences import divided, first, second

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
    a, b, c = (np.array([z]) for z in points)
    for s in S:
        at = np.array([s])
        one = precise.divided_difference(points[:2], s)
        two = precise.divided_difference(points, s)
        for found in (first(a, b, at), first(b, a, at)):
            assert abs(found[0] - one) < 2e-15 * s
        for order in ((a, b, c), (c, a, b), (b, c, a), (c, b, a)):
            assert abs(second(*order, at)[0] - two) < 5e-15 * s**2


@examples(50)
@given(st.tuples(*[numbers(-2, 0)] * 3), st.tuples(*[numbers(-4, 4)] * 3), numbers(0, 3))
def test_divided_differences_agree_with_ninety_digits_anywhere(
    real: tuple[float, ...], imaginary: tuple[float, ...], s: float
) -> None:
    """Points on a grid coincide often, in one part or in both."""
    points = [complex(x, y) for x, y in zip(real, imaginary, strict=True)]
    a, b, c = (np.array([z]) for z in points)
    expected = precise.divided_difference(points, s)
    assert abs(second(a, b, c, np.array([s]))[0] - expected) <= 1e-14 * s**2
    expected = precise.divided_difference(points[:2], s)
    assert abs(first(a, b, np.array([s]))[0] - expected) <= 4e-15 * s


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
            found = divided([np.array([z]) for z in order], np.array([s]))[0]
            assert abs(found - expected) < 1e-14 * s**k / math.factorial(k)


def test_divided_differences_of_many_points_are_those_of_each() -> None:
    """Arrays broadcast: one column a triple, one row an instant."""
    a, b, c = (np.array([points[i] for points in POINTS.values()]) for i in range(3))
    together = second(a, b, c, S[:, None])
    assert together.shape == (S.size, len(POINTS))
    for i in range(len(POINTS)):
        alone = second(a[i : i + 1], b[i : i + 1], c[i : i + 1], S)
        np.testing.assert_array_equal(together[:, i], alone)
