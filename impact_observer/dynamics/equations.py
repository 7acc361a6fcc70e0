# SPDX-License-Identifier: Apache-2.0
"""Equations of motion of a linear phase, ``M du/dt = -C u - K q + f(t)``, ``dq/dt = u``."""

from typing import Protocol

import numpy as np
from scipy import linalg

from impact_observer.model import Forcing
from impact_observer.states import Matrix, Vector


class Equations(Protocol):
    """Equations of motion for a flow: a ``System``, or a system reduced to fewer coordinates.

    ``M`` symmetric positive definite, ``K`` symmetric positive semidefinite, the symmetric part
    of ``C`` positive semidefinite, shape (n, n) each; SI units.
    """

    @property
    def n(self) -> int:
        """Number of coordinates, at least one."""

    @property
    def M(self) -> Matrix:  # noqa: N802
        """Mass matrix."""

    @property
    def C(self) -> Matrix:  # noqa: N802
        """Damping matrix."""

    @property
    def K(self) -> Matrix:  # noqa: N802
        """Stiffness matrix."""

    @property
    def forcing(self) -> Forcing:
        """``f(t)``, on all coordinates of the frame."""


class Factor:
    """``L`` of a positive definite ``M = L L^T``, shape (n, n).

    Raises:
        LinAlgError: ``M`` is not positive definite.
    """

    def __init__(self, M: Matrix) -> None:
        """Factorise ``M``, shape (n, n)."""
        self.lower = np.asfortranarray(np.linalg.cholesky(M))

    def solved(self, B: Matrix) -> Matrix:
        """``L^-1 B``, of shape (n,) or (n, columns) like ``B``."""
        return self._solved(B, trans=0)

    def solved_transposed(self, B: Matrix) -> Matrix:
        """``L^-T B``, of the shape of ``B``."""
        return self._solved(B, trans=1)

    def _solved(self, B: Matrix, trans: int) -> Matrix:
        # Not by an inverse: masses of finite elements are too ill-conditioned for its rounding.
        # Every impact needs these products, and the checks of scipy would cost more than they do.
        if not B.size:
            return B
        return np.asarray(linalg.lapack.dtrtrs(self.lower, B, lower=1, trans=trans)[0])


def state_matrix(system: Equations) -> Matrix:
    """``A`` of ``dx/dt = A x + b(t)``, ``x = (q, u)``, shape (2n, 2n)."""
    n = system.n
    A = np.zeros((2 * n, 2 * n))
    A[:n, n:] = np.eye(n)
    A[n:, :n] = -linalg.solve(system.M, system.K, assume_a="pos")
    A[n:, n:] = -linalg.solve(system.M, system.C, assume_a="pos")
    return A


def balanced(A: Matrix) -> tuple[Matrix, Vector]:
    """The state matrix of ``x unit`` with positions in units of velocity, and ``unit``.

    The entries of the matrix are rates, and the norm is about the fastest rate. So a matrix
    exponential needs no more squarings than the motion has oscillations. Shapes: (2n, 2n), (2n,).
    """
    n = len(A) // 2
    rate = max(np.sqrt(np.linalg.norm(A[n:, :n], 1)), np.linalg.norm(A[n:, n:], 1)) or 1.0
    unit = np.concatenate([np.full(n, rate), np.ones(n)])
    return np.asarray(unit[:, None] * A / unit), unit
