# SPDX-License-Identifier: Apache-2.0
"""Products with matrices of few entries in a row: chains and finite elements.

A full matrix of many coordinates does not fit into the cache of a processor. Then the product with
a vector costs the time to read the matrix.
"""

from collections.abc import Callable
from functools import cached_property

import numpy as np
import scipy
from scipy import linalg

from impact_observer.states import Matrix, Vector

Product = Callable[[Vector], Vector]
MANY = 32
"""Least number of coordinates for which skipping zeros is faster."""
_FEW = 16
"""Most entries in a row, or diagonals below the main one, that count as few."""


def product_with(A: Matrix) -> Product:
    """``A x``, shape (n,), as a function of ``x``, shape (n,); ``A`` has shape (n, n)."""
    n = len(A)
    few = n >= MANY and np.count_nonzero(A) <= _FEW * n
    product: Product = scipy.sparse.csr_array(A).dot if few else A.dot
    return product


class Factor:
    """``L`` of a positive definite ``M = L L^T``, which has no more diagonals than ``M``."""

    def __init__(self, M: Matrix) -> None:
        """Factorise ``M``, shape (n, n).

        Raises:
            LinAlgError: ``M`` is not positive definite.
        """
        self._lower, failed = linalg.lapack.dpotrf(M, lower=1)
        if failed:
            raise np.linalg.LinAlgError("not positive definite")
        self._band = _band_of(self._lower)

    @cached_property
    def transposed(self) -> Product:
        """``L^T x`` as a function of ``x``."""
        return product_with(self._lower.T)

    def solution(self, B: Matrix) -> Matrix:
        """``M^-1 B``, of shape (n,) or (n, columns) like ``B``."""
        return self.solved_transposed(self.solved(B))

    def solved(self, B: Matrix) -> Matrix:
        """``L^-1 B``, of shape (n,) or (n, columns) like ``B``."""
        return self._solved(B, trans=0)

    def solved_transposed(self, B: Matrix) -> Matrix:
        """``L^-T B``, of the shape of ``B``."""
        return self._solved(B, trans=1)

    def _solved(self, B: Matrix, trans: int) -> Matrix:
        # Every impact needs these products. The checks of scipy would cost more than the products.
        if not B.size:
            return B
        if self._band is None:
            return np.asarray(linalg.lapack.dtrtrs(self._lower, B, lower=1, trans=trans)[0])
        solution = linalg.lapack.dtbtrs(self._band, B, uplo="L", trans="NT"[trans])[0]
        return np.reshape(solution, B.shape)


def _band_of(A: Matrix) -> Matrix | None:
    """The diagonal of ``A``, shape (n, n), and the diagonals below, shape (b + 1, n).

    Returns None if ``A`` is small, or if more than ``_FEW`` diagonals are not zero.
    """
    n = len(A)
    # A copy, as scipy 1.11 refuses read-only arrays.
    if n < MANY or (below := int(linalg.bandwidth(A.copy())[0])) > _FEW:
        return None
    band = np.zeros((below + 1, n), order="F")
    for k, row in enumerate(band):
        row[: n - k] = np.diagonal(A, -k)
    return band
