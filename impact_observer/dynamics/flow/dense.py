"""Flow by the matrix exponential: for spectra that cannot be split safely."""

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from impact_observer.dynamics.flow.angles import Angles
from impact_observer.dynamics.flow.flow import Equations, Flow, Motion, balanced_state_matrix
from impact_observer.states import Matrix, Vector

_STRIDE = 2.0
"""Length of a stride, over the fastest rate's inverse."""
_TERMS = 20
"""Terms of the power series over half a stride: the first one left out is below 1e-18."""


class DenseFlow(Flow):
    """The forcing is made a part of the state, ``w = (1, cos, sin)``, and all is one ``expm``."""

    def __init__(self, system: Equations) -> None:
        """Assemble ``d(x, w)/dt = [[A, B], [0, S]] (x, w)``."""
        forcing, n = system.forcing, system.n
        h = forcing.frequency.size
        A, unit = balanced_state_matrix(system)
        augmented = np.zeros((2 * n + 1 + 2 * h,) * 2)
        augmented[: 2 * n, : 2 * n] = A
        forces = np.vstack([forcing.constant, forcing.cosine, forcing.sine]).T
        acceleration = linalg.solve(system.M, forces, assume_a="pos")
        # A large force alone shall cost no squarings: the units of w are free.
        size = float(np.max(np.abs(acceleration))) / unit[0] or 1.0
        augmented[n : 2 * n, 2 * n :] = acceleration / size
        cosine, sine = 2 * n + 1 + np.arange(h), 2 * n + 1 + h + np.arange(h)
        augmented[cosine, sine] = -forcing.frequency
        augmented[sine, cosine] = forcing.frequency
        self._augmented = augmented
        self._angles = Angles(forcing.frequency)
        self._unit, self._size = unit, size
        self._stride = _STRIDE / float(linalg.norm(augmented, 1))

    def start(self, t: float, x: Vector) -> Motion:
        """The motion through ``x`` at ``t``."""
        angle = np.array(self._angles.at(t))
        w = self._size * np.concatenate([[1.0], np.cos(angle), np.sin(angle)])
        start = np.concatenate([x * self._unit, w])
        return _DenseMotion(t, self._augmented, start, self._unit, self._stride)

    def transition(self, s: float) -> Matrix:
        """``e^{As}``, shape (2n, 2n)."""
        size = self._unit.size
        balanced = linalg.expm(s * self._augmented[:size, :size])
        return np.asarray(balanced * self._unit / self._unit[:, None])


class _DenseMotion(Motion):
    """A matrix exponential leads to the nearest whole stride, a power series on from there."""

    def __init__(
        self, t: float, augmented: Matrix, start: Vector, unit: Vector, stride: float
    ) -> None:
        self.t = t
        self._augmented = augmented
        self._unit = unit
        self._stride = stride
        self._strides = {0.0: start}

    def states(self, s: NDArray[np.float64]) -> NDArray[np.float64]:
        strides, which = np.unique(np.round(s / self._stride), return_inverse=True)
        starts = [self._after(k) for k in strides.tolist()]
        term = np.reshape(starts, (-1, self._augmented.shape[0]))[which]
        rest = (s - strides[which] * self._stride)[:, None]
        found = term
        for k in range(1, _TERMS):
            term = rest / k * (term @ self._augmented.T)
            found = found + term
        return np.asarray(found[:, : self._unit.size] / self._unit)

    def _after(self, strides: float) -> Vector:
        """The state and ``w`` after a whole number of strides."""
        if strides not in self._strides:
            propagator = linalg.expm((strides * self._stride) * self._augmented)
            self._strides[strides] = propagator @ self._strides[0.0]
        return self._strides[strides]
