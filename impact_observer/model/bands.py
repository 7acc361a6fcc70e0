"""Matrices whose numbers stand near the diagonal, as those of chains and finite elements."""

import numpy as np
from scipy import linalg

from impact_observer.states import Matrix

MANY = 32
"""Coordinates from which on it is worth while to leave out zeros."""
FEW = 16
"""Numbers in a row that are few; diagonals below the main one that make a band."""


def band_of(A: Matrix) -> Matrix | None:
    """The diagonal of ``A``, shape (n, n), and those below it, shape (b + 1, n).

    None where ``A`` is small, or more than ``FEW`` diagonals are not zero.
    """
    n = len(A)
    if n < MANY:
        return None
    # A copy, as scipy 1.11 refuses what must not be written to.
    below = int(linalg.bandwidth(A.copy())[0])
    if below > FEW:
        return None
    band = np.zeros((below + 1, n), order="F")
    for k, row in enumerate(band):
        row[: n - k] = np.diagonal(A, -k)
    return band
