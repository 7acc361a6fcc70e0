# SPDX-License-Identifier: Apache-2.0
"""What the deviations of an estimate come from: each source's part of the variances."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from impact_observer.filter.square_root import lengths
from impact_observer.observer.belief import Belief
from impact_observer.observer.laws.minimum_variance import MinimumVariance
from impact_observer.states import Matrix, Vector

UNDECLARED, LEFT = "undeclared errors of the model", "shifts that its fit left"
VariancePart = tuple[str, Vector]
"""A source and its part of the variances of (q, u), shape (2n,)."""


class DeviationSources(NamedTuple):
    """The deviations of (q, u) and their sources, as means over some flights.

    Attributes:
        flights: how many, each in its middle.
        deviations: root mean squares, shape (2n,).
        shares: of the variance of each component by source, shape (2n,); they add up to 1.
    """

    flights: int
    deviations: Vector
    shares: dict[str, Vector]

    @classmethod
    def of_parts(cls, flights: int, parts: Iterable[VariancePart]) -> "DeviationSources":
        """The sources of the ``parts`` of all flights."""
        sums: dict[str, Vector] = {}
        for name, part in parts:
            sums[name] = sums.get(name, np.zeros_like(part)) + part
        total = np.sum([*sums.values()], axis=0)
        # What a source takes away from another is no share: a correlation may be negative.
        added = {name: np.maximum(part, 0.0) for name, part in sums.items()}
        whole = np.sum([*added.values()], axis=0)
        scale = np.where(whole > 0, whole, 1.0)
        shares = {name: part / scale for name, part in added.items()}
        return cls(flights, np.sqrt(total / flights), shares)


def variance_parts(
    law: MinimumVariance, belief: Belief, covariance: Matrix, sizes: Vector
) -> list[VariancePart]:
    """The parts of the variances of an estimate.

    Of the likeliest hypothesis first. Parameters that are considered have a part in corrections by
    their covariance with the state only: its slope by them is known. The other replicas began with
    the declared deviations and are corrected with the same gains; how they differ, without that
    slope, is the part of the initial state, and of the prior of estimated parameters. The rest is
    of the stamps, and of an error of the model that is learned as noise. What is published beyond
    that is of the other hypotheses; or, where the model is doubted, of the model.

    Args:
        law: of the estimate.
        belief: when the estimate holds.
        covariance: of the estimate as published, shape (2n, 2n).
        sizes: of the motion of (q, u), shape (2n,).
    """
    best, size, family = belief.hypotheses[0], belief.x.size, law.filter.members.family
    root, replicas = best.state.root, best.state.differences
    considered = size + np.flatnonzero(law.filter.members.considered)
    slope, shared = _slope(root[:size], root[considered])
    names = [family.names[i - size] for i in considered.tolist()]
    parts = [*zip(names, (slope * shared).T, strict=True)]
    rest = ["stamps"] if replicas.size else ["initial state", "stamps"]
    is_doubted = belief.fit.is_compared or belief.account is not None
    rest += ["model error"] if best.error.level or is_doubted else []
    if replicas.size:
        free = replicas[:size] - slope @ replicas[considered]
        parts.append(("initial state", np.mean(free**2, axis=1)))
    of_rest = " and ".join(rest)
    parts.append((of_rest, _beyond(np.sum(root[:size] ** 2, axis=1), parts)))
    parts.append((UNDECLARED, (law.uncertainty.undeclared * sizes) ** 2))
    parts.append((LEFT, law.uncertainty.shift.errors(belief.x) ** 2))
    others = of_rest if is_doubted else "undecided events"
    return [*parts, (others, _beyond(np.diag(covariance), parts))]


def _beyond(variances: Vector, parts: Sequence[VariancePart]) -> Vector:
    """The ``variances``, shape (2n,), less the ``parts`` of them; not negative."""
    known = np.sum([each for _, each in parts], axis=0)
    return np.asarray(np.maximum(variances - known, 0.0))


def _slope(errors: Matrix, parameters: Matrix) -> tuple[Matrix, Matrix]:
    """The slope of errors of the state by parameters, and their covariance; (2n, p) each.

    Both have roots, shape (2n, any) and (p, any). The product is the parameters' part of the
    variances.
    """
    covariance = errors @ parameters.T
    deviations = np.array(lengths(parameters))
    unit = parameters / deviations[:, None]
    inverse = np.linalg.pinv(unit @ unit.T, hermitian=True) / np.outer(deviations, deviations)
    return covariance @ inverse, covariance
