# SPDX-License-Identifier: Apache-2.0
"""Few hypotheses of many: those that hardly differ are merged, the likeliest are kept."""

import numpy as np
from numpy.typing import NDArray

from impact_observer.bank.bank import Hypotheses
from impact_observer.bank.ladders import Ladders, Numbers
from impact_observer.square_roots import lengths_of, triangular


def most_of(numbers: Numbers, size: int) -> int:
    """How many hypotheses of states of ``size`` numbers are kept."""
    return int(np.clip(numbers.numbers // size**2, numbers.least, numbers.most))


def merged(rows: Hypotheses, ladders: Ladders, numbers: Numbers, scan: int) -> Hypotheses:
    """Hypotheses with equal rungs, contacts and last ``scan`` decisions, and close means, as one.

    Mean and covariance of each one are those of its parts (Gaussian sum). Rungs that fly alike
    count as equal once their deviations are.
    """
    order = np.argsort(-rows.logw)
    order = order[rows.logw[order] > rows.logw[order[0]] + numbers.log_kept]
    rows = rows.take(order)
    groups = _alike(rows, ladders, numbers, scan)
    result = rows.take([group[0] for group in groups])
    if several := [k for k, group in enumerate(groups) if len(group) > 1]:
        _mix(result, several, rows, [groups[k] for k in several])
    best = np.argsort(-result.logw)[: most_of(numbers, rows.x.shape[1])]
    result = result.take(best)
    total = np.logaddexp.reduce(result.logw)
    return result._replace(logw=result.logw - total)


def _alike(rows: Hypotheses, ladders: Ladders, numbers: Numbers, scan: int) -> list[list[int]]:
    """Numbers of the hypotheses that are one, each group led by its first."""
    _, flies = np.unique(ladders.errors, return_inverse=True)  # rungs with equal flights are one
    keys = np.column_stack([flies[rows.r], rows.c, rows.held, rows.just, rows.past[:, -scan:]])
    known: dict[tuple[int, ...], int] = {}
    kind = np.array([known.setdefault(tuple(key), len(known)) for key in keys.tolist()])
    if len(known) == rows.size:
        return [[k] for k in range(rows.size)]
    near = kind[:, None] == kind
    deviations = lengths_of(rows.roots(ladders)) + 1e-300
    is_narrow = np.all(deviations[:, None] <= 2 * deviations, axis=2)
    near &= (rows.r[:, None] == rows.r) | is_narrow
    near &= np.all(np.abs(rows.x[:, None] - rows.x) <= numbers.near * deviations, axis=2)
    groups = dict[int, list[int]]()
    for k, each in enumerate(near.tolist()):
        leader = next((first for first in groups if each[first]), k)
        groups.setdefault(leader, []).append(k)
    return [*groups.values()]


def _mix(result: Hypotheses, where: list[int], rows: Hypotheses, groups: list[list[int]]) -> None:
    """Write the mixtures of ``groups`` of ``rows`` to rows ``where`` of ``result``."""
    most = max(map(len, groups))
    of = np.array([group + group[:1] * (most - len(group)) for group in groups])
    logw = np.where(np.arange(most) < np.array([[len(g)] for g in groups]), rows.logw[of], -np.inf)
    total = np.logaddexp.reduce(logw, axis=1)
    weights = np.exp(logw - total[:, None])
    mean = np.einsum("gk,gki->gi", weights, rows.x[of])
    apart = (rows.x[of] - mean[:, None])[..., None]
    scale = np.sqrt(weights)[..., None, None]
    result.logw[where], result.x[where] = total, mean
    result.S[where] = _joined(np.concatenate([rows.S[of], apart], axis=3) * scale)
    if rows.B.any():
        result.B[where] = _joined(rows.B[of] * scale)


def _joined(roots: NDArray[np.float64]) -> NDArray[np.float64]:
    """Roots of sums of covariances, shape (G, N, N), from those of parts, (G, parts, N, any)."""
    G, _, N, _ = roots.shape
    return triangular(roots.transpose(0, 2, 1, 3).reshape(G, N, -1))
