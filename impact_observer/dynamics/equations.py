# SPDX-License-Identifier: Apache-2.0
"""Equations of motion of a linear phase, ``M du/dt = -C u - K q + f(t)``, ``dq/dt = u``."""

from typing import Protocol

import numpy as np
from scipy import linalg

from impact_observer.model import Forcing
from impact_observer.states import Matrix


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
