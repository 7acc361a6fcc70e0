"""An oracle for exact flows: the power series of the motion in decimal arithmetic.

It shares nothing with the package: no eigenvalues, no matrix exponential, 90 digits.
"""

from collections.abc import Sequence
from decimal import Decimal, localcontext

import numpy as np
from numpy.typing import NDArray

from impact_observer.model import System

_DIGITS = 90
_SMALL = Decimal(10) ** -60

Vector = list[Decimal]
Rows = list[Vector]


def _decimals(values: NDArray[np.float64]) -> Vector:
    return [Decimal(float(value)) for value in values]


def _solve(matrix: Rows, right: Rows) -> Rows:
    """``matrix^-1 right`` by Gauss and Jordan; no pivoting, ``matrix`` is positive definite."""
    rows = [[*left, *others] for left, others in zip(matrix, right, strict=True)]
    n = len(rows)
    for i in range(n):
        rows[i] = [value / rows[i][i] for value in rows[i]]
        for k in range(n):
            if k != i:
                factor = rows[k][i]
                rows[k] = [a - factor * b for a, b in zip(rows[k], rows[i], strict=True)]
    return [row[n:] for row in rows]


def _times(matrix: Rows, vector: Vector) -> Vector:
    return [sum((a * b for a, b in zip(row, vector, strict=True)), Decimal(0)) for row in matrix]


def _series(matrix: Rows, start: Vector, s: Decimal) -> Vector:
    """``exp(s matrix) start``, term by term."""
    total = term = start
    k = 0
    while k < 10 or max(abs(value) for value in term) > _SMALL:
        k += 1
        term = [value * s / k for value in _times(matrix, term)]
        total = [a + b for a, b in zip(total, term, strict=True)]
    return total


def _augmented(system: System) -> Rows:
    """The matrix of ``(q, u, 1, cos w_1 t, sin w_1 t, ...)``."""
    n, forcing = system.n, system.forcing
    columns = [system.K * -1.0, system.C * -1.0, forcing.constant[:, None]]
    for cosine, sine in zip(forcing.cosine, forcing.sine, strict=True):
        columns += [cosine[:, None], sine[:, None]]
    loads = [_decimals(row) for row in np.hstack(columns)]
    accelerations = _solve([_decimals(row) for row in system.M], loads)
    size = len(accelerations[0])
    rows = [[Decimal(0)] * size for _ in range(size)]
    for i in range(n):
        rows[i][n + i] = Decimal(1)
        rows[n + i] = accelerations[i]
    for k, frequency in enumerate(_decimals(forcing.frequency)):
        at = 2 * n + 1 + 2 * k
        rows[at][at + 1], rows[at + 1][at] = -frequency, frequency
    return rows


def flow(
    system: System, t: float, x: NDArray[np.float64], seconds: Sequence[float]
) -> NDArray[np.float64]:
    """States after ``seconds`` along the motion without contact through ``x`` at ``t``."""
    with localcontext() as context:
        context.prec = _DIGITS
        start = [*_decimals(x), Decimal(1)]
        for frequency in _decimals(system.forcing.frequency):
            turn = [[Decimal(0), -frequency], [frequency, Decimal(0)]]
            start += _series(turn, [Decimal(1), Decimal(0)], Decimal(t))
        matrix = _augmented(system)
        states = [_series(matrix, start, Decimal(s))[: x.size] for s in seconds]
    return np.array(states, dtype=float)


def divided_difference(points: Sequence[complex], s: float) -> complex:
    """``exp(s .)[points]``, as the last entry of the exponential of a bidiagonal matrix."""
    with localcontext() as context:
        context.prec = _DIGITS
        size = 2 * len(points)
        rows = [[Decimal(0)] * size for _ in range(size)]
        for i, point in enumerate(points):
            real, imaginary = Decimal(point.real), Decimal(point.imag)
            rows[2 * i][2 * i] = rows[2 * i + 1][2 * i + 1] = real
            rows[2 * i][2 * i + 1], rows[2 * i + 1][2 * i] = -imaginary, imaginary
            if i:
                rows[2 * i - 2][2 * i] = rows[2 * i - 1][2 * i + 1] = Decimal(1)
        start = [Decimal(0)] * (size - 2) + [Decimal(1), Decimal(0)]
        real, imaginary = _series(rows, start, Decimal(s))[:2]
    return complex(float(real), float(imaginary))
