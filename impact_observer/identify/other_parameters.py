# SPDX-License-Identifier: Apache-2.0
"""Which parameters that were not free would explain what a fitted model does not."""

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from impact_observer.errors import IdentificationError
from impact_observer.identify.least_squares import savings
from impact_observer.identify.problem import Problem, Solution
from impact_observer.identify.residuals import (
    DOUBTED,
    explained,
    probabilities_of_savings,
)
from impact_observer.identify.search import fit, gated
from impact_observer.identify.sensor_fit import sensor_fits
from impact_observer.model.free_parameters import parameters_beside
from impact_observer.model.parametric_family import ModelParameter
from impact_observer.states import Vector

_ALIKE = 2.0
"""Shifts over those of the best fit, up to which another parameter explains the stamps, too."""
_FIRST = 24
"""Moments that a fit begins with where the fit without the parameter is lost."""


class OtherParameter(NamedTuple):
    """A fit with one more free parameter.

    Attributes:
        name: of the parameter that was not free.
        value: fitted, in its unit.
        unit: SI unit; empty for a ratio.
        rms: of the shifts, s.
        fits: whether the model fits with the parameter free.
        values: of the parameters that were free before, shape (p,), SI units.
    """

    name: str
    value: float
    unit: str
    rms: float
    fits: bool
    values: Vector


def missed_parameters(
    problem: Problem, solution: Solution, clock: float | None, limit: float
) -> tuple[ModelParameter, ...]:
    """The parameters that the shifts ask for: each explains more of them than chance does.

    ``clock`` is the declared standard deviation of a stamp, s; None if unknown. Below ``limit`` a
    probability is no chance.
    """
    others = parameters_beside(problem.family)
    if not others or solution.freedom <= 1:
        return ()
    saved, changes = savings(problem, solution, others)
    chances = probabilities_of_savings(solution, saved, clock)
    rows = zip(others, chances.tolist(), changes.tolist(), strict=True)
    return tuple(
        each
        for each, chance, change in rows
        # beyond the size of a parameter the derivative says nothing
        if chance < limit and abs(change) <= each.size and _is_within(each, change)
    )


def _is_within(parameter: ModelParameter, change: float) -> bool:
    return parameter.low < parameter.value + change < parameter.high


def fits_with_others(
    others: Iterable[ModelParameter],
    problems: Sequence[Problem],
    solution: Solution,
    clock: float | None,
    *,
    is_lost: bool,
    flights: int,
) -> tuple[OtherParameter, ...]:
    """The fits with each of ``others`` free, those first whose shifts are smallest.

    Args:
        others: parameters that were not free.
        problems: what is fitted, until one fits: a recording with all impacts, and without
            outliers.
        solution: the fit without these parameters; the fits begin there unless it is lost.
        clock: declared standard deviation of a stamp, s; None if unknown.
        is_lost: whether the solution explains nothing, so that the fits begin with a few moments.
        flights: most that are computed with each of ``others``.
    """
    found = []
    for each in others:
        with problems[0].report.at_most(flights):
            tried = [*_fits(each, problems, solution, clock, is_lost=is_lost)]
        found += sorted(tried, key=_rank)[:1]
    least = min((each.rms for each in found if each.fits), default=0.0)
    alike = [each._replace(fits=each.fits and each.rms <= _ALIKE * least) for each in found]
    return tuple(sorted(alike, key=_rank))


def _rank(other: OtherParameter) -> tuple[bool, float]:
    return not other.fits, other.rms


def _fits(
    parameter: ModelParameter,
    problems: Sequence[Problem],
    solution: Solution,
    clock: float | None,
    *,
    is_lost: bool,
) -> Iterator[OtherParameter]:
    """The fits of the problems with the parameter free, up to the first that fits."""
    near = np.append(solution.y, parameter.value)
    for problem in problems:
        wider = problem._replace(family=problem.family.extended([parameter]))
        try:
            if is_lost:
                first = wider._replace(moments=wider.moments[:_FIRST])
                begun = fit(first)[1]
                if not explained(begun, clock):
                    continue
                near = begun.y
            wider, found = gated(*fit(wider, near))
        except (IdentificationError, ValueError):
            continue  # too few impacts, motions that overflow, or nothing is found in time
        if not found.converged:
            continue
        fits = explained(found, clock)
        if found.scattered is None:
            fits = fits and found.rms < solution.rms
        else:
            fits = fits and not missed_parameters(wider, found, clock, DOUBTED)
        fits = fits and all(each.fits for each in sensor_fits(wider, found))
        values, value = found.y[2 * problem.family.system.n : -1], float(found.y[-1])
        yield OtherParameter(parameter.name, value, parameter.unit, found.rms, fits, values)
        if fits:
            return
