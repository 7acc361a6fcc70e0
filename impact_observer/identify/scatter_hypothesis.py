# SPDX-License-Identifier: Apache-2.0
"""When the hypothesis that impulses scatter is tested, and when it is accepted.

An error of each impulse explains much: also a part of what a wrong model does. So the hypothesis
is accepted only if innovations are white and normal, and if impulses scatter no more than those of
real contacts do. Whether another parameter explains a part is tested as of any other fit.
"""

import numpy as np
from scipy import stats

from impact_observer.identify.problem import ROUNDED, Problem, Solution
from impact_observer.identify.residuals import DOUBTED, explained, independence

_IMPACTS = 6
"""Least number of impacts that may show a scatter, over the number of unknowns."""
_FEWEST = 40
"""Least number of these impacts."""
_SCATTER = 0.03
"""Largest deviation of the relative error of an impulse: of a restitution of 0.5, 0.045."""
_FIRST = 0.01
"""Deviation of the relative error of an impulse with which a fit begins."""
_GAIN = 20.0
"""Least gain of twice the logarithm of the likelihood: by chance one in 100 000."""


def may_scatter(problem: Problem) -> bool:
    """Whether the impacts of a problem are enough, and of a kind, to show a scatter."""
    single = all(len(each.hit) == 1 and not each.held for each in problem.moments)
    enough = problem.counted.size >= max(_IMPACTS * problem.unknowns, _FEWEST)
    return single and enough and not problem.sensors


def with_scatter(problem: Problem, clock: float | None, shown: float) -> Problem:
    """The problem with impulses that scatter, to begin with.

    Errors of the ``clock`` are declared, s; if None, the search begins with the half of the shifts
    of another fit, ``shown``, s.
    """
    known = max(shown / 2 if clock is None else clock, ROUNDED)
    return problem._replace(
        clock=known, is_declared=clock is not None, least_clock=ROUNDED, scatter=_FIRST
    )


def is_scatter_accepted(solution: Solution, clock: float | None) -> bool:
    """Whether a fit with the hypothesis that impulses scatter is accepted.

    ``clock`` is the declared standard deviation of a stamp, s; None if unknown.
    """
    found = solution.scattered
    if found is None or not (solution.is_outside and explained(solution, clock)):
        return False
    shown, errors = found.shown, found.innovations
    largest = float(np.max(np.abs(errors))) / shown.clock
    normal = 2 * errors.size * stats.norm.sf(largest)
    likely = min(normal, independence(errors)) >= DOUBTED
    return shown.scatter <= _SCATTER and shown.gain >= _GAIN and likely
