"""Products with matrices that have few numbers in a row, as those of chains and finite elements.

With many coordinates a full matrix does not stay in a processor's cache, and reading it is what
its product with a vector costs.
"""

from collections.abc import Callable

import numpy as np
from scipy import linalg, sparse

from impact_observer.states import Matrix, Vector

_MANY = 32
"""Coordinates from which on it is worth while to leave out zeros."""
_FEW = 16
"""Numbers in a row that are few; diagonals beside the main one that are."""

Product = Callable[[Vector], Vector]


def product_with(A: Matrix) -> Product:
    """``A x``, shape (n,), as a function of ``x``, shape (n,); ``A`` has shape (n, n)."""
    n = len(A)
    few = n >= _MANY and np.count_nonzero(A) <= _FEW * n
    found: Product = sparse.csr_array(A).dot if few else A.dot
    return found


class Factor:
    """``L`` of a positive definite ``M = L L^T``, which has no more diagonals than ``M``.

    Attributes:
        transposed: ``L^T x`` as a function of ``x``.
    """

    def __init__(self, M: Matrix) -> None:
        """Factorise ``M``, shape (n, n)."""
        n = len(M)
        self._lower, self._band = linalg.cholesky(M, lower=True), None
        self.transposed = product_with(self._lower.T)
        below = int(linalg.bandwidth(self._lower)[0]) if n >= _MANY else n
        if n >= _MANY and below <= _FEW:
            self._band = np.zeros((below + 1, n), order="F")
            for k, row in enumerate(self._band):
                row[: n - k] = np.diagonal(self._lower, -k)

    # LAPACK's routines themselves: on the path of every impact, where checks cost more.

    def solved(self, B: Matrix) -> Matrix:
        """``L^-1 B``, of shape (n,) or (n, columns) like ``B``."""
        if self._band is not None:
            return np.reshape(linalg.lapack.dtbtrs(self._band, B, uplo="L")[0], B.shape)
        return np.asarray(linalg.lapack.dtrtrs(self._lower, B, lower=1)[0])

    def solved_transposed(self, B: Matrix) -> Matrix:
        """``L^-T B``, of the same shape."""
        if self._band is not None:
            found = linalg.lapack.dtbtrs(self._band, B, uplo="L", trans="T")[0]
            return np.reshape(found, B.shape)
        return np.asarray(linalg.lapack.dtrtrs(self._lower, B, lower=1, trans=1)[0])
