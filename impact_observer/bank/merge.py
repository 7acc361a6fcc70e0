# SPDX-License-Identifier: Apache-2.0
"""Few hypotheses of many: those that hardly differ are merged, the likeliest are kept."""

import numpy as np

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
    deviations = None
    groups: dict[tuple[int, ...], list[list[int]]] = {}
    _, flies = np.unique(ladders.errors, return_inverse=True)  # rungs with equal flights are one
    keys = np.column_stack([flies[rows.r], rows.c, rows.held, rows.just, rows.past[:, -scan:]])
    for k, key in enumerate(map(tuple, keys.tolist())):
        for group in (own := groups.setdefault(key, [])):
            if deviations is None:
                deviations = lengths_of(rows.roots(ladders)) + 1e-300
            first = group[0]
            is_alike = rows.r[k] == rows.r[first] or np.all(deviations[k] <= 2 * deviations[first])
            off = np.abs(rows.x[k] - rows.x[first])
            if is_alike and np.all(off <= numbers.near * deviations[first]):
                group.append(k)
                break
        else:
            own.append([k])
    found = [group for own in groups.values() for group in own]
    firsts = np.array([group[0] for group in found])
    result = rows.take(firsts)
    for place, group in enumerate(found):
        if len(group) > 1:
            weights = np.exp(rows.logw[group] - rows.logw[group[0]])
            result.logw[place] += np.log(weights.sum())
            weights /= weights.sum()
            mean = weights @ rows.x[group]
            apart = (rows.x[group] - mean)[:, :, None]
            scale = np.sqrt(weights)[:, None, None]
            S = np.concatenate([rows.S[group], apart], axis=2) * scale
            result.x[place] = mean
            result.S[place] = triangular(S.transpose(1, 0, 2).reshape(len(mean), -1))
            if rows.B[group].any():
                B = (rows.B[group] * scale).transpose(1, 0, 2).reshape(rows.B.shape[1], -1)
                result.B[place] = triangular(B)
    best = np.argsort(-result.logw)[: most_of(numbers, rows.x.shape[1])]
    result = result.take(best)
    total = np.logaddexp.reduce(result.logw)
    return result._replace(logw=result.logw - total)
