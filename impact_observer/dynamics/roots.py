# SPDX-License-Identifier: Apache-2.0
"""The first root of several guard functions along a motion; no root is skipped.

Within a step of a motion a guard function is a polynomial of the time in steps, ``g(x)`` for
``0 <= x <= 1``. On an interval of width ``w`` the function is at least ``min(g) - B w^2 / 8``,
``min(g)`` being the lesser value of both ends and ``B`` a bound of ``|g''|``. Where this bound is
negative by more than rounding the interval is halved, until no root is left or the slope has one
sign and a change of sign is bracketed. A graze that is less deep than rounding is no root.

A motion may start on a guard, as after an impact. The polynomial of such a guard loses its leading
zeros, ``g = x^k p(x)``, and the roots of ``p`` are searched: the speed decides, else the
acceleration, and so on.
"""

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from impact_observer.dynamics.exponential import TERMS, Exponential, horner, polynomials
from impact_observer.states import Matrix, Vector

_GRAZE = 1e-14
"""Depth below zero that counts as none, relative to the terms of a function, for each window that
the motion has lasted."""
_ZERO = 1e-12
"""Value of a function that counts as zero at a start or a crossing, relative to the same."""
_NARROW = 2.0**-50
"""Least width of an interval that is halved, in steps."""
_EQUAL = 4e-16
"""Relative accuracy of a root."""
_ORDERS = np.arange(TERMS, dtype=np.float64)
_BEND = _ORDERS * (_ORDERS - 1)


class Steps(NamedTuple):
    """Successive steps of a motion.

    Attributes:
        start: s since the start of the motion, shape (steps,).
        length: s, shape (steps,), at most the step of the exponential.
        z: states at the starts, shape (steps, N).
        end: end of the last step, s since the start of the motion.
        is_even: whether all steps have the length of the exponential's.
    """

    start: Vector
    length: Vector
    z: Matrix
    end: float
    is_even: bool


class Stepped(Protocol):
    """A motion that is computed window after window."""

    @property
    def final_until(self) -> float:
        """Time since the start until which all forces are known for good, s."""

    def window(self, number: int) -> Steps:
        """The steps of a window; windows are numbered from 0."""


class Guards:
    """Linear functions ``R z`` of the states of one flow."""

    def __init__(self, exponential: Exponential, R: Matrix) -> None:
        """Prepare the Taylor coefficients of the functions; ``R`` has shape (w, N)."""
        self._count = len(R)
        self._step = exponential.step
        rows = exponential.rows(R)
        self._rows = rows.reshape(-1, R.shape[1])
        self._sizes = np.abs(rows)
        self._scale = self._sizes[:3].sum(axis=0)

    def first_root(
        self, steps: Steps, since: float, is_start: bool
    ) -> tuple[float, tuple[int, ...]] | None:
        """The first instant at which a function falls below zero.

        Args:
            steps: of one window.
            since: no root is searched before, s since the start of the motion.
            is_start: whether the motion starts at ``since``, perhaps on a guard.

        Returns:
            s since the start of the motion, and the indices of all functions that are zero there;
            None without a root in the window.
        """
        w, count = self._count, steps.start.size
        if not w:
            return None
        c = self._rows.dot(steps.z.T).reshape(TERMS, w * count)
        if not steps.is_even:
            c *= np.tile(steps.length / self._step, w) ** _ORDERS[:, None]
        lowest = np.minimum(c[0], c.sum(axis=0)) - _BEND @ np.abs(c) / 8
        if is_start:
            lowest[::count] = -np.inf
        if lowest.min() >= 0:
            return None
        c, lowest = c.reshape(TERMS, w, count), lowest.reshape(w, count)
        scale = self._scale @ np.abs(steps.z).max(axis=0)
        begin = float(steps.start[0])
        depths = _GRAZE * scale * (1 + begin / (steps.end - begin))
        doubtful = lowest < -depths[:, None]
        if since > begin:
            first = int(steps.start.searchsorted(since, side="right")) - 1
            doubtful[:, :first] = False
        for j in doubtful.any(axis=0).nonzero()[0].tolist():
            start, length = float(steps.start[j]), float(steps.length[j])
            low = min(max((since - start) / length, 0.0), 1.0)
            zero = self._zero(steps) if is_start and j == 0 and not low else None
            x = np.inf
            for i in doubtful[:, j].nonzero()[0].tolist():
                g, depth = c[:, i, j].tolist(), float(depths[i])
                if zero is not None and abs(g[0]) <= _ZERO * scale[i]:
                    g, depth = _without_zeros(g, zero[:, i].tolist()), 0.0
                found = first_below(g, depth, low)
                x = x if found is None else min(x, found)
            if x <= 1.0:
                return start + x * length, self._together(c[:, :, j : j + 1], x, scale)
        return None

    def _together(self, c: NDArray[np.float64], x: float, scale: Vector) -> tuple[int, ...]:
        """Indices of the polynomials ``c`` that are zero or negative at the root ``x`` of one."""
        if self._count == 1:
            return (0,)
        values = polynomials(c, np.array([x]))[:, 0]
        which = values <= np.maximum(_ZERO * scale, np.min(values))
        return tuple(np.flatnonzero(which).tolist())

    def _zero(self, steps: Steps) -> NDArray[np.float64]:
        """Coefficients that are rounding at the start of the first step, shape (TERMS, w)."""
        relative = (steps.length[0] / self._step) ** _ORDERS
        return np.asarray(_ZERO * (self._sizes @ np.abs(steps.z[0])) * relative[:, None])


class RootSearch:
    """A search along one motion, which goes on where it has stopped."""

    def __init__(self, guards: Guards, motion: Stepped, start: float = 0.0) -> None:
        """Begin at ``start``, s since the start of the motion; nothing counts before."""
        self._guards, self._motion, self._start = guards, motion, start
        self._window = 0
        self._found: tuple[float, tuple[int, ...]] | None = None

    def first(self, horizon: float) -> tuple[float, tuple[int, ...]] | None:
        """The first root, if the windows up to ``horizon`` (s since the start) have one."""
        while self._found is None:
            steps, known = self._motion.window(self._window), self._motion.final_until
            if steps.start[0] > min(horizon, known):
                return None
            if steps.end > self._start:
                is_start = self._window == 0
                found = self._guards.first_root(steps, self._start, is_start)
                if found is not None and found[0] <= known:
                    self._found = found
                    break
            if steps.end > known:
                return None
            self._window += 1
        return self._found


def first_below(c: list[float], depth: float, low: float = 0.0) -> float | None:
    """Where the polynomial ``c`` first falls below zero in [``low``, 1]; None if nowhere.

    Args:
        c: coefficients, from the constant on.
        depth: depth below zero that counts as none.
        low: a value below zero at ``low`` by more than ``depth`` is a root at ``low``.
    """
    last = len(c)
    while last > 1 and c[last - 1] == 0.0:
        last -= 1
    c, slope, bend = c[:last], list[float](), 0.0
    for k in range(1, last):
        slope.append(k * c[k])
        bend += abs((k - 1) * slope[-1])
    at_low, at_high = horner(c, low), horner(c, 1.0)
    if at_low < -depth:
        return low
    waiting = [(low, max(at_low, 0.0), 1.0, at_high)]
    while waiting:
        a, at_a, b, at_b = waiting.pop()
        width = b - a
        if min(at_a, at_b) - bend * width * width / 8 >= -depth:
            continue
        if at_b < -depth and (
            width < _NARROW or abs(horner(slope, a + width / 2)) > bend * width / 2
        ):
            return _bracketed(c, slope, a, b)
        if width < _NARROW:
            continue
        middle = a + width / 2
        at_middle = horner(c, middle)
        if at_middle >= -depth:  # else the first root lies before
            waiting.append((middle, max(at_middle, 0.0), b, at_b))
        waiting.append((a, at_a, middle, at_middle))
    return None


def _without_zeros(c: list[float], zero: list[float]) -> list[float]:
    """The polynomial ``p`` of ``c = x^k p(x)``, whose leading coefficient is more than rounding.

    A polynomial that is rounding only is zero.
    """
    for k, (each, least) in enumerate(zip(c, zero, strict=True)):
        if k and abs(each) > least:
            return c[k:]
    return [0.0]


def _bracketed(c: list[float], slope: list[float], low: float, high: float) -> float:
    """The root in [``low``, ``high``], ``c`` being negative at ``high``: Newton's method."""
    x = high
    while high - low > _EQUAL * high:
        value = horner(c, x)
        if value < 0:
            high = x
        else:
            low = x
        rate = horner(slope, x)
        after = x - value / rate if rate else low
        if not low < after < high:
            if abs(after - x) <= _EQUAL * x:
                return x
            after = low + (high - low) / 2
            if after in (low, high):
                return after
        if abs(after - x) <= _EQUAL * after:
            return after
        x = after
    return high
