# SPDX-License-Identifier: Apache-2.0
"""Least squares under constraints that have errors of their own."""

import numpy as np
from scipy import linalg

from impact_observer.states import Matrix, Vector


def constrained_least_squares(A: Matrix, B: Matrix, d: Vector) -> tuple[Vector, Vector, Matrix]:
    """``x`` and the least ``e`` with ``A x + B e = d``.

    Args:
        A: of full column rank, shape (r, k).
        B: shape (r, c).
        d: shape (r,), or (r, any) to solve for each column.

    Returns:
        ``x``, ``e``, and how far each of ``e`` moves ``x``, shape (k, c): a root of the covariance
        of ``x`` where that of ``e`` is one.
    """
    k = A.shape[1]
    Q, R = linalg.qr(A)
    range_of_A, left = Q[:, :k].T, Q[:, k:].T @ B
    e = linalg.lstsq(left, Q[:, k:].T @ d)[0] if left.size else np.zeros(B.shape[1])
    free = linalg.null_space(left) if left.size else np.eye(B.shape[1])
    x = linalg.solve_triangular(R[:k], range_of_A @ (d - B @ e))
    return x, e, linalg.solve_triangular(R[:k], range_of_A @ B @ free) @ free.T


def redundancies(A: Matrix, B: Matrix) -> Vector:
    """Shares of the ``e`` of ``constrained_least_squares`` that no unknown takes up, shape (c,).

    Their sum is the number of degrees of freedom (Foerstner, Reliability analysis of parameter
    estimation in linear models with applications to mensuration problems, 1987).
    """
    Q = linalg.qr(A)[0]
    free = linalg.null_space(Q[:, A.shape[1] :].T @ B)
    return np.asarray(1.0 - np.sum(free**2, axis=1))
