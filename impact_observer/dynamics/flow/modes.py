# SPDX-License-Identifier: Apache-2.0
"""Splitting of the state into ``n`` real 2 x 2 blocks, if well-conditioned."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from impact_observer.dynamics.flow.eigenmodes import congruence, diagonal, modes_of
from impact_observer.dynamics.flow.equations import Equations
from impact_observer.dynamics.flow.reduced_coordinates import PhaseFrame
from impact_observer.kernel import product
from impact_observer.states import Matrix, Vector

Complex = NDArray[np.complex128]

_PROPORTIONAL = 1e-12
"""Coupling of modes by damping that counts as rounding, relative to the damping."""
_RIGID = 1e-15
"""``omega^2`` that counts as zero, relative to the stiffest mode's, times n."""
_WORST_CONDITION = 1e3
"""Condition of the modes, in units of energy, beyond which digits would be lost."""


@dataclass(frozen=True, eq=False)
class Modes:
    """A splitting of the state into ``n`` pairs with eigenvalues ``a +- d``, or no splitting.

    Attributes:
        T: columns of block ``k`` one after the other; a pair has columns ``2k`` and ``2k + 1``,
            shape (2n, 2n). If ``proportional``, the shapes, (n, n).
        T_inverse: the inverse of ``T``.
        J: blocks, shape (n, 2, 2), 1/s; one block, shape (1, 2n, 2n), in units of energy, if no
            splitting is well-conditioned.
        proportional: whether a pair is the amplitude and velocity of an ``M``-orthonormal shape;
            otherwise a pair is the two parts of an eigenvector, or two real eigenvectors.
    """

    T: Matrix
    T_inverse: Matrix
    J: NDArray[np.float64]
    proportional: bool

    @property
    def are_pairs(self) -> bool:
        """Whether the state is split."""
        return self.proportional or 2 * len(self.J) == len(self.T)

    @cached_property
    def rates(self) -> tuple[Matrix, NDArray[np.bool_]]:
        """The eigenvalues ``a +- d`` of the pairs, 1/s.

        Returns:
            ``a``, ``d`` and the slow eigenvalue, shape (n, 3), then whether each pair oscillates,
            shape (n,). The slow eigenvalue is ``a + d``, or ``a`` of a pair that oscillates. ``d``
            is imaginary if the pair oscillates.
        """
        J = self.J
        a = (J[:, 0, 0] + J[:, 1, 1]) / 2
        d2 = (J[:, 0, 0] - a) ** 2 + J[:, 0, 1] * J[:, 1, 0]
        d, oscillates = np.sqrt(np.abs(d2)), d2 < 0
        determinant = J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] * J[:, 1, 0]
        fast = a - np.where(oscillates, 0.0, d)
        # a + d would cancel; the product of both eigenvalues is the determinant.
        slow = np.where(oscillates | (fast == 0), a, determinant / np.where(fast == 0, 1.0, fast))
        return np.stack([a, d, slow], axis=1), oscillates

    @property
    def fastest(self) -> float:
        """Bound on ``|J^k|^(1/k)`` in units of energy, 1/s."""
        if not self.are_pairs:
            return float(np.linalg.norm(self.J[0], 2))
        return float(np.max(np.abs(self.eigenvalues), initial=0.0))

    def coordinates(
        self, frame: PhaseFrame | None
    ) -> tuple[Matrix, Matrix, Matrix, Matrix, Vector, bool]:
        """The arguments of the kernel: ``T``, inverse or shapes, and the ``frame``."""
        T, T_inverse = self.T, self.T_inverse
        if frame is None:
            none = np.zeros((0, 0))
            return T, T_inverse, none, none, np.zeros(0), self.proportional
        halves = 1 if self.proportional else 2
        shapes = np.vstack([frame.free.all(part.T).T for part in np.split(T, halves)])
        inverse = [part @ frame.inverse for part in np.split(T_inverse, halves, axis=1)]
        return shapes, np.hstack(inverse), frame.held, frame.Q, frame.rest, self.proportional

    @property
    def energy(self) -> Matrix:
        """Twice the energy of unit values of pairs, shape (n, 2), up to the condition."""
        values = np.ones((len(self.J), 2))
        if self.proportional:
            values[:, 0] = -self.J[:, 1, 0]
        return values

    def pushed(self, acceleration: Matrix) -> NDArray[np.float64]:
        """Loads of the pairs, shape (n, 2, k), under accelerations, shape (n, k)."""
        n, k = acceleration.shape
        if not self.proportional:
            return np.reshape(self.T_inverse[:, n:] @ acceleration, (n, 2, k))
        values = np.zeros((n, 2, k))
        values[:, 1] = self.T_inverse @ acceleration
        return values

    def seen(self, rows: Matrix, sizes: Matrix) -> tuple[Matrix, Matrix]:
        """``rows`` of states as rows of pairs, ``rows T``, and ``sizes`` as ``sizes |T|``.

        Shape (w, 2n) each.
        """
        T, reach, w, n = self.T, np.abs(self.T), len(rows), len(self.J)
        if not self.proportional:
            return rows @ T, sizes @ reach
        parts = [A.reshape(2 * w, n) @ B for A, B in ((rows, T), (sizes, reach))]
        one, two = (part.reshape(w, 2, n).swapaxes(1, 2).reshape(w, 2 * n) for part in parts)
        return one, two

    @cached_property
    def eigenvalues(self) -> tuple[Complex, Complex]:
        """Both eigenvalues of each pair: positive imaginary part, or the slow one, first."""
        rates, oscillates = self.rates
        a, d, slow = rates.T
        imaginary = np.where(oscillates, 1j * d, 0.0)
        return slow + imaginary, np.where(oscillates, a, 2 * a - slow) - imaginary


def split(system: Equations, shapes: Matrix | None = None) -> Modes:
    """Split ``system`` into pairs of modes, if well-conditioned.

    Args:
        system: the equations of motion.
        shapes: shapes of the undamped modes by LAPACK, shape (n, n), if available.
    """
    if not system.n:
        return Modes(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((0, 2, 2)), proportional=True)
    stiffness, shapes = modes_of(system.M, system.K, shapes)
    rigid = stiffness <= _RIGID * system.n * np.max(np.abs(stiffness))
    stiffness = np.where(rigid, 0.0, stiffness)
    if np.count_nonzero(rigid) > 1:
        # Any basis of the rigid motions is valid. Damping does not couple this basis.
        free = shapes[:, rigid]
        within = free.T @ system.C @ free
        shapes[:, rigid] = free @ linalg.eigh(within + within.T)[1]
    damped = product(system.C, shapes)
    damping = diagonal(shapes, damped, _PROPORTIONAL)
    if damping is not None:
        return _proportional(system, stiffness, damping, shapes)
    return _general(system, stiffness, congruence(shapes, damped), shapes)


def _proportional(system: Equations, stiffness: Vector, damping: Vector, shapes: Matrix) -> Modes:
    """The modes of proportional damping: ``M``-orthonormal ``shapes``."""
    n = system.n
    J = np.zeros((n, 2, 2))
    J[:, 0, 1] = 1.0
    J[:, 1, 0] = -stiffness
    J[:, 1, 1] = -np.maximum(damping, 0.0)
    return Modes(shapes, shapes.T @ system.M, J, proportional=True)


def _general(system: Equations, stiffness: Vector, damping: Matrix, shapes: Matrix) -> Modes:
    """The modes of general damping: real and imaginary parts, or two real eigenvectors.

    The eigenvectors are computed in ``(omega y, y')`` of the undamped modes ``y``, whose square is
    the energy. Fast modes come first, so that slow modes keep their digits.
    """
    n = system.n
    omega = np.sqrt(stiffness)
    # A rigid mode has no energy; any rate of the system serves as its unit.
    rates = omega[omega > 0]
    unit = np.where(omega > 0, omega, rates[0] if rates.size else np.max(np.abs(damping)))
    A = np.zeros((2 * n, 2 * n))
    A[0::2, 1::2] = np.diag(unit[::-1])
    A[1::2, 0::2] = -np.diag((stiffness / unit)[::-1])
    A[1::2, 1::2] = -damping[::-1, ::-1]
    values, vectors = linalg.eig(A)
    upper = np.flatnonzero(values.imag > 0)
    real = np.flatnonzero(values.imag == 0)
    real = real[np.argsort(values[real].real)]
    J, Y = np.zeros((n, 2, 2)), np.zeros((2 * n, 2 * n))
    for k, i in enumerate(upper):
        a, b = values[i].real, values[i].imag
        J[k] = [[a, b], [-b, a]]
        Y[:, 2 * k], Y[:, 2 * k + 1] = vectors[:, i].real, vectors[:, i].imag
    for k, (i, j) in enumerate(zip(real[0::2], real[1::2], strict=True), start=upper.size):
        J[k] = np.diag([values[i].real, values[j].real])
        Y[:, 2 * k], Y[:, 2 * k + 1] = vectors[:, i].real, vectors[:, j].real
    if not np.linalg.cond(Y / np.linalg.norm(Y, axis=0)) < _WORST_CONDITION:
        Y, J = np.eye(2 * n), A[None]
    T = np.vstack([shapes @ (Y[0::2][::-1] / unit[:, None]), shapes @ Y[1::2][::-1]])
    inverse = linalg.inv(Y)
    back = system.M @ shapes
    T_inverse = np.hstack(
        [(inverse[:, 0::2][:, ::-1] * unit) @ back.T, inverse[:, 1::2][:, ::-1] @ back.T]
    )
    return Modes(T, T_inverse, J, proportional=False)
