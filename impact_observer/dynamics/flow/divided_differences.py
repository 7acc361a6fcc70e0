"""Divided differences of ``exp(s z)`` that stay accurate where their points coincide.

They are the exact response of a mode to a harmonic, a step or a ramp, resonance included: see
``spectral.py``.
"""

import math
from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

Complex = NDArray[np.complex128]
_Points = tuple[Complex, ...]

_NEAR = 1.0
"""Spread of ``s`` times the points below which a difference is a power series."""
_TERMS = 18
"""Terms of that series: the first one left out is below 1e-16 of the sum."""


def first(a: Complex, b: Complex, s: NDArray[np.float64]) -> Complex:
    """``exp[a, b] = (e^{as} - e^{bs}) / (a - b)``, and ``s e^{as}`` where ``a = b``."""
    swap = a.real > b.real
    low, high = np.where(swap, b, a), np.where(swap, a, b)
    z = (low - high) * s
    small = np.where(z == 0, 1.0, z)
    quotient: Complex = np.where(z == 0, 1.0, np.expm1(small) / small)
    return np.asarray(s * np.exp(high * s) * quotient)


def second(a: Complex, b: Complex, c: Complex, s: NDArray[np.float64]) -> Complex:
    """``exp[a, b, c]``; ``s^2 e^{as} / 2`` where all three coincide."""
    return divided((a, b, c), s)


def divided(points: Sequence[Complex], s: NDArray[np.float64]) -> Complex:
    """``exp[points]``, whatever their order; ``s^k e^{as} / k!`` where all ``k + 1`` coincide.

    Args:
        points: at least two arrays that broadcast with each other.
        s: s, broadcasts with the points.
    """
    if len(points) == 2:
        return first(points[0], points[1], s)
    ordered, distance = _most_distant(points)
    if not distance.any():
        k = len(points) - 1
        return np.asarray(s**k * np.exp(ordered[0] * s) / math.factorial(k))
    far = distance * s > _NEAR
    if not far.any():
        return _series(ordered, s)
    if far.all():
        return _quotient(ordered, s)
    *each, seconds = (np.broadcast_to(part, far.shape) for part in (*ordered, s))
    found = np.empty(far.shape, dtype=np.complex128)
    found[far] = _quotient(tuple(part[far] for part in each), seconds[far])
    found[~far] = _series(tuple(part[~far] for part in each), seconds[~far])
    return found


def _most_distant(points: Sequence[Complex]) -> tuple[_Points, NDArray[np.float64]]:
    """The points, the two most distant first and last, and that distance."""
    together = np.stack(np.broadcast_arrays(*points))
    pairs = list(combinations(range(len(points)), 2))
    distances = np.stack([np.abs(together[i] - together[j]) for i, j in pairs])
    orders = [[i, *(k for k in range(len(points)) if k not in {i, j}), j] for i, j in pairs]
    order = np.moveaxis(np.array(orders)[distances.argmax(axis=0)], -1, 0)
    return tuple(np.take_along_axis(together, order, axis=0)), distances.max(axis=0)


def _quotient(points: _Points, s: NDArray[np.float64]) -> Complex:
    """The recursion, with the largest distance for its divisor."""
    return np.asarray(
        (divided(points[:-1], s) - divided(points[1:], s)) / (points[0] - points[-1])
    )


def _series(points: _Points, s: NDArray[np.float64]) -> Complex:
    """``s^k e^{ms} sum_i h_i / (i+k)!`` about the mean ``m``, ``h_i`` homogeneous symmetric."""
    k = len(points) - 1
    mean = sum(points[1:], points[0]) / len(points)
    parts = [(point - mean) * s for point in points]
    # symmetric[j] is h_i of the first j + 1 parts.
    symmetric = [np.ones_like(parts[0])] * (k + 1)
    factorial = float(math.factorial(k))
    total = symmetric[k] / factorial
    for i in range(1, _TERMS):
        factorial *= i + k
        symmetric[0] = parts[0] * symmetric[0]
        for j in range(1, k + 1):
            symmetric[j] = symmetric[j - 1] + parts[j] * symmetric[j]
        total = total + symmetric[k] / factorial
    return np.asarray(s**k * np.exp(mean * s) * total)
