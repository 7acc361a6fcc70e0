# SPDX-License-Identifier: Apache-2.0
"""The Lyapunov distance between two solutions."""

import numpy as np
from numpy.typing import NDArray

from impact_observer.model import System
from impact_observer.states import Vector


def distance(system: System, q: NDArray[np.float64], u: NDArray[np.float64]) -> Vector:
    """``V = 1/2 du^T M du + 1/2 dq^T K dq``, J, of differences ``q`` and ``u``, shape (..., n).

    Returns shape (...). ``V`` is a seminorm if ``K`` is singular: zero for rigid-body
    displacements.
    """
    kinetic = np.einsum("...i,...i->...", u @ system.M, u)
    potential = np.einsum("...i,...i->...", q @ system.K, q)
    return np.asarray((kinetic + potential) / 2)
