# SPDX-License-Identifier: Apache-2.0
"""Gaps and loads of many flights on a grid of times."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_observer.states import Vector

Array = NDArray[np.float64]


class GuardValues(NamedTuple):
    """Values and slopes of functions at the ends of the steps of K flights.

    Attributes:
        g: values, shape (steps + 1, k, K).
        v: slopes, 1/s, the same shape.
        ends: of the steps, s since the start of each flight, shape (steps + 1, K).
    """

    g: Array
    v: Array
    ends: Array

    @classmethod
    def to_the_end(cls, g: Array, v: Array, step: float, length: Vector) -> "GuardValues":
        """Values on steps of equal length; the last of each flight ends at its ``length``."""
        steps = len(g) - 1
        ends = np.minimum(np.arange(steps + 1)[:, None] * step, length)
        last = np.minimum((length / step).astype(int), steps - 1)
        part = (length - last * step) / step
        each, both = np.arange(g.shape[2]), np.stack([last, last + 1])
        g_end, v_end = _cubic(g[both, :, each], v[both, :, each], step, part[:, None])
        beyond = np.arange(steps + 1)[:, None, None] > last
        return cls(np.where(beyond, g_end.T, g), np.where(beyond, v_end.T, v), ends)


def _cubic(ends: Array, slopes: Array, step: float, part: Array) -> tuple[Array, Array]:
    """Value and slope at a ``part`` of a step, of cubics through both ends, shape (2, ...)."""
    (g0, g1), (a, b) = ends, slopes * step
    second, third = 3 * (g1 - g0) - 2 * a - b, 2 * (g0 - g1) + a + b
    value = g0 + part * (a + part * (second + part * third))
    return value, (a + part * (2 * second + 3 * part * third)) / step
