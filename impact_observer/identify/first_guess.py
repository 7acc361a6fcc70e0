# SPDX-License-Identifier: Apache-2.0
"""The start of a fit: the motion of the least gaps at the stamps.

The search is linear in the initial state, so nobody has to guess one.
"""

from functools import lru_cache
from itertools import count
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, optimize

from impact_observer.identify.problem import LEAST, Problem
from impact_observer.identify.shooting import Shot
from impact_observer.model.system import unit_of
from impact_observer.states import Matrix, Vector

RANK = 1e-9
"""Singular value that counts as zero, relative to the largest: the limit of stamps of 1 ns."""
_LOST = 0.02
"""Error of the instants, relative to the time between two, above which a fit is tried again."""
_TRIES = 40
"""Most evaluations of one search for the least gaps; ten are usual."""
_PRIOR_WEIGHT = 0.03
"""Weight of the prior on the parameters in the first search, m for an error of their size."""
_START_WEIGHT = 1e-6
"""Weight of a start of zero, m for 1 m or m/s: what moves no gap stays small."""
_FAR = 3.0
"""Distance of a model's own impacts from the stamps, in times between two, that is too far."""
_PART = 1e-6
"""Least part of an undetermined direction that is no rounding."""
_FIRST = 8
"""Moments that the second try begins with."""


def start_of(problem: Problem) -> Vector:
    """A first guess of ``y``: the given parameters, the initial state with the smallest gaps."""
    n = problem.family.system.n
    at_rest = np.concatenate([np.zeros(2 * n), problem.family.nominal])
    return state_of_least_gaps(problem, at_rest)[0]


def state_of_least_gaps(problem: Problem, y: Vector) -> tuple[Vector, float]:
    """``y`` with the initial state of the least gaps, and the gaps that are left, m.

    ``y`` is given with an initial state of zero, shape (2n + p,).
    """
    state = slice(2 * problem.family.system.n)
    shot = problem.shot(y)
    values, by_start = problem.gaps_of(shot, problem.moved(shot))
    change = linalg.lstsq(by_start[:, state], -values, cond=RANK)[0]
    left = float(np.linalg.norm(values + by_start[:, state] @ change))
    return np.concatenate([change, y[change.size :]]), left


def own_impacts(problem: Problem, y: Vector) -> Shot:
    """The motion of ``y`` switched where its own gaps vanish; at the stamps if these are far away.

    A change of the motion's size changes the gaps at the stamps, unless these gaps are zero.
    """
    at_stamps = shot = problem.shot(y)
    t = problem.stamps
    for _ in range(_TRIES):
        step = linalg.lstsq(shot.by_instant, shot.gaps, cond=RANK)[0]
        t = t - step
        if np.max(np.abs(t - problem.stamps)) > _FAR * problem.interval:
            return at_stamps
        with np.errstate(over="ignore", invalid="ignore"):
            shot = problem.shot(y, t)
        if not (np.all(np.isfinite(shot.gaps)) and np.all(np.isfinite(shot.by_instant))):
            return at_stamps
        if np.max(np.abs(step)) <= LEAST * problem.interval:
            return shot
    return at_stamps


def by_gaps(problem: Problem, y: Vector, *, robust: bool = False) -> Vector:
    """``y`` of the least gaps at the stamps, from all moments or from more and more of them.

    The search begins at ``y``, with a weak prior on the parameters: far from the answer unbounded
    motions would make small gaps too. If ``robust`` a few gaps may be large.
    """
    speed = float(np.linalg.norm(problem.shot(y).speeds))

    def error(y: Vector) -> float:
        """Gaps at the stamps as an error of the instants, s."""
        return float(np.linalg.norm(problem.shot(y).gaps) / speed)

    at_once = _least_gaps(problem, _least_gaps(problem, y, prior=_PRIOR_WEIGHT), robust=robust)
    if error(at_once) <= _LOST * problem.interval:
        return at_once
    stepwise, upto = y, _FIRST
    while upto < len(problem.moments):
        stepwise = _least_gaps(problem, stepwise, upto, prior=_PRIOR_WEIGHT)
        upto *= 2
    stepwise = _least_gaps(
        problem, _least_gaps(problem, stepwise, prior=_PRIOR_WEIGHT), robust=robust
    )
    return min(at_once, stepwise, key=error)


def least_gaps_from(problem: Problem, y: Vector) -> Vector:
    """``y`` of the least gaps near another one, whatever the nominal parameters are."""
    return _least_gaps(problem, y)


def _least_gaps(
    problem: Problem,
    y: Vector,
    upto: int | None = None,
    *,
    prior: float = 0.0,
    robust: bool = False,
) -> Vector:
    """``y`` of the least gaps at the first stamps, with the weight ``prior`` on given values.

    Declared deviations count beside this weight.
    """
    n, family, stamps = problem.family.system.n, problem.family, problem.stamps[:upto]
    low, high = (
        np.concatenate([np.full(2 * n, end), bound])
        for end, bound in zip((-np.inf, np.inf), family.bounds, strict=True)
    )
    sizes = np.concatenate([np.full(2 * n, _START_WEIGHT), prior / family.sizes])
    pull = np.diag(sizes)
    given = np.concatenate([np.zeros(2 * n), family.nominal])
    # The solver asks for residuals and derivatives at the same ``y``: one shot serves both.
    begin = problem.shot(y, stamps)
    usual, moved = float(np.median(np.abs(begin.gaps))), problem.moved(begin)
    pull = np.vstack([pull, moved * problem.by_prior])
    trials, unit = count(1), unit_of("m", family.system.unit)

    @lru_cache(1)
    def made(y: bytes) -> tuple[Vector, Matrix]:
        gaps, by_start = problem.gaps_of(problem.shot(np.frombuffer(y), stamps), moved)
        size = float(np.sqrt(np.mean(gaps**2)))
        problem.report(f"first guess {next(trials)} of at most {_TRIES}, gaps {size:.2g} {unit}")
        return gaps, by_start

    minimum = optimize.least_squares(
        lambda y: np.concatenate([made(y.tobytes())[0], pull @ (y - given)]),
        np.clip(y, low, high),
        jac=lambda y: np.vstack([made(y.tobytes())[1], pull]),
        bounds=(low, high),
        x_scale=np.concatenate([np.ones(2 * n), family.sizes]),
        loss="soft_l1" if robust else "linear",
        f_scale=max(usual, LEAST),
        xtol=1e-12,
        ftol=1e-12,
        gtol=1e-15,
        max_nfev=_TRIES,
    )
    return np.asarray(minimum.x)


class Directions(NamedTuple):
    """Directions of initial state and parameters.

    Attributes:
        determined: directions that move the gaps, or that have a prior, as columns, shape
            (2n + p, rank).
        undetermined: directions that move no gap and have no prior, shape (2n + p, 2n + p - rank).
        singular: how far each moves the gaps, m, the largest first, shape (2n + p,).
        units: of initial state and parameters, shape (2n + p,).
    """

    determined: Matrix
    undetermined: Matrix
    singular: Vector
    units: Vector

    @property
    def lost(self) -> NDArray[np.bool_]:
        """Which of initial state and parameters no gap determines, shape (2n + p,)."""
        parts = np.abs(self.undetermined) / self.units[:, None]
        return np.asarray(np.max(parts, axis=1, initial=0.0) > _PART)


def directions(problem: Problem, shot: Shot) -> Directions:
    """The directions of ``y`` that gaps and prior determine, and the others.

    Directions are of unit length where states are in units of the motion's largest, and parameters
    in units of their sizes. Positions between impacts count too: at impacts a
    ball is at the floor.
    """
    n = problem.family.system.n
    reach = np.max(np.abs(shot.states), axis=0)
    speed = np.max(reach[n:])
    state = np.repeat([max(np.max(reach[:n]), speed * problem.interval) or 1.0, speed or 1.0], n)
    units = np.concatenate([state, problem.family.sizes])
    rows = problem.gaps_of(shot, problem.moved(shot))[1]
    inserted = [k for k, m in enumerate(problem.moments) if m.hit and not m.measured]
    if inserted:  # a hit without a stamp determines its own instant alone
        moved = np.zeros((len(rows), len(inserted)))
        moved[: shot.gaps.size] = shot.by_instant[:, inserted]
        rows = linalg.null_space(moved.T).T @ rows
    rows = rows * units
    if len(prior := problem.by_prior):  # however weak, a prior leaves nothing undetermined
        own = linalg.orth((prior * units).T).T
        rows = np.vstack([rows, linalg.norm(rows) * own])
    values, right = linalg.svd(rows)[1:]
    singular = np.zeros(units.size)
    singular[: values.size] = values
    rank = int(np.count_nonzero(singular > RANK * singular[0]))
    basis = units[:, None] * right.T
    return Directions(basis[:, :rank], basis[:, rank:], singular, units)
