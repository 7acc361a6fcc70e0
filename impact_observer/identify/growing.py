# SPDX-License-Identifier: Apache-2.0
"""A fit that begins with the first impacts alone, at phases all around the circle, and grows.

A harmonic whose phase is unknown makes a fit fail that begins half a turn off. Switched at the
stamps, a motion is linear in its initial state, so the gaps that are left at a phase take one
least-squares solution: a grid of phases is searched at the stamps of the first impacts, the fit
begins where least is left, and each further fit, of half again as many, begins at the one before.
"""

from collections.abc import Callable, Iterator
from itertools import product
from math import inf
from typing import NamedTuple

import numpy as np

from impact_observer.errors import IdentificationError
from impact_observer.identify.first_guess import least_gaps_from, state_of_least_gaps
from impact_observer.identify.least_squares import weighed
from impact_observer.identify.problem import Problem, Solution
from impact_observer.model.free_parameters import is_phase
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.states import Vector

_SPARE = 6
"""Impacts of the first fit beyond the unknowns."""
_FIRST = 12
"""Least number of impacts of the first fit."""
_GRID = 64
"""About how many combinations of phases are tried; of a single phase a quarter."""
_AROUND = {1: 12, 2: 6}
"""Phases on the circle at which a motion is smoothed, by the number of free phases."""
_BEST = 4
"""Most of them from which a fit begins."""
Explains = Callable[[Problem, Solution], bool]


class Grown(NamedTuple):
    """How far fits of more and more impacts came.

    Attributes:
        y: initial state and parameters that explain the most impacts, shape (2n + p,).
        moments: how many of the recording's that are.
        end: the last of them, s since the epoch.
    """

    y: Vector
    moments: int
    end: float


def grown(problem: Problem, explains: Explains, report: Callable[[str], None]) -> Grown | None:
    """The fit that explains the most impacts from the first one on; None if no fit does.

    ``explains`` decides whether a fit is one, ``report`` receives what is being tried.
    """
    size = max(_FIRST, problem.unknowns + _SPARE)
    best: Grown | None = None
    starts = [*_starts(first_of(problem, size))]
    for number, start in enumerate(starts):
        report(f"first {size} impacts, start {number + 1} of {len(starts)}")
        for reached in _growing(problem, start, size, explains, report):
            if best is None or reached.moments > best.moments:
                best = reached
        if best is not None and best.moments == len(problem.moments):
            break
    return best


def first_of(problem: Problem, count: int) -> Problem:
    """The problem of the first moments alone, with the samples until the next one."""
    if count >= len(problem.moments):
        return problem
    end = problem.moments[count].t
    sensors = tuple(each.which(each.t < end) for each in problem.sensors)
    return problem._replace(moments=problem.moments[:count], sensors=sensors)


def stage_of(problem: Problem) -> str:
    """What ``grown`` tries, in words."""
    names = [problem.family.names[k] for k in phases_of(problem.family)]
    around = f", {' and '.join(names)} around the circle" if names else ""
    return f"more and more impacts{around}"


def phases_of(family: ParametricFamily) -> list[int]:
    """Indices of the free parameters that are phases."""
    return [k for k, name in enumerate(family.names) if is_phase(name)]


def phase_changes(family: ParametricFamily, count: int | None = None) -> Iterator[Vector]:
    """Changes of the parameters, shape (p,), that put phases all around the circle; first none.

    Each free phase has ``count`` places; None for as many as motions are smoothed at, which of
    three phases and more is one.
    """
    free = phases_of(family)
    places = _AROUND.get(len(free), 1) if count is None else count
    steps = np.linspace(0.0, 2 * np.pi, places, endpoint=False)
    for each in product(steps, repeat=len(free)):
        change = np.zeros(family.size)
        change[free] = each
        yield change


def _starts(problem: Problem) -> Iterator[Vector]:
    """Initial states and parameters, shape (2n + p,) each, those first whose gaps are least."""
    family, free = problem.family, len(phases_of(problem.family))
    count = _GRID // 4 if free == 1 else max(round(_GRID ** (1 / max(free, 1))), 2)
    rows = list[tuple[float, int, Vector]]()
    for change in phase_changes(family, count):
        y = np.concatenate([np.zeros(2 * family.system.n), family.nominal + change])
        y, left = state_of_least_gaps(problem, y)
        rows.append((left if np.isfinite(left) else inf, len(rows), y))
    yield from (y for _, _, y in sorted(rows)[:_BEST])


def _growing(
    problem: Problem,
    start: Vector,
    size: int,
    explains: Explains,
    report: Callable[[str], None],
) -> Iterator[Grown]:
    """The fits of more and more impacts, each half again as many, up to the last that is one."""
    y, is_first = start, True
    while True:
        part = first_of(problem, size)
        try:
            y = least_gaps_from(part, y) if is_first else y
            reweighed, solution = weighed(part, y, robust=not is_first)
        except (IdentificationError, ValueError):
            return  # too few impacts, or a motion that overflows
        if not explains(reweighed, solution):
            return
        y, is_first = solution.y, False
        yield Grown(y, len(part.moments), part.moments[-1].t)
        if size >= len(problem.moments):
            return
        size += size // 2
        report(f"first {min(size, len(problem.moments))} impacts")
