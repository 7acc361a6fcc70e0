"""Banded matrices, as those of chains and finite elements."""

import numpy as np
from scipy import linalg

from impact_observer.states import Matrix

MANY = 32
"""Least number of coordinates for which skipping zeros is faster."""
FEW = 16
"""Most entries in a row, or diagonals below the main one, that count as few."""


def band_of(A: Matrix) -> Matrix | None:
    """The diagonal of ``A``, shape (n, n), and those below it, shape (b + 1, n).

    None where ``A`` is small, or more than ``FEW`` diagonals are not zero.
    """
    n = len(A)
    if n < MANY:
        return None
    # A copy, as scipy 1.11 refuses read-only arrays.
    below = int(linalg.bandwidth(A.copy())[0])
    if below > FEW:
        return None
    band = np.zeros((below + 1, n), order="F")
    for k, row in enumerate(band):
        row[: n - k] = np.diagonal(A, -k)
    return band
