# SPDX-License-Identifier: Apache-2.0
"""The search for the motion that explains a recording, and for the outliers of the recording."""

from collections.abc import Mapping

import numpy as np
from scipy import linalg

from impact_observer.errors import IdentificationError
from impact_observer.filter.square_root import sparse_basis
from impact_observer.identify.first_guess import (
    by_gaps,
    directions,
    own_impacts,
    start_of,
)
from impact_observer.identify.least_squares import is_lost, weighed
from impact_observer.identify.outliers import outliers_by_motion
from impact_observer.identify.problem import Problem, Solution
from impact_observer.identify.recorded_impacts import Recording
from impact_observer.identify.residuals import HeldBack
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.states import Matrix, Vector

_ROUNDS = 12
"""Most rounds of rejecting and inserting impacts."""
_HOPELESS = 4
"""Fits in a row that do not converge, after which no more rounds follow."""
_LOST = 2
"""Lost fits, after which no more follow."""
_STILL = 1e-9
"""Contact speed of no motion, m/s."""
_FEWEST = 3
"""Fewest impacts that are held back, and fewest degrees of freedom of the fit of the others."""
_PART = 1e-3
"""Smallest term of a combination, relative to the largest."""
_GATINGS = 5
"""Most rounds of rejecting samples."""


def gated(problem: Problem, solution: Solution) -> tuple[Problem, Solution]:
    """The fit without the samples that gates reject."""
    for _ in range(_GATINGS):
        sensors = tuple(
            each.within_gate(rows.errors)
            for each, rows in zip(problem.sensors, solution.shot.sensors, strict=True)
        )
        if all(a.t.size == b.t.size for a, b in zip(sensors, problem.sensors, strict=True)):
            break
        problem, solution = weighed(problem._replace(sensors=sensors), solution.y)
    return problem, solution


def last_impacts(problem: Problem, solution: Solution, share: float) -> HeldBack | None:
    """The last impacts as the others predict them; None if one of the parts has too few."""
    count = int(share * solution.counted.size)
    if not problem.family.size or count < _FEWEST or solution.freedom - count < _FEWEST:
        return None
    moments = problem.moments[: solution.counted[-count]]
    if problem.sensors:  # samples need the impacts before them, whenever these were
        later = {*solution.counted[-count:].tolist()}
        moments = [
            moment._replace(measured=False) if k in later else moment
            for k, moment in enumerate(problem.moments)
        ]
    try:
        _, first = fit(problem._replace(moments=moments, is_declared=True), solution.y)
    except IdentificationError:
        return None
    return HeldBack.between(first, solution)


def without_outliers(
    recording: Recording,
    family: ParametricFamily,
    clock: float | None,
    near: Vector | None = None,
) -> tuple[Recording, Problem, Solution]:
    """The recording in which the fitted motion finds no further outlier, and the fit.

    The search begins near initial state and parameters ``near``, if given. ``clock`` is the
    standard deviation of a stamp, s; None if unknown.
    """
    problem, solution = fit(recording.problem(family), near, robust=True)
    failures = lost = 0
    for round_ in range(_ROUNDS):
        failures = 0 if solution.converged else failures + 1
        lost += is_lost(problem, solution.shifts, solution.freedom)
        if lost == _LOST:
            return recording, problem, solution._replace(converged=False)
        after = outliers_by_motion(recording, problem, solution, clock)
        if failures == _HOPELESS or (after.rejected, after.inserted) == (
            recording.rejected,
            recording.inserted,
        ):
            break
        recording = after
        recording.report(
            f"round {round_ + 1} of at most {_ROUNDS}, {recording.outliers} outliers, shifts"
            f" {solution.rms:.2g} s"
        )
        problem, solution = fit(recording.problem(family), solution.y, robust=True)
    return recording, *fit(recording.problem(family), solution.y)


def fit(
    problem: Problem, near: Vector | None = None, *, robust: bool = False
) -> tuple[Problem, Solution]:
    """The motion that explains a recording best, searched near ``near``, else from the least gaps.

    ``robust`` says that some impacts may be wrong.
    """
    unknowns = problem.unknowns
    hits = sum(len(each.hit) for each in problem.moments if each.measured)
    samples = sum(each.t.size for each in problem.sensors)
    declared = len(problem.by_prior)
    if hits + samples + declared <= unknowns:
        beside = f" and {samples} samples" if problem.sensors else ""
        beside += f" and {declared} declared deviations" if declared else ""
        raise IdentificationError(
            f"{hits} impacts{beside} for {unknowns} unknowns, {problem.family.size} of them"
            " parameters; expected more: record longer, or free less"
        )
    if near is not None:
        reweighed, solution = weighed(problem, near, robust=robust)
        if solution.converged or problem.instants:
            return reweighed, solution
    y = start_of(problem)
    shot = problem.shot(y)
    if np.max(np.abs(shot.speeds)) <= _STILL:
        raise IdentificationError(
            "no force and no gap determines the size of the motion, which has the same impacts at"
            " any size; expected a gap that is not 0, or a force"
        )
    if lost := combinations_of(problem, directions(problem, own_impacts(problem, y)).undetermined):
        words = "; ".join(combination(each) for each in lost)
        one = all(len(each) == 1 for each in lost)
        raise IdentificationError(
            f"{words}: with a suitable initial state no impact moves by that, so impact times do"
            f" not determine it; hold {'it' if one else 'one of them'} fixed"
        )
    return weighed(problem, by_gaps(problem, y, robust=robust), robust=robust)


def combinations_of(problem: Problem, undetermined: Matrix) -> tuple[dict[str, float], ...]:
    """Combinations of parameters that span the undetermined directions, shape (2n + p, k)."""
    family = problem.family
    part = undetermined[2 * family.system.n :] / family.sizes[:, None]
    if not part.size or np.max(np.abs(part)) <= _PART:
        return ()
    # Directions of the parameters alone: the initial state may change in any way.
    left, singular, _ = linalg.svd(part, full_matrices=False)
    combinations = []
    for direction in sparse_basis(left[:, singular > _PART].T):
        largest = np.max(np.abs(direction))
        combinations.append(
            {
                name: float(value * size / largest)
                for name, value, size in zip(family.names, direction, family.sizes, strict=True)
                if abs(value) > _PART * largest
            }
        )
    return tuple(combinations)


def combination(terms: Mapping[str, float]) -> str:
    """A combination in words, such as ``+1 mass-scale +1 stiffness-scale``."""
    return " ".join(f"{change:+.3g} {name}" for name, change in terms.items())
