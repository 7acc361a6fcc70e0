"""Undamped modes, the slow ones as exact as the fast ones.

A routine of LAPACK finds each ``omega^2`` to about 1e-16 of the largest. Where that is 1e8 times
the smallest, a slow mode would be wrong by a part in 1e8. One step of the refinement of Ogita and
Aishima (Japan J. Indust. Appl. Math. 35, 2018), with products in twice the digits, mends it.
"""

from math import ceil, log2

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from impact_observer.states import Matrix, Vector

_SLICES = 4
"""Parts that a matrix is cut into, so that products of parts are exact."""
_APART = 1e3
"""Least distance of two ``omega^2``, over their coupling, for the coupling to be removed."""
_LARGE = 1e-9
"""A correction whose square is not small against rounding."""

_Double = tuple[Matrix, Matrix]
"""A matrix as a sum of two, the second being the rounding of the first."""


def modes_of(M: Matrix, K: Matrix) -> tuple[Vector, Matrix]:
    """``omega^2``, shape (n,), ascending, and ``M``-orthonormal shapes, shape (n, n)."""
    _, shapes = linalg.eigh(K, M)
    n = len(shapes)
    high, low = _congruence(M, shapes)
    excess = (np.eye(n) - high) - low
    stiffness = congruence(K, shapes)
    squares = np.diag(stiffness) / (1 - np.diag(excess))
    coupling = stiffness + squares * excess
    apart = squares - squares[:, None]
    removable = np.abs(apart) > _APART * np.abs(coupling)
    np.fill_diagonal(removable, val=False)
    turn = np.where(removable, coupling / np.where(removable, apart, 1.0), excess / 2)
    shapes = shapes + shapes @ turn
    if np.max(np.abs(turn)) > _LARGE:  # its square is an error of the lengths
        high, low = _congruence(M, shapes)
        shapes = shapes + shapes @ (((np.eye(n) - high) - low) / 2)
    order = np.argsort(squares)
    return squares[order], shapes[:, order]


def congruence(A: Matrix, X: Matrix) -> Matrix:
    """``X' A X``, in twice the digits: small entries are not lost beside large ones."""
    if not A.any():
        return np.zeros(X.shape)
    high, low = _congruence(A, X)
    return np.asarray(high + low)


def _congruence(A: Matrix, X: Matrix) -> _Double:
    high, low = _product(A, X)
    result, rest = _product(X.T, high)
    return _sum(result, rest + X.T @ low)


def _product(A: Matrix, B: Matrix) -> _Double:
    """``A B`` by products of parts with so few bits that each is exact (Ozaki et al. 2012)."""
    bits = (53 - ceil(log2(A.shape[1] + 1))) // 2
    high, low = np.zeros((len(A), B.shape[1])), np.zeros((len(A), B.shape[1]))
    right = [part.T for part in _parts(B.T, bits)]
    for left in _parts(A, bits):
        for part in right:
            high, rest = _sum(high, left @ part)
            low += rest
    return _sum(high, low)


def _parts(A: Matrix, bits: int) -> list[Matrix]:
    """``A`` as a sum, each part with ``bits`` bits below the largest number of its row."""
    parts = []
    for _ in range(_SLICES):
        _, exponent = np.frexp(np.max(np.abs(A), axis=1, keepdims=True))
        shift = np.ldexp(1.0, exponent + 53 - bits)
        part = (A + shift) - shift
        parts.append(part)
        A = A - part
    return parts


def _sum(a: NDArray[np.float64], b: NDArray[np.float64]) -> _Double:
    """``a + b`` and what it was rounded by (Knuth)."""
    total = a + b
    virtual = total - a
    return total, (a - (total - virtual)) + (b - virtual)
