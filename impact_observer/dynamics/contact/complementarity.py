# SPDX-License-Identifier: Apache-2.0
"""Linear complementarity in a Delassus matrix ``G = B^T B``: the mathematics of all contacts.

``0 <= G Lambda + b  _|_  Lambda >= 0`` says that ``B Lambda`` is the least vector ``v`` with
``B^T v >= -b``: it has a solution unless there is no such vector. Lawson and Hanson (Solving Least
Squares Problems, chapter 23) turn that into nonnegative least squares, which scipy solves.
Columns of ``B`` that depend on each other are no special case.
"""

from collections.abc import Iterator

import numpy as np
import scipy
from scipy import linalg

from impact_observer.states import Matrix, Vector

_RESIDUAL = 1e-9
"""Violation of complementarity that is rounding, relative to the most negative ``b``."""


def complementary(B: Matrix, b: Vector) -> Vector | None:
    """``Lambda >= 0`` with ``B^T B Lambda + b >= 0``, one of the two zero in each row.

    Args:
        B: a column a contact, none zero, shape (n, m).
        b: shape (m,).

    Returns:
        Shape (m,); None without a solution. The residual of the solution is checked.
    """
    length = np.linalg.norm(B, axis=0)
    scale = float(np.max(-b / length, initial=0.0))
    if scale <= np.finfo(np.float64).tiny / _RESIDUAL:
        return np.zeros(b.size)
    B, b = B / length, b / (length * scale)
    for impulses in _candidates(B, b):
        separation = B.T @ (B @ impulses) + b
        # Both are nonnegative, and one of the two is zero.
        if np.all(np.abs(np.minimum(impulses, separation)) <= _RESIDUAL):
            return np.asarray(np.maximum(impulses, 0.0) * (scale / length))
    return None


def _candidates(B: Matrix, b: Vector) -> Iterator[Vector]:
    """Candidates for the solution, the most accurate first; one is right if a solution exists.

    Where ``b = -B^T v`` for some ``v`` (contacts independent, or with a common restitution) the
    problem is the optimality condition of ``min |B Lambda - v|``. Otherwise, with ``y >= 0`` the
    least squares solution of ``[B; -b^T] y = (0, ..., 0, 1)``, it is solved by
    ``y / (1 + b^T y)``.
    """
    towards = np.asarray(linalg.lstsq(B.T, -b)[0])
    y = nonnegative(B, towards)
    if y is not None:
        yield _refined(B, b, y)
        yield y
    y = nonnegative(np.vstack([B, -b]), np.append(np.zeros(B.shape[0]), 1.0))
    if y is not None:
        yield _refined(B, b, y)
        if (residual := 1.0 + b @ y) > 0:
            yield y / residual


def nonnegative(A: Matrix, target: Vector) -> Vector | None:
    """The least squares solution ``y >= 0`` of ``A y = target``; None where the method cycles."""
    if A.shape[1] == 1:  # nearly always
        column = A[:, 0]
        size = column.dot(column)
        return np.array([max(column.dot(target) / size, 0.0) if size > 0 else 0.0])
    try:
        return np.asarray(scipy.optimize.nnls(A, target)[0])
    except RuntimeError:
        return None


def _refined(B: Matrix, b: Vector, y: Vector) -> Vector:
    """The solution from the equations of those rows that are pressed in ``y``."""
    pressed = y > 0
    refined = np.zeros(b.size)
    refined[pressed] = linalg.lstsq(B[:, pressed].T @ B[:, pressed], -b[pressed])[0]
    return refined
