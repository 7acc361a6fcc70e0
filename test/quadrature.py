# SPDX-License-Identifier: Apache-2.0
"""Gauss-Legendre quadrature over successive intervals."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)
"""On [-1, 1]."""


def integral(values: Array, ends: Array) -> Array:
    """Integrals over the intervals between ``ends`` (s), shape (intervals, k).

    Args:
        values: at the ``NODES`` of every interval, shape (intervals * nodes, k).
        ends: ascending, shape (intervals + 1,).
    """
    pieces = values.reshape(ends.size - 1, NODES.size, -1)
    return np.asarray(np.einsum("g,pgi,p->pi", WEIGHTS, pieces, np.diff(ends) / 2))
