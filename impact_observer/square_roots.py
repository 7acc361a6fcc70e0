# SPDX-License-Identifier: Apache-2.0
"""Square roots of covariances, whose columns are independent errors."""

import numpy as np
from numpy.typing import NDArray


def triangular(wide: NDArray[np.float64]) -> NDArray[np.float64]:
    """Square roots, shape (..., N, N), of ``wide wide^T``, shape (..., N, any).

    Roots with fewer columns than rows get columns of zeros.
    """
    N, columns = wide.shape[-2:]
    if columns < N:
        return np.concatenate([wide, np.zeros((*wide.shape[:-1], N - columns))], axis=-1)
    upper = np.linalg.qr(np.swapaxes(wide, -1, -2), mode="r")
    return np.ascontiguousarray(np.swapaxes(upper, -1, -2))


def lengths_of(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Euclidean norms along the last axis."""
    return np.asarray(np.sqrt(np.einsum("...k,...k->...", rows, rows)))
