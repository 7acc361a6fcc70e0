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
        zero: a guess of that instant, by a line between values of the gap there, s.
        lowest: when it is lowest, s.
        gap: how low, m.
        is_over: whether the gap has come back above zero.
        was_before: whether it was below zero at the start already.
    """

    h: NDArray[np.intp]
    contact: NDArray[np.intp]
    began: Array
    zero: Vector
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
    i, h, step = np.nonzero(negative.transpose(1, 2, 0))  # the steps of a dip stand together
    is_first = np.ones(len(i), dtype=bool)
    is_first[1:] = (np.diff(step) != 1) | (np.diff(i) != 0) | (np.diff(h) != 0)
    is_first |= g[step, i, h] >= 0
    first, depth = np.flatnonzero(is_first), low[step, i, h]
    lowest = np.lexsort((depth, np.cumsum(is_first)))[first]
    last = step[np.append(first[1:], len(i)) - 1]
    when = ends[step[lowest], h[lowest]] + at[step[lowest], i[lowest], h[lowest]]
    i, h, step, gap = i[first], h[first], step[first], depth[lowest]
    before, after = g[step, i, h], g[step + 1, i, h]
    was_before = (step == 0) & (before < 0)
    below_from = np.where(after < 0, ends[step + 1, h], ends[step, h] + at[step, i, h])
    began = np.where(
        was_before, (2 * ends[0, h] - ends[1, h], ends[0, h]), (ends[step, h], below_from)
    )
    below = np.where(after < 0, after, gap)
    falls = (before > 0) & (v[step, i, h] < 0)
    part = np.where(falls, before / np.maximum(before - below, 1e-300), 0.5)
    zero = began[0] + (began[1] - began[0]) * part
    own, is_over = start[h], g[last + 1, i, h] >= 0
    by = np.argsort(zero, kind="stable")
    bounds, zero, when = (began + own).T[by], (zero + own)[by], (when + own)[by]
    return Dips(h[by], i[by], bounds, zero, when, gap[by], is_over[by], was_before[by])


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
