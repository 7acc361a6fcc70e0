# SPDX-License-Identifier: Apache-2.0
"""The scales of the motions of a system: its modes and its fastest rate."""

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from impact_observer.dynamics.equations import Equations
from impact_observer.states import Matrix, Vector

_PERIODS = 2.0
"""Length of a search window in periods of the fastest rate."""
_STILL = 16.0
"""Length of a search window of a system without oscillation, s."""


@dataclass(frozen=True, slots=True, eq=False)
class Scales:
    """Scales of ``M du/dt = -C u - K q + f(t)``.

    Attributes:
        squares: ``omega^2`` of the undamped modes, ascending, shape (n,), 1/s2.
        shapes: shapes of the undamped modes, M-orthonormal, one a column, shape (n, n).
        modes: ``M shapes``: amplitudes of the modes are ``q @ modes``.
        spread: magnitudes of ``shapes``, one mode a row, shape (n, n).
        fastest: the fastest mode or wave of the forcing, rad/s; 0 without oscillation.
        timescale: the inverse of the fastest rate, at most 1 s.
    """

    squares: Vector
    shapes: Matrix
    modes: Matrix
    spread: Matrix
    fastest: float
    timescale: float

    @classmethod
    def of_equations(cls, equations: Equations) -> "Scales":
        """The scales of ``equations``."""
        squares, shapes = linalg.eigh(equations.K, equations.M)
        spread = np.ascontiguousarray(np.abs(shapes).T)
        fastest = max(float(np.sqrt(max(squares[-1], 0.0))), equations.forcing.fastest)
        timescale = 1.0 / max(fastest, 1.0)
        return cls(squares, shapes, equations.M @ shapes, spread, fastest, timescale)

    @property
    def window(self) -> float:
        """Length of a search window, s.

        Held contacts only make modes slower, so the window serves for all phases of a system.
        """
        return _PERIODS * 2 * np.pi / self.fastest if self.fastest > 0 else _STILL

    def sizes(self, x: Vector, s: float = 0.0) -> Vector:
        """Scale of the rounding errors of (q, u): the largest values that all modes can give.

        The time since the start of a phase has a relative rounding error of up to half of ``eps``.
        Each mode moves on during this error.

        Args:
            x: state (q, u), shape (2n,).
            s: seconds since the start of the phase.

        Returns:
            Shape (2n,), not negative.
        """
        q, u = np.abs(x.reshape(2, -1) @ self.modes)
        q_late, u_late = s / 2 * u, s / 2 * np.maximum(self.squares, 0.0) * q
        largest = np.stack([q + self.timescale * u + q_late, u + u_late])
        return np.asarray((largest @ self.spread).ravel())

    def reach(self, q: Matrix, u: Matrix) -> Matrix:
        """Largest amplitude that each mode may have within the time scale, not negative.

        Args:
            q: positions, shape (..., n).
            u: velocities, shape (..., n).
        """
        return np.asarray(np.abs(q @ self.modes) + np.abs(u @ self.modes) * self.timescale)
