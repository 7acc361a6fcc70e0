# SPDX-License-Identifier: Apache-2.0
"""The prior of a fit: the deviations that a model file declares of free parameters.

The declared value of a parameter is one more measurement of the parameter, with a Gaussian error.
Impacts of a periodic motion are few numbers, which often agree with one restitution as well as
with another; the prior decides between these, and impacts that tell more than the prior outweigh
the prior (Gelman et al., Bayesian data analysis, section 14.8).
"""

from typing import NamedTuple

import numpy as np
from scipy import linalg, stats

from impact_observer.model.parameter_uncertainty import ParameterUncertainty, correlations_of
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.states import Matrix, Vector

_LEAST = 1e-12
"""Least variance of a combination of parameters, each in units of its deviation."""
_LITTLE = 0.9
"""Deviation after a fit over that before, from which on impacts say little of a parameter."""

_TOLD = 0.5
"""Largest deviation after a fit over that before of a combination that impacts tell."""


class PriorShift(NamedTuple):
    """What a fit changed in a parameter that has a prior.

    Attributes:
        name: of the parameter.
        deviation: declared, in the unit of the parameter.
        innovation: change of the value over the deviation that the prior expects of this change.
        is_little: whether the value is hardly better known than before.
    """

    name: str
    deviation: float
    innovation: float
    is_little: bool


def prior_covariance(
    known: ParameterUncertainty | None, family: ParametricFamily
) -> tuple[list[int], Matrix]:
    """Indices of the parameters of a ``family`` with a deviation, and the covariance of these.

    Parameters of deviation 0 have no prior: who frees a parameter doubts its value.
    """
    if known is None:
        return [], np.zeros((0, 0))
    where = {name: i for i, name in enumerate(known.names) if known.deviations[i] > 0}
    own = [k for k, name in enumerate(family.names) if name in where]
    rows = [where[family.names[k]] for k in own]
    return own, known.covariance[np.ix_(rows, rows)]


def prior_rows(known: ParameterUncertainty | None, family: ParametricFamily) -> Matrix:
    """Rows R, shape (k, p), by which R (theta - nominal) is standard normal."""
    own, covariance = prior_covariance(known, family)
    rows = np.zeros((len(own), family.size))
    if own:
        values, axes = linalg.eigh(correlations_of(covariance))
        root = axes / np.sqrt(np.maximum(values, _LEAST))
        rows[:, own] = root.T / np.sqrt(np.diag(covariance))
    return rows


def prior_shifts(
    known: ParameterUncertainty | None,
    family: ParametricFamily,
    values: Vector,
    errors: Vector,
    *,
    is_used: bool = True,
) -> tuple[PriorShift, ...]:
    """What a fit changed in the parameters of a ``family`` that have a prior.

    If all is right, the variance of the change is the prior's less the posterior's. Of a fit that
    has not used the prior both variances add up.

    Args:
        known: the prior.
        family: the free parameters.
        values: fitted, shape (p,), SI units.
        errors: standard deviations of ``values`` if the model is right, shape (p,).
        is_used: whether the fit has used the prior.
    """
    which, covariance = prior_covariance(known, family)
    shifts = []
    for k, before in zip(which, np.sqrt(np.diag(covariance)).tolist(), strict=True):
        own = float(errors[k]) ** 2 * (-1 if is_used else 1)
        expected = max(before**2 + own, _LEAST * before**2)
        change = float(values[k]) - family.parameters[k].value
        is_little = is_used and bool(errors[k] > _LITTLE * before)
        innovation = 0.0 if is_little else change / float(np.sqrt(expected))
        shifts.append(PriorShift(family.names[k], before, innovation, is_little))
    return tuple(shifts)


def numbers_told(
    known: ParameterUncertainty | None, family: ParametricFamily, covariance: Matrix
) -> int:
    """How many combinations of the parameters of a ``family`` a fit made known.

    Of one that has a prior the deviation is at most half of what the prior says.

    Args:
        known: the prior.
        family: the p free parameters.
        covariance: of the initial state and the parameters, shape (2n + p, 2n + p).
    """
    which, before = prior_covariance(known, family)
    rows = np.add(which, covariance.shape[0] - family.size)
    if not which:
        return family.size
    ratios = linalg.eigvalsh(covariance[np.ix_(rows, rows)], before)
    return family.size - len(which) + int(np.sum(ratios < _TOLD**2))


def chance_of(shifts: tuple[PriorShift, ...]) -> float:
    """Probability of an innovation as large as the largest, of as many as there are."""
    largest = max((abs(each.innovation) for each in shifts), default=0.0)
    return float(min(2.0 * len(shifts) * stats.norm.sf(largest), 1.0))
