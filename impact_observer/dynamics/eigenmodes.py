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
_ENTRIES = 1 << 22
"""Numbers that are held at once of products of parts."""
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
    parts = _parts(np.vstack([A, B.T]), bits)
    left, right = parts[:, None, : len(A)], parts[None, :, len(A) :].transpose(0, 1, 3, 2)
    high, low = np.empty((len(A), B.shape[1])), np.empty((len(A), B.shape[1]))
    at_once = max(1, _ENTRIES // (_SLICES**2 * len(A)))
    for start in range(0, B.shape[1], at_once):
        columns = slice(start, start + at_once)
        each = (left @ right[..., columns]).reshape(_SLICES**2, len(A), -1)
        high[:, columns], low[:, columns] = _total(each)
    return _sum(high, low)


def _total(terms: NDArray[np.float64]) -> _Double:
    """The sum of an array along its first axis, whose length is a power of two, two by two."""
    low = np.zeros(terms.shape[1:])
    while len(terms) > 1:
        terms, rest = _sum(terms[::2], terms[1::2])
        low += rest.sum(axis=0)
    return terms[0], low


def _parts(A: Matrix, bits: int) -> NDArray[np.float64]:
    """``A`` as a sum, each part with ``bits`` bits below the largest number of its row."""
    parts = np.empty((_SLICES, *A.shape))
    for part in parts:
        _, exponent = np.frexp(np.abs(A).max(axis=1, keepdims=True))
        shift = np.ldexp(1.0, exponent + 53 - bits)
        np.subtract(A + shift, shift, out=part)
        A = A - part
    return parts


def _sum(a: NDArray[np.float64], b: NDArray[np.float64]) -> _Double:
    """``a + b`` and what it was rounded by (Knuth)."""
    total = a + b
    virtual = total - a
    return total, (a - (total - virtual)) + (b - virtual)
