# Copyright 2026 impact_observer developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

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
