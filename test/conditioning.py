# SPDX-License-Identifier: Apache-2.0
"""States of a linear chain given all measurements, by conditioning on all of them at once."""

import math
from collections.abc import Callable
from decimal import Decimal, localcontext
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from impact_observer.smooth.chain import Normal, Step
from impact_observer.states import Matrix, Vector

_DIGITS = 60
_Numbers: TypeAlias = NDArray[Any]
"""Floats, or decimal numbers."""


def conditioned(
    first: Normal, steps: list[Step], *, precise: bool = False
) -> tuple[list[Vector], list[Matrix], float]:
    """Means and covariances of all states given all measurements, and their log density.

    All states are functions of one vector of independent errors. ``precise`` computes with 60
    decimal digits, so that measurements may be as exact as they like.
    """
    with localcontext() as context:
        context.prec = _DIGITS
        return _conditioned(first, steps, _decimals if precise else np.array)


def _conditioned(
    first: Normal, steps: list[Step], numbers: Callable[[Matrix], _Numbers]
) -> tuple[list[Vector], list[Matrix], float]:
    size = first.root.shape[1] + sum(each.N.shape[1] for each in steps)
    c, used = numbers(first.mean), first.root.shape[1]
    F = numbers(np.zeros((len(c), size)))
    F[:, :used] = numbers(first.root)
    maps, offsets, rows, values, noises = [F], [c], [], [], []
    for step in steps:
        A, b, N, H, y, V = (numbers(each) for each in step[:6])
        F, c = A @ F, A @ c + b
        F[:, used : used + N.shape[1]] += N
        used += N.shape[1]
        maps.append(F)
        offsets.append(c)
        rows.append(H @ F)
        values.append(y - H @ c)
        noises.append(np.sum(V**2, axis=1))
    H, y = np.vstack(rows), np.concatenate(values)
    S = H @ H.T
    S[np.diag_indices(len(S))] += np.concatenate(noises)
    weighted, log_det = _solved(S, np.column_stack([y, H]))
    density = -float(y @ weighted[:, 0]) / 2 - (log_det + len(y) * math.log(2 * math.pi)) / 2
    means = [c + F @ (H.T @ weighted[:, 0]) for F, c in zip(maps, offsets, strict=True)]
    covariances = [F @ F.T - (F @ H.T) @ (weighted[:, 1:] @ F.T) for F in maps]
    return [c.astype(float) for c in means], [P.astype(float) for P in covariances], density


def _solved(S: _Numbers, B: _Numbers) -> tuple[_Numbers, float]:
    """``S^-1 B`` and the logarithm of the determinant of ``S``, which is positive definite."""
    k, both = len(S), np.column_stack([S, B])
    for i in range(k):
        both[i + 1 :] -= np.outer(both[i + 1 :, i] / both[i, i], both[i])
    pivots, X = both.diagonal().copy(), both[:, k:]
    for i in reversed(range(k)):
        X[i] = (X[i] - both[i, i + 1 : k] @ X[i + 1 :]) / pivots[i]
    return X, sum(math.log(each) for each in pivots)


def _decimals(values: Matrix) -> _Numbers:
    """The same numbers, exactly."""
    found = np.array([Decimal(each) for each in values.ravel().tolist()], dtype=object)
    return found.reshape(values.shape)
