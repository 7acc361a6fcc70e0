"""Splitting of the state into ``n`` real 2 x 2 blocks, where that is safe."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from impact_observer.dynamics.flow.divided_differences import Complex
from impact_observer.dynamics.flow.double_double import product
from impact_observer.dynamics.flow.eigenmodes import congruence, diagonal, modes_of
from impact_observer.dynamics.flow.few import MANY
from impact_observer.dynamics.flow.flow import Equations
from impact_observer.states import Matrix, Vector

_PROPORTIONAL = 1e-12
"""Coupling of modes by damping that counts as rounding, relative to the damping."""
_RIGID = 1e-15
"""``omega^2`` that counts as zero, relative to the stiffest mode's, times n."""
_WORST_CONDITION = 1e3
"""Condition of the modes, in units of energy, beyond which digits would be lost."""
_DEAD = -100.0
"""Its exponential is nothing beside any number that a model can bring about."""


class Rates(NamedTuple):
    """How pairs go on by themselves: eigenvalues ``a +- d``.

    Attributes:
        a: mean of a pair's eigenvalues, shape (n,), 1/s.
        d: half their distance, shape (n,), 1/s.
        oscillates: whether ``d`` is imaginary, shape (n,).
        slow: ``a + d`` of those that do not oscillate, ``a`` of the others, shape (n,).
    """

    a: Vector
    d: Vector
    oscillates: NDArray[np.bool_]
    slow: Vector

    def propagated(self, s: Vector) -> NDArray[np.float64]:
        """``c`` and ``S`` of ``e^{Js} = c + S (J - a)``, shape (2, n, samples)."""
        if (alive := self._alive(s)) is not None:
            found = np.zeros((2, alive.size, s.size))
            found[:, alive] = self._of(alive).propagated(s)
            return found
        a, d, swings = self.a[:, None], self.d[:, None], self.oscillates[:, None]
        found = np.empty((2, self.a.size, s.size))
        decay, angle = np.exp(a * s), d * s
        if swings.all():
            np.multiply(decay, np.cos(angle), out=found[0])
            np.multiply(decay, np.sin(angle), out=found[1])
            found[1] /= d
            return found
        slow = np.exp(self.slow[:, None] * s)
        width = 2 * np.where(swings, 0.0, angle)
        ratio = np.where(width == 0, 1.0, -np.expm1(-width) / np.where(width == 0, 1.0, width))
        found[0] = np.where(swings, decay * np.cos(angle), slow * (1 + np.exp(-width)) / 2)
        found[1] = np.where(swings, decay * s * np.sinc(angle / np.pi), slow * s * ratio)
        return found

    def largest(self, start: Vector, stop: Vector) -> NDArray[np.float64]:
        """Bounds on ``|c|`` and ``|S|`` along intervals, shape (2, n, intervals).

        No eigenvalue has a positive real part, so ``|c| <= e^{as}`` and, with the slow eigenvalue
        for ``a`` where a pair does not oscillate, ``|S| <= e^{as} min(s, 1/d)``.
        """
        if (alive := self._alive(start)) is not None:
            found = np.zeros((2, alive.size, start.size))
            found[:, alive] = self._of(alive).largest(start, stop)
            return found
        found = np.empty((2, self.a.size, start.size))
        np.exp(np.multiply.outer(self.slow, start), out=found[0])
        still = np.divide(1.0, self.d, out=np.full(self.d.shape, np.inf), where=self.d > 0)
        np.multiply(found[0], np.minimum(stop, still[:, None]), out=found[1])
        return found

    def _alive(self, s: Vector) -> NDArray[np.bool_] | None:
        """Which of many pairs have not died away; None where it is not worth while to ask."""
        if self.a.size < MANY or not s.size:
            return None
        alive = self.slow * s.min() > _DEAD
        return None if alive.all() else np.asarray(alive)

    def _of(self, which: NDArray[np.bool_]) -> "Rates":
        """Those of some of the pairs."""
        return Rates(self.a[which], self.d[which], self.oscillates[which], self.slow[which])

    def beside(self, frequency: Vector) -> "Rates":
        """The same pairs and, after them, harmonics, shape (h,), rad/s, as pairs of their own."""
        none, always = np.zeros(frequency.shape), np.ones(frequency.shape, dtype=np.bool_)
        more = (none, frequency, always, none)
        return Rates(*(np.concatenate(both) for both in zip(self, more, strict=True)))


@dataclass(frozen=True, slots=True, eq=False)
class Modes:
    """A splitting of the state into ``n`` pairs with eigenvalues ``a +- d``.

    Attributes:
        T: columns of pair ``k`` at ``2k`` and ``2k + 1``, shape (2n, 2n).
        T_inverse: shape (2n, 2n).
        J: blocks, shape (n, 2, 2), 1/s.
        proportional: whether a pair is a coordinate, to ``M``-orthonormal shapes, and its
            velocity; otherwise it is an eigenvector's two parts, or two real eigenvectors.
        rates: ``a`` and ``d``. Derived.
        deviator: ``J - a``, shape (n, 2, 2), 1/s. Derived.
        shapes: of many proportional pairs, and what gives their coordinates, shape (n, n) each.
            Derived.
    """

    T: Matrix
    T_inverse: Matrix
    J: NDArray[np.float64]
    proportional: bool
    rates: Rates = field(init=False)
    deviator: NDArray[np.float64] = field(init=False)
    shapes: tuple[Matrix, Matrix] | None = field(init=False)

    def __post_init__(self) -> None:
        """Derive the eigenvalues."""
        J = self.J
        a = (J[:, 0, 0] + J[:, 1, 1]) / 2
        deviator = J - a[:, None, None] * np.eye(2)
        d2 = deviator[:, 0, 0] ** 2 + deviator[:, 0, 1] * deviator[:, 1, 0]
        d, oscillates = np.sqrt(np.abs(d2)), d2 < 0
        determinant = J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] * J[:, 1, 0]
        fast = a - np.where(oscillates, 0.0, d)
        # The slow eigenvalue a + d would cancel; the product of both is the determinant.
        slow = np.where(oscillates | (fast == 0), a, determinant / np.where(fast == 0, 1.0, fast))
        object.__setattr__(self, "rates", Rates(a, d, oscillates, slow))
        object.__setattr__(self, "deviator", deviator)
        n, shapes = len(J), None
        if self.proportional and n >= MANY:
            parts = self.T[:n, 0::2], self.T_inverse[0::2, :n]
            shapes = np.ascontiguousarray(parts[0]), np.ascontiguousarray(parts[1])
        object.__setattr__(self, "shapes", shapes)

    def states(self, y: NDArray[np.float64]) -> NDArray[np.float64]:
        """``T y`` of pairs ``y``, shape (n, 2, samples), shape (2n, samples)."""
        n, _, samples = y.shape
        if self.shapes is None:
            return np.asarray(self.T @ y.reshape(2 * n, samples))
        moving = np.flatnonzero(y.any(axis=(1, 2)))  # mostly slow ones, which come first
        k = int(moving[-1]) + 1 if moving.size else 1
        shapes, y = self.shapes[0][:, :k], y[:k]
        if samples == 1:  # a matrix is read faster for one vector and again than for two
            return np.concatenate([shapes @ y[:, 0, 0], shapes @ y[:, 1, 0]])[:, None]
        found = (shapes @ y.reshape(k, 2 * samples)).reshape(n, 2, samples)
        return np.asarray(found.swapaxes(0, 1).reshape(2 * n, samples))

    def pairs(self, x: Vector) -> Matrix:
        """``T^-1 x``, shape (n, 2), of a state (q, u), shape (2n,)."""
        if self.shapes is None:
            return (self.T_inverse @ x).reshape(-1, 2)
        return np.stack([self.shapes[1] @ part for part in x.reshape(2, -1)], axis=1)

    @property
    def eigenvalues(self) -> tuple[Complex, Complex]:
        """Both of each pair, the one with positive imaginary part or the slow one first."""
        a, d, oscillates, slow = self.rates
        imaginary = np.where(oscillates, 1j * d, 0.0)
        one = np.where(oscillates, a + imaginary, slow)
        two = np.where(oscillates, a - imaginary, 2 * a - slow)
        return one, two


def split(system: Equations, shapes: Matrix | None = None) -> Modes | None:
    """Split ``system`` into pairs of modes; None where no splitting is well-conditioned.

    Args:
        system: what is split.
        shapes: of its undamped modes by LAPACK, shape (n, n), if available.
    """
    stiffness, shapes = modes_of(system.M, system.K, shapes)
    rigid = stiffness <= _RIGID * system.n * np.max(np.abs(stiffness))
    stiffness = np.where(rigid, 0.0, stiffness)
    if np.count_nonzero(rigid) > 1:
        # Any basis of the rigid motions will do: the one whose damping is not coupled.
        free = shapes[:, rigid]
        within = free.T @ system.C @ free
        shapes[:, rigid] = free @ linalg.eigh(within + within.T)[1]
    damped = product(system.C, shapes)
    damping = diagonal(shapes, damped, _PROPORTIONAL)
    if damping is not None:
        return _proportional(system, stiffness, damping, shapes)
    return _general(system, stiffness, congruence(shapes, damped), shapes)


def _proportional(system: Equations, stiffness: Vector, damping: Vector, shapes: Matrix) -> Modes:
    """``M``-orthonormal shapes carry their own coordinate and velocity."""
    n = system.n
    J = np.zeros((n, 2, 2))
    J[:, 0, 1] = 1.0
    J[:, 1, 0] = -stiffness
    J[:, 1, 1] = -np.maximum(damping, 0.0)
    T, T_inverse = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, 2 * n))
    T[:n, 0::2] = T[n:, 1::2] = shapes
    T_inverse[0::2, :n] = T_inverse[1::2, n:] = shapes.T @ system.M
    return Modes(T, T_inverse, J, proportional=True)


def _general(
    system: Equations, stiffness: Vector, damping: Matrix, shapes: Matrix
) -> Modes | None:
    """Eigenvectors, complex ones as real and imaginary part, real ones two by two.

    They are sought in ``(omega y, y')`` of the undamped modes ``y``, whose square is the energy,
    the fast modes first: the slow ones then keep their digits.
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
        return None
    T = np.vstack([shapes @ (Y[0::2][::-1] / unit[:, None]), shapes @ Y[1::2][::-1]])
    inverse = linalg.inv(Y)
    back = system.M @ shapes
    T_inverse = np.hstack(
        [(inverse[:, 0::2][:, ::-1] * unit) @ back.T, inverse[:, 1::2][:, ::-1] @ back.T]
    )
    return Modes(T, T_inverse, J, proportional=False)
