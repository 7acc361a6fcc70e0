# SPDX-License-Identifier: Apache-2.0
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
_LONGEST = 30
"""Time, over the matrix's norm, that the power series may bridge: it loses as many digits."""

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
    """``exp(s matrix) start``, term by term, without the zeros of the matrix."""
    rows = [[(i, value) for i, value in enumerate(row) if value] for row in matrix]
    total = term = start
    k = 0
    while k < 10 or max(map(abs, term)) > _SMALL:
        k += 1
        scale = s / k
        term = [scale * sum((a * term[i] for i, a in row), Decimal(0)) for row in rows]
        total = [a + b for a, b in zip(total, term, strict=True)]
    return total


def _matrix_times(left: Rows, right: Rows) -> Rows:
    columns = list(zip(*right, strict=True))
    return [
        [sum((a * b for a, b in zip(row, column, strict=True)), Decimal(0)) for column in columns]
        for row in left
    ]


def _after(matrix: Rows, start: Vector, s: Decimal) -> Vector:
    """``exp(s matrix) start``; long times by squaring, which loses a digit each factor of ten."""
    size = s * max(sum(abs(value) for value in row) for row in matrix)
    doublings = 0
    while size > _LONGEST:
        size, doublings = size / 2, doublings + 1
    if not doublings:
        return _series(matrix, start, s)
    n = len(matrix)
    units = [[Decimal(int(i == k)) for i in range(n)] for k in range(n)]
    columns = [_series(matrix, unit, s / 2**doublings) for unit in units]
    power = [list(row) for row in zip(*columns, strict=True)]
    for _ in range(doublings):
        power = _matrix_times(power, power)
    return _times(power, start)


def _augmented(system: System) -> Rows:
    """The matrix of ``(q, u, a, b, cos w_1 t, sin w_1 t, ...)``.

    ``a`` is the acceleration by constant and samples, ``b`` its rate.
    """
    n, forcing = system.n, system.forcing
    columns = [system.K * -1.0, system.C * -1.0]
    for cosine, sine in zip(forcing.cosine, forcing.sine, strict=True):
        columns += [cosine[:, None], sine[:, None]]
    loads = [_decimals(row) for row in np.hstack(columns)]
    accelerations = _solve([_decimals(row) for row in system.M], loads)
    size = 4 * n + 2 * forcing.frequency.size
    rows = [[Decimal(0)] * size for _ in range(size)]
    for i in range(n):
        rows[i][n + i] = rows[n + i][2 * n + i] = rows[2 * n + i][3 * n + i] = Decimal(1)
        rows[n + i][: 2 * n] = accelerations[i][: 2 * n]
        rows[n + i][4 * n :] = accelerations[i][2 * n :]
    for k, frequency in enumerate(_decimals(forcing.frequency)):
        at = 4 * n + 2 * k
        rows[at][at + 1], rows[at + 1][at] = -frequency, frequency
    return rows


class _Loads:
    """Constant and samples of a forcing as accelerations, from one knot to the next."""

    def __init__(self, system: System) -> None:
        self._mass = [_decimals(row) for row in system.M]
        self._constant = _decimals(system.forcing.constant)
        samples = system.forcing.sampled
        self._linear = samples is not None and samples.hold == "linear"
        self.times = [] if samples is None else _decimals(samples.time)
        self._force = [] if samples is None else [_decimals(row) for row in samples.force]

    def at(self, t: Decimal) -> Vector:
        """``a`` and ``b`` from ``t`` on."""
        value, slope = self._constant, [Decimal(0)] * len(self._constant)
        if self.times:
            j = max(i for i in range(len(self.times) - 1) if i == 0 or self.times[i] <= t)
            early, late = self._force[j], self._force[j + 1]
            if self._linear:
                step = self.times[j + 1] - self.times[j]
                slope = [(b - a) / step for a, b in zip(early, late, strict=True)]
            since = t - self.times[j]
            value = [c + a + b * since for c, a, b in zip(value, early, slope, strict=True)]
        accelerations = _solve(self._mass, [list(row) for row in zip(value, slope, strict=True)])
        return [row[0] for row in accelerations] + [row[1] for row in accelerations]


def flow(
    system: System, t: float, x: NDArray[np.float64], seconds: Sequence[float]
) -> NDArray[np.float64]:
    """States after ascending ``seconds`` along the motion without contact through ``x`` at ``t``.

    Samples of the forcing are held, or joined by lines, exactly.
    """
    with localcontext() as context:
        context.prec = _DIGITS
        matrix, loads = _augmented(system), _Loads(system)
        now, size = Decimal(t), 4 * system.n
        state = [*_decimals(x), *loads.at(now)]
        for frequency in _decimals(system.forcing.frequency):
            turn = [[Decimal(0), -frequency], [frequency, Decimal(0)]]
            state += _after(turn, [Decimal(1), Decimal(0)], now)
        states = []
        for s in _decimals(np.asarray(seconds, dtype=float)):
            end = Decimal(t) + s
            for knot in [time for time in loads.times if now < time < end] + [end]:
                state = _after(matrix, state, knot - now)
                now = knot
                state = state[: x.size] + loads.at(now) + state[size:]
            states.append(state[: x.size])
    return np.array(states, dtype=float)
