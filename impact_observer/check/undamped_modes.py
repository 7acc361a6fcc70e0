# SPDX-License-Identifier: Apache-2.0
"""The modes of a model without damping and contacts, elastic and rigid."""

from typing import NamedTuple

import numpy as np
from scipy import linalg

from impact_observer.model import System
from impact_observer.states import Matrix, Vector

_RIGID = 1e-12
"""``omega^2`` that counts as zero, relative to the stiffest mode's; as for position jumps."""


class UndampedModes(NamedTuple):
    """Modes of ``K`` and ``M``, orthonormal in ``M``.

    Attributes:
        squares: squared frequencies of the elastic modes, ascending, rad^2/s^2.
        elastic: shapes of the elastic modes, a column each.
        rigid: shapes of the rigid-body modes, a column each, shape (n, r).
    """

    squares: Vector
    elastic: Matrix
    rigid: Matrix

    @classmethod
    def of_system(cls, system: System) -> "UndampedModes":
        """The modes of ``system``."""
        squares, shapes = linalg.eigh(system.K, system.M)
        r = int(np.sum(squares <= _RIGID * max(float(squares[-1]), 0.0)))
        return cls(squares[r:], shapes[:, r:], shapes[:, :r])

    def gap_acceleration(self, system: System) -> Vector:
        """Acceleration of the gaps by constant loads in rigid-body motion, shape (m,), m/s^2."""
        return np.asarray(system.W.T @ self.rigid @ (self.rigid.T @ system.forcing.constant))
