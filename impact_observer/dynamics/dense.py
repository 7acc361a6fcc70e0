"""Flow by the matrix exponential: for spectra that cannot be split safely."""

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from impact_observer.dynamics.flow import Flow, Motion
from impact_observer.model import System
from impact_observer.states import Matrix, Vector


def state_matrix(system: System) -> Matrix:
    """``A`` of ``dx/dt = A x + b(t)``, ``x = (q, u)``, shape (2n, 2n)."""
    n = system.n
    A = np.zeros((2 * n, 2 * n))
    A[:n, n:] = np.eye(n)
    A[n:, :n] = -linalg.solve(system.M, system.K, assume_a="pos")
    A[n:, n:] = -linalg.solve(system.M, system.C, assume_a="pos")
    return A


class DenseFlow(Flow):
    """The forcing is made a part of the state, ``w = (1, cos, sin)``, and all is one ``expm``."""

    def __init__(self, system: System) -> None:
        """Assemble ``d(x, w)/dt = [[A, B], [0, S]] (x, w)``."""
        forcing, n = system.forcing, system.n
        h = forcing.frequency.size
        augmented = np.zeros((2 * n + 1 + 2 * h,) * 2)
        augmented[: 2 * n, : 2 * n] = state_matrix(system)
        forces = np.vstack([forcing.constant, forcing.cosine, forcing.sine]).T
        augmented[n : 2 * n, 2 * n :] = linalg.solve(system.M, forces, assume_a="pos")
        cosine, sine = 2 * n + 1 + np.arange(h), 2 * n + 1 + h + np.arange(h)
        augmented[cosine, sine] = -forcing.frequency
        augmented[sine, cosine] = forcing.frequency
        self._augmented = augmented
        self._frequency = forcing.frequency

    def start(self, t: float, x: Vector) -> Motion:
        """The motion through ``x`` at ``t``."""
        angle = self._frequency * t
        start = np.concatenate([x, [1.0], np.cos(angle), np.sin(angle)])
        return _DenseMotion(t, self._augmented, start, x.size)


class _DenseMotion(Motion):
    def __init__(self, t: float, augmented: Matrix, start: Vector, size: int) -> None:
        self.t = t
        self._augmented = augmented
        self._start = start
        self._size = size

    def states(self, s: NDArray[np.float64]) -> NDArray[np.float64]:
        propagators = linalg.expm(s[:, None, None] * self._augmented)
        return np.asarray((propagators @ self._start)[:, : self._size])
