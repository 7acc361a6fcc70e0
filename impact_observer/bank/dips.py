# SPDX-License-Identifier: Apache-2.0
"""Dips of functions of time below zero, on a grid of values and slopes.

Between two points of the grid a function is the cubic through values and slopes of both.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_observer.dynamics.guard_values import GuardValues
from impact_observer.states import Vector

Array = NDArray[np.float64]


class Dips(NamedTuple):
    """Intervals in which functions are below zero, one row each.

    Attributes:
        h: the hypothesis.
        contact: the contact.
        began: bounds of the instant at which the gap falls below zero, s, shape (D, 2).
        lowest: when it is lowest, s.
        gap: how low, m.
        is_over: whether the gap has come back above zero.
        was_before: whether it was below zero at the start already.
    """

    h: NDArray[np.intp]
    contact: NDArray[np.intp]
    began: Array
    lowest: Vector
    gap: Vector
    is_over: NDArray[np.bool_]
    was_before: NDArray[np.bool_]


def dips_of(
    values: GuardValues,
    start: Vector,
    rounding: Callable[[], Vector],
    ignored: NDArray[np.intp],
) -> Dips | None:
    """The dips that are deeper than ``rounding``, in the order of their begins; None without one.

    Args:
        values: of the functions.
        start: of each hypothesis, s, shape (H,).
        rounding: gives depths that count as none, shape (m,).
        ignored: contacts whose gaps are not looked at.
    """
    g, v, ends = values
    low, at = _lowest(g, v, np.diff(ends, axis=0)[:, None])
    low[:, ignored] = 0.0
    if not (low < 0).any():
        return None
    negative = low < -rounding()[:, None]
    if not negative.any():
        return None
    at = at + ends[:-1, None]
    found = list[tuple[int, int, tuple[float, float], float, float, bool, bool]]()
    order = list[float]()
    for i, h in zip(*np.nonzero(negative.any(axis=0)), strict=True):
        steps = np.flatnonzero(negative[:, i, h])
        breaks = np.flatnonzero((np.diff(steps) > 1) | (g[steps[1:], i, h] >= 0)) + 1
        for run in np.split(steps, breaks):
            first, last = run[0], run[-1]
            lowest = run[np.argmin(low[run, i, h])]
            was_before = bool(first == 0 and g[0, i, h] < 0)
            is_below = g[first + 1, i, h] < 0
            began = ends[first, h], ends[first + 1, h] if is_below else at[first, i, h]
            if was_before:
                began = ends[0, h] - (ends[1, h] - ends[0, h]), ends[0, h]
            is_over = bool(g[last + 1, i, h] >= 0)
            gap = float(low[lowest, i, h])
            found.append((h, i, began, at[lowest, i, h], gap, is_over, was_before))
            above, below = max(g[first, i, h], 0.0), g[first + 1, i, h] if is_below else gap
            order.append(began[0] + (began[1] - began[0]) * above / max(above - below, 1e-300))
    found = [found[k] for k in np.argsort(order, kind="stable")]  # by when gaps are zero
    h, contact, bounds, when, gaps, over, before = (
        np.array(each) for each in zip(*found, strict=True)
    )
    own = start[h]
    return Dips(h, contact, bounds + own[:, None], when + own, gaps, over, before)


def _lowest(g: Array, v: Array, T: Array) -> tuple[Array, Array]:
    """Lowest values of cubics in steps of length ``T``, and when, s after the start of a step.

    Values ``g`` and slopes ``v`` at the ends of steps have shape (steps + 1, m, H).
    """
    g0, g1, v0, v1 = g[:-1], g[1:], v[:-1], v[1:]
    low, at = np.minimum(g0, g1), np.where(g0 < g1, 0.0, T)
    turns = np.nonzero((v0 < 0) & (v1 > 0))
    if turns[0].size:
        T = np.broadcast_to(T, g0.shape)[turns]
        p, q, a, b = g0[turns], g1[turns], v0[turns] * T, v1[turns] * T
        second, third = 3 * (q - p) - 2 * a - b, 2 * (p - q) + a + b
        # a + 2 second x + 3 third x^2 = 0, the root at which the slope grows
        root = np.sqrt(np.maximum(second**2 - 3 * third * a, 0.0))
        x = np.clip(-a / (second + root + 1e-300), 0.0, 1.0)
        value = p + x * (a + x * (second + x * third))
        better = value < low[turns]
        low[turns] = np.where(better, value, low[turns])
        at = np.array(at)
        at[turns] = np.where(better, x * T, at[turns])
    return low, at
