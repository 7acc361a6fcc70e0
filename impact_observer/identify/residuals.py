# SPDX-License-Identifier: Apache-2.0
"""Tests of the shifts of the stamps: whether the model fits, and its standard errors."""

from typing import NamedTuple

import numpy as np
from scipy import linalg, stats

from impact_observer.identify.problem import ROUNDED, Solution
from impact_observer.states import Vector

REJECTED = 1e-6
"""Probability of the shifts under the model below which the model is rejected."""
DOUBTED = 1e-3
"""Probability of the shifts under the model below which standard errors are widened."""
UNDECLARED = 1e-3
"""Size above which shifts are no errors of a clock of which none is declared, s: a million times
the rounding of stamps.
"""
_PARTS = 5
"""Parts of a recording that are left out in turn."""
_SINGULAR = 1e-2
"""Share of a part's shifts below which the others determine these: none is left to judge."""


class HeldBack(NamedTuple):
    """The last impacts of a recording, predicted from a fit of the earlier ones.

    Attributes:
        impacts: how many are held back.
        residual: rms of what their stamps differ from the predictions, s: each from the fit of all
            before it, over the uncertainty of that prediction in units of a stamp's error
            (recursive residuals; Brown, Durbin and Evans, Techniques for testing the constancy of
            regression relationships over time, 1975).
        fitted: rms of the shifts of the fitted part, s.
        probability: of a ratio this large if the model were right (Chow, Tests of equality
            between sets of coefficients in two linear regressions, 1960).
    """

    impacts: int
    residual: float
    fitted: float
    probability: float

    @property
    def carries_over(self) -> bool:
        """Whether the predictions are as good as the fit."""
        return self.probability >= DOUBTED

    @staticmethod
    def between(first: Solution, every: Solution) -> "HeldBack":
        """Compare a fit of the first impacts with one of all."""
        impacts = every.shifts.size - first.shifts.size
        more = max(every.cost - first.cost, 0.0)
        residual = float(np.sqrt(more / impacts))
        ratio = (residual / max(first.rms, ROUNDED)) ** 2
        probability = float(stats.f.sf(ratio, impacts, max(first.freedom, 1)))
        return HeldBack(impacts, residual, first.rms, probability)


def probability_of_size(shifts: Vector, clock: float, freedom: float) -> float:
    """Probability of shifts this large if stamps have the standard deviation ``clock``, s."""
    return float(stats.chi2.sf(np.sum((shifts / clock) ** 2), max(freedom, 1)))


def lags_of(shifts: Vector) -> int:
    """Lags of the autocorrelations that are tested."""
    return max(1, min(10, shifts.size // 3))


def whiteness(shifts: Vector) -> float:
    """Ljung and Box's probability of the autocorrelations of ``shifts``."""
    K, power, lags = shifts.size, float(np.sum(shifts**2)), lags_of(shifts)
    if power == 0.0 or lags >= K:
        return 1.0
    lag = np.arange(1, lags + 1)
    rho = np.array([float(shifts[k:] @ shifts[:-k]) for k in lag]) / power
    return float(stats.chi2.sf(K * (K + 2) * np.sum(rho**2 / (K - lag)), lags))


def independence(shifts: Vector, clock: float | None = None) -> float:
    """``whiteness`` of shifts of stamps, s; 1 where they are the rounding of the stamps.

    The rounding of a periodic motion repeats itself, and says nothing against the model. Times may
    be printed with few digits: shifts up to half of a declared ``clock`` error, s, are rounding.
    """
    return 1.0 if is_rounding(shifts, clock) else whiteness(shifts)


def is_rounding(shifts: Vector, clock: float | None = None) -> bool:
    """Whether shifts, s, are as small as the rounding of stamps, or half the ``clock`` error."""
    least = max(2.0 * ROUNDED, (clock or 0.0) / 2)
    return bool(np.sum(shifts**2) <= shifts.size * least**2)


def explained(solution: Solution, clock: float | None) -> bool:
    """Whether white errors of a clock explain the shifts.

    ``clock`` is the declared standard deviation of a stamp, s; None allows errors of any size.
    """
    errors, size = solution.residuals, 1.0
    if clock is not None:
        size = probability_of_size(errors, max(clock, ROUNDED), solution.redundancy)
    return solution.converged and min(size, independence(errors, clock)) >= REJECTED


def probabilities_of_savings(solution: Solution, saved: Vector, clock: float | None) -> Vector:
    """Probabilities that a parameter which is right saves as much by chance, shape (others,).

    Rao's score test (Large sample tests of statistical hypotheses concerning several parameters,
    1948): ``saved`` are squares of shifts, s^2, by one degree of freedom each. Bonferroni's factor
    allows for the number of parameters.

    Args:
        solution: the fit.
        saved: from ``savings``.
        clock: declared standard deviation of a stamp, s; None for none. The shifts show another,
            and the larger one counts.
    """
    if is_rounding(solution.shifts):
        return np.ones(saved.size)
    freedom = max(solution.redundancy - 1, 1)
    left = np.maximum(solution.cost - saved, solution.redundancy * ROUNDED**2)
    chances = stats.f.sf(saved / left * freedom, 1, freedom)
    if clock is not None:
        declared = stats.chi2.sf(saved / max(clock, ROUNDED) ** 2, 1)
        chances = np.maximum(chances, declared)
    return np.asarray(np.minimum(chances * saved.size, 1.0))


def widening(solution: Solution, clock: float | None) -> float:
    """Factor of the standard errors: 1 where white errors of the clock explain the shifts.

    Otherwise errors of the model are among them. These need not average out, and no formula for
    independent errors applies. The standard errors become those of a jackknife: each fifth of the
    impacts is left out in turn, and the combination of unknowns that changes most counts. Where
    neighbouring shifts are correlated, the factor is at least that of a mean of shifts whose
    autocorrelations all add up. A declared clock error that covers such errors needs no factor.

    Args:
        solution: the fit.
        clock: declared standard deviation of a stamp, s; None if only rounding is known.
    """
    shifts, least = solution.residuals, max(clock or 0.0, ROUNDED)
    if solution.scattered is not None:
        least = solution.scattered.shown.clock
    size = probability_of_size(shifts, least, solution.redundancy)
    white = independence(shifts, clock)
    if min(size, white) >= DOUBTED:
        return 1.0
    if solution.scattered is not None:
        return _correlated(shifts)
    rms = max(solution.rms, ROUNDED)
    correlated = _correlated(shifts) if white < DOUBTED else 1.0
    shown = max(_jackknife(solution), rms * correlated)
    return float(max(shown / (rms if clock is None else least), 1.0))


def _correlated(shifts: Vector) -> float:
    """Largest standard deviation of a mean of ``shifts``, over that of independent ones."""
    lags = range(1, lags_of(shifts) + 1)
    sums = [abs(float(shifts[k:] @ shifts[:-k])) for k in lags]
    return float(np.sqrt(1 + 2 * sum(sums) / np.sum(shifts**2)))


def _jackknife(solution: Solution) -> float:
    """The error of a stamp that gives the jackknife's variance in its largest direction, s."""
    root, count = solution.root, solution.shifts.size
    scale = linalg.norm(root, axis=1, keepdims=True)
    # rows of unit length: the combinations of shifts that the fit takes up
    singular, right = linalg.svd(root / np.where(scale > 0, scale, 1.0), full_matrices=False)[1:]
    taken = right[singular > 1e-12 * singular[0]]
    remain = np.eye(root.shape[1]) - taken.T @ taken
    changes = []
    for part in np.array_split(np.arange(count), _PARTS):
        own = linalg.pinvh(remain[np.ix_(part, part)], rtol=_SINGULAR)
        changes.append(taken[:, part] @ own @ solution.shifts[part])
    largest = linalg.norm(np.array(changes), 2) if taken.size else 0.0
    return float(largest * np.sqrt((_PARTS - 1) / _PARTS))
