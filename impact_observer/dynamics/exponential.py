# SPDX-License-Identifier: Apache-2.0
"""The exponential of a constant matrix, at any time, to the accuracy of floats.

A window has some steps of equal length. From step to step a state moves by powers of
``exp(A step)``; within a step a state is a Taylor polynomial of the time in steps, whose remainder
is below rounding since a step is ``STEP`` of a turn of the fastest rate. Eigenvectors are not
needed, so equal and defective eigenvalues need no care.
"""

import math
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from impact_observer.states import Matrix, Vector, frozen

TERMS = 15
"""Number of terms of a Taylor polynomial: the first omitted one is below 1e-18."""
STEPS = 32
"""Most steps of a window; windows of large matrices have fewer, as each step has a matrix."""
_NUMBERS = 1 << 19
"""Numbers in the matrices of all steps of a window."""
STEP = 2 * np.pi / 16
"""Angle of the fastest rate in a step, rad."""
_FEW = 32
"""Most polynomials whose values at one place are computed one after the other."""
_KEPT = 64
"""Times whose matrices are remembered."""
_STILL = 1.0
"""Length of a step of a motion without any rate, whose Taylor polynomial ends by itself, s."""


class Exponential:
    """``exp(A s)`` for ``dz/dt = A z``.

    Attributes:
        A: shape (N, N), 1/s.
        rate: bound of the magnitudes of the eigenvalues of ``A``, rad/s.
        step: length of a step, s.
        steps: number of steps of a window.
        between: ``matrix``, remembered for the times of steps between samples.
        doubled: ``exp(A sign 2^k step)`` of a sign and k, shape (N, N), remembered.
        terms: ``A^k step^k / k!``, shape (TERMS, N, N).
    """

    def __init__(self, A: Matrix, rate: float) -> None:
        """Prepare the terms.

        Args:
            A: shape (N, N).
            rate: bound of the magnitudes of the eigenvalues of ``A``, rad/s.
        """
        self.A, self.rate = frozen(A), rate
        self.step = _short(STEP / rate) if rate > 0 else _STILL
        self.steps = min(max(_NUMBERS // A.size, 4), STEPS)
        terms = [np.eye(len(A))]
        for k in range(1, TERMS):
            terms.append(terms[-1] @ A * (self.step / k))
        self.terms = frozen(terms)
        self.between = lru_cache(_KEPT)(self.matrix)
        self.doubled = lru_cache(_KEPT)(self._doubled_of)

    @cached_property
    def whole(self) -> Matrix:
        """``exp(A step)``, shape (N, N)."""
        return frozen(self.terms[::-1].sum(axis=0))

    @cached_property
    def powers(self) -> NDArray[np.float64]:
        """``exp(A j step)``, shape (steps + 1, N, N)."""
        powers = [self.terms[0]]
        for _ in range(self.steps):
            powers.append(powers[-1] @ self.whole)
        return frozen(powers)

    def rows(self, R: Matrix) -> Matrix:
        """``R A^k step^k / k!``: Taylor coefficients of ``R z``, shape (TERMS, w, N).

        ``R`` has shape (w, N).
        """
        return np.asarray(R @ self.terms)

    def matrix(self, s: float) -> Matrix:
        """``exp(A s)``, shape (N, N), for ``s`` of any sign, s."""
        steps, rest = divmod(s / self.step, 1.0)
        within = np.tensordot(rest ** np.arange(TERMS), self.terms, axes=1)
        return np.asarray(within @ np.linalg.matrix_power(self.whole, int(steps)))

    def matrices(self, s: Vector) -> NDArray[np.float64]:
        """``exp(A s)`` at many times of any sign, shape (K,), s: shape (K, N, N)."""
        turns = np.trunc(s / self.step)
        within = np.vander(s / self.step - turns, TERMS, increasing=True)
        # by a product that does not depend on the other times, to the bit
        found = np.asarray(np.einsum("kt,tij->kij", within, self.terms))
        for sign in (1, -1):
            left, k = np.maximum(sign * turns, 0).astype(np.int64), 0
            while left.any():
                odd = left % 2 == 1
                if odd.any():
                    found[odd] = found[odd] @ self.doubled(sign, k)
                left, k = left // 2, k + 1
        return found

    def _doubled_of(self, sign: int, k: int) -> Matrix:
        if k:
            half = self.doubled(sign, k - 1)
            return frozen(half @ half)
        return self.whole if sign > 0 else frozen(np.linalg.inv(self.whole))


def _short(number: float) -> float:
    """``number`` rounded down to 20 bits: its multiples are exact."""
    mantissa, exponent = math.frexp(number)
    return math.ldexp(math.floor(mantissa * 2**20), exponent - 20)


def horner(c: list[float], x: float) -> float:
    """The value of the polynomial with coefficients ``c``, from the constant on, at ``x``."""
    total = 0.0
    for each in reversed(c):
        total = total * x + each
    return total


def polynomials(
    c: NDArray[np.float64], x: Vector, which: NDArray[np.intp] | None = None
) -> NDArray[np.float64]:
    """Values of polynomials by Horner's rule, shape (r, samples).

    A value does not depend on the other samples, to the bit.

    Args:
        c: coefficients, from the constant on, shape (TERMS, r, samples or polynomials).
        x: shape (samples,).
        which: the polynomial of each sample, shape (samples,); None where each has its own.
    """
    if x.size == 1 and c.shape[1] <= _FEW:  # the same operations, and far fewer calls
        rows = c[..., 0 if which is None else which[0]].T.tolist()
        return np.array([[horner(row, float(x[0]))] for row in rows])
    value = np.zeros((c.shape[1], x.size))
    for each in c[::-1]:
        value *= x
        value += each if which is None else each.take(which, axis=1)
    return value
