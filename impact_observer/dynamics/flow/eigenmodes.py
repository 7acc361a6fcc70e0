# SPDX-License-Identifier: Apache-2.0
"""Undamped modes; slow modes are as exact as fast modes.

LAPACK finds each ``omega^2`` to about 1e-16 of the largest ``omega^2``. If the largest is 1e8
times the smallest, the smallest has a relative error of 1e-8. One step of the refinement of Ogita
and Aishima (Japan J. Indust. Appl. Math. 35, 2018) corrects the slow modes. The step needs ``M x``
and ``K x`` of shapes ``x`` in twice the digits (``kernel/doubled.hpp``), because
``K x - omega^2 M x`` cancels. This difference is small, so products with the difference need only
the usual digits.
"""

import numpy as np
from scipy import linalg

from impact_observer.kernel import difference, dots, product
from impact_observer.states import Matrix, Vector

Double = tuple[Matrix, Matrix]
"""Numbers in twice the digits: sums of two arrays of the same shape."""
_SEPARATION = 1e3
"""Least distance of two ``omega^2``, over their coupling, for the coupling to be removed."""
_LARGE = 1e-9
"""Largest correction whose square is small against rounding."""


def modes_of(M: Matrix, K: Matrix, shapes: Matrix | None = None) -> tuple[Vector, Matrix]:
    """``omega^2``, shape (n,), ascending, and ``M``-orthonormal shapes, shape (n, n).

    Args:
        M: shape (n, n).
        K: shape (n, n).
        shapes: shapes of the modes by LAPACK, if available.
    """
    if shapes is None:
        _, shapes = linalg.eigh(K, M)
    inertia, force = product(M, shapes), product(K, shapes)
    excess = _excess(shapes, inertia)
    squares = np.add(*dots(shapes, force))[0] / (1 - np.diag(excess))
    coupling = shapes.T @ difference(force, inertia, squares)
    differences = squares - squares[:, None]
    removable = np.abs(differences) > _SEPARATION * np.abs(coupling)
    np.fill_diagonal(removable, val=False)
    turn = np.where(removable, coupling / np.where(removable, differences, 1.0), excess / 2)
    shapes = shapes + shapes @ turn
    if np.max(np.abs(turn)) > _LARGE:  # the square of turn is an error of the lengths
        shapes = shapes + shapes @ (_excess(shapes, product(M, shapes)) / 2)
    order = np.argsort(squares)
    return squares[order], shapes[:, order]


def _excess(shapes: Matrix, inertia: Double) -> Matrix:
    """``I - X' M X``, shape (n, n), of shapes ``X`` and of ``M X``."""
    excess: Matrix = -(shapes.T @ inertia[0])
    high, low = dots(shapes, inertia)
    np.fill_diagonal(excess, (1.0 - high) - low)
    return excess


def congruence(X: Matrix, seen: Double) -> Matrix:
    """``X' A X`` for ``seen = A X`` in twice the digits, so that small entries are exact."""
    high, low = product(X.T, seen[0])
    return np.asarray(high + (low + X.T @ seen[1]))


def diagonal(X: Matrix, seen: Double, within: float) -> Vector | None:
    """The diagonal of ``X' A X``, shape (n,), in twice the digits.

    Returns None if another entry is larger than ``within``.

    Args:
        X: shape (n, n).
        seen: ``A X``, shape (n, n).
        within: largest size of the other entries, relative to the largest entry.
    """
    values, entries = np.add(*dots(X, seen))[0], np.abs(X.T @ seen[0])
    np.fill_diagonal(entries, 0.0)
    others = float(entries.max())
    return values if others <= within * max(others, float(np.abs(values).max())) else None
