# Copyright 2026 impact_observer developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""The most likely motion whose contacts close at the recorded instants up to errors of the stamps.

Unknown are the initial state with the parameters, ``y``, and the instants ``t``. Given are the
stamps ``s``. The gaps of the contacts that hit vanish at ``t``, and ``t - s`` are the errors of
the clock: the most likely motion has the least sum of their squares. Gauss-Newton steps with
constraints (Bock, Recent advances in parameter identification techniques for O.D.E., 1983)
solve ::

    min |e|^2    subject to    A dy + B (s + e - t) + g = 0

by two orthogonal triangulations, as Paige (Computer solution and perturbation analysis of
generalized linear least squares problems, 1979). The instants are unknowns, not results: a motion
that is switched at given instants forgets its start, so nothing in ``A`` or ``B`` grows with the
length of the recording, however unstable the impacting motion is by itself.

The first guess has the instants fixed at the stamps, and the least gaps there. It is linear in
the initial state.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, optimize

from impact_observer.errors import IdentificationError
from impact_observer.identify.motion import FlightEnd
from impact_observer.identify.shooting import Shot, shoot
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.states import Matrix, Vector

RANK = 1e-9
"""Singular value that counts as zero, relative to the largest: the limit of stamps of 1 ns."""
_STEPS = 40
"""Most Gauss-Newton steps; a fit takes about six."""
_HALVINGS = 12
"""Most halvings of a step."""
_CONVERGED = 1e-2
"""Size of the last step, relative to the standard errors."""
_LOST = 0.02
"""Error of the instants, relative to the time between two, above which a fit is tried again."""
_TRIES = 40
"""Most evaluations of one search for the least gaps; ten are usual."""
_FEW = 12
"""The same where the search begins near the answer."""
_PRIOR_WEIGHT = 0.03
"""Weight of the prior on the parameters in the first search, m for an error of their size."""
_LEAST = 1e-9
"""Smallest scale of gaps, m, and of shifts, s, in a robust fit."""
_CAUCHY = 2.0
"""Scale of the Cauchy weights, over the usual shift."""
_FAR = 3.0
"""Distance of a model's own impacts from the stamps, in times between two, that is too far."""
_FIRST = 8
"""Moments that the second try begins with."""


class Problem(NamedTuple):
    """A recording and the systems that may explain it.

    Attributes:
        family: the systems.
        moments: the recorded impacts, closings and openings, in order.
        start: where the initial state holds, s since the epoch.
        near: initial state and parameters to begin with, shape (2n + p,); None for none.
    """

    family: ParametricFamily
    moments: Sequence[FlightEnd]
    start: float
    near: Vector | None = None

    @property
    def stamps(self) -> Vector:
        """As recorded, s since the epoch, shape (moments,)."""
        return np.array([each.t for each in self.moments])

    @property
    def interval(self) -> float:
        """Median of the time between two moments, s."""
        return float(np.median(np.diff(self.stamps, prepend=self.start)))

    @property
    def counted(self) -> NDArray[np.int64]:
        """Indices of the moments whose stamps are compared: measured impacts and closings."""
        return np.array([k for k, m in enumerate(self.moments) if m.measured and m.hit])

    def shot(self, y: Vector, t: Vector | None = None) -> Shot:
        """The motion of ``y`` switched at ``t``, by default at the stamps."""
        t = self.stamps if t is None else t
        return shoot(self.family, y, self.moments[: t.size], t, self.start)


class Solution(NamedTuple):
    """A motion that explains the recorded instants.

    Attributes:
        y: initial state (q, u) and parameters, shape (2n + p,).
        t: instants, s since the epoch, shape (moments,).
        shot: the motion.
        shifts: instants minus stamps, s, of the moments that count, shape (counted,).
        counted: indices of these moments.
        freedom: degrees of freedom of the shifts.
        root: how far an error of each stamp moves ``y``, shape (2n + p, counted):
            ``root root^T`` times the variance of a stamp is the covariance of ``y``.
        converged: whether the steps converged.
    """

    y: Vector
    t: Vector
    shot: Shot
    shifts: Vector
    counted: NDArray[np.int64]
    freedom: int
    root: Matrix
    converged: bool

    @property
    def rms(self) -> float:
        """Estimated standard deviation of a stamp, s."""
        return _deviation(self.shifts, self.freedom)


def _deviation(shifts: Vector, freedom: int) -> float:
    return float(np.sqrt(np.sum(shifts**2) / max(freedom, 1)))


def start_of(problem: Problem) -> Vector:
    """A first guess of ``y``: the given parameters, the initial state with the smallest gaps."""
    n = problem.family.system.n
    y = np.concatenate([np.zeros(2 * n), problem.family.nominal])
    shot = problem.shot(y)
    y[: 2 * n] = linalg.lstsq(shot.by_start[:, : 2 * n], -shot.gaps, cond=RANK)[0]
    return y


def own_impacts(problem: Problem, y: Vector) -> Shot:
    """The motion of ``y`` switched where its own gaps vanish; at the stamps if that is far away.

    What changes the size of a motion changes its gaps at the stamps, unless they are zero.
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
        if np.max(np.abs(step)) <= _LEAST * problem.interval:
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

    found = _least_gaps(problem, _least_gaps(problem, y, prior=_PRIOR_WEIGHT), robust=robust)
    if error(found) <= _LOST * problem.interval:
        return found
    other, upto = y, _FIRST
    while upto < len(problem.moments):
        other = _least_gaps(problem, other, upto, prior=_PRIOR_WEIGHT)
        upto *= 2
    other = _least_gaps(problem, _least_gaps(problem, other, prior=_PRIOR_WEIGHT), robust=robust)
    return min(found, other, key=error)


def by_gaps_near(problem: Problem, y: Vector) -> Vector:
    """``y`` of the least gaps near another one: of the first moments, then of all."""
    first = _least_gaps(problem, y, _FIRST, prior=_PRIOR_WEIGHT, tries=_FEW)
    return _least_gaps(problem, first, tries=_FEW)


def _least_gaps(
    problem: Problem,
    y: Vector,
    upto: int | None = None,
    *,
    prior: float = 0.0,
    robust: bool = False,
    tries: int = _TRIES,
) -> Vector:
    """``y`` of the least gaps at the first stamps, with the weight ``prior`` on given values."""
    n, family, stamps = problem.family.system.n, problem.family, problem.stamps[:upto]
    low, high = (
        np.concatenate([np.full(2 * n, end), bound])
        for end, bound in zip((-np.inf, np.inf), family.bounds, strict=True)
    )
    pull = prior * np.hstack([np.zeros((family.size, 2 * n)), np.diag(1 / family.sizes)])
    given = np.concatenate([np.zeros(2 * n), family.nominal])
    # Residuals and derivatives are asked for at the same ``y``: one shot serves both.
    shot = lru_cache(1)(lambda y: problem.shot(np.frombuffer(y), stamps))
    usual = float(np.median(np.abs(problem.shot(y, stamps).gaps)))
    found = optimize.least_squares(
        lambda y: np.concatenate([shot(y.tobytes()).gaps, pull @ (y - given)]),
        np.clip(y, low, high),
        jac=lambda y: np.vstack([shot(y.tobytes()).by_start, pull]),
        bounds=(low, high),
        x_scale=np.concatenate([np.ones(2 * n), family.sizes]),
        loss="soft_l1" if robust else "linear",
        f_scale=max(usual, _LEAST),
        xtol=1e-12,
        ftol=1e-12,
        gtol=1e-15,
        max_nfev=tries,
    )
    return np.asarray(found.x)


class Directions(NamedTuple):
    """Directions of initial state and parameters.

    Attributes:
        determined: those that move the gaps, as columns, shape (2n + p, rank).
        undetermined: those that move no gap, shape (2n + p, 2n + p - rank).
        singular: how far each moves the gaps, m, the largest first, shape (2n + p,).
    """

    determined: Matrix
    undetermined: Matrix
    singular: Vector


def directions(problem: Problem, shot: Shot) -> Directions:
    """The directions of ``y`` that the gaps determine, and the others.

    Directions are of unit length where states are in units of the motion's largest, and parameters
    in units of their sizes. Positions count between impacts too: at them a ball is at its floor.
    """
    n = problem.family.system.n
    reach = np.max(np.abs(shot.states), axis=0)
    speed = np.max(reach[n:])
    state = np.repeat([max(np.max(reach[:n]), speed * problem.interval) or 1.0, speed or 1.0], n)
    units = np.concatenate([state, problem.family.sizes])
    found, right = linalg.svd(shot.by_start * units)[1:]
    singular = np.zeros(units.size)
    singular[: found.size] = found
    rank = int(np.count_nonzero(singular > RANK * singular[0]))
    basis = units[:, None] * right.T
    return Directions(basis[:, :rank], basis[:, rank:], singular)


def solved(problem: Problem, y: Vector, *, robust: bool = False) -> Solution:
    """The most likely motion, from that of a ``y`` near it.

    If ``robust`` a few shifts may be large. They count as if they were drawn from a Cauchy
    distribution, by weights that are renewed at every step.

    Raises:
        IdentificationError: fewer hits than unknowns.
    """
    shot, counted = problem.shot(y), problem.counted
    basis = directions(problem, shot).determined
    now = _Iterate(problem, counted, y.copy(), problem.stamps, shot, np.ones(counted.size))
    converged = False
    for _ in range(_STEPS):
        if robust:
            now = now.weighted()
        step = now.step_within(basis)
        converged = step.is_small(now)
        now, length = now.towards(step)
        if converged or length == 0.0:
            break
    step = now.step_within(basis)
    return Solution(
        now.y, now.t, now.shot, now.shifts, counted, step.freedom, step.root, converged
    )


def usual_size(shifts: Vector, freedom: int) -> float:
    """Standard deviation of a stamp that a few large shifts do not change, s.

    As many shifts as there are unknowns can be fitted to zero: the median is that of the others.
    """
    sizes = np.sort(np.abs(shifts))
    middle = (sizes.size - freedom) + (freedom - 1) / 2
    return float(1.4826 * np.interp(middle, np.arange(sizes.size), sizes))


class _Step(NamedTuple):
    """A Gauss-Newton step.

    ``t`` are the new instants, s, and ``penalty`` (s^2/m) is that on a gap in the merit function,
    larger than any multiplier; see ``Solution`` for the others.
    """

    dy: Vector
    t: Vector
    root: Matrix
    freedom: int
    penalty: float

    def is_small(self, now: "_Iterate") -> bool:
        """Whether it is small beside the standard errors."""
        clock = max(_deviation(now.shifts, self.freedom), _LEAST)
        size = clock * np.linalg.norm(self.root, axis=1)
        small = np.abs(self.dy) <= _CONVERGED * size + 1e-12 * np.abs(now.y)
        return bool(np.all(small) and np.max(np.abs(self.t - now.t)) <= clock / 10)


class _Iterate(NamedTuple):
    """A point of the iteration, with weights of the shifts, shape (counted,); see ``Solution``."""

    problem: Problem
    counted: NDArray[np.int64]
    y: Vector
    t: Vector
    shot: Shot
    weights: Vector

    @property
    def shifts(self) -> Vector:
        """Instants minus stamps, s, shape (counted,)."""
        return np.asarray((self.t - self.problem.stamps)[self.counted])

    def weighted(self) -> "_Iterate":
        """The same with smaller weights for shifts that are larger than usual."""
        sizes = np.abs(self.shifts)
        if not np.any(sizes):
            return self
        unknowns = min(self.y.size, sizes.size - 1)
        usual = max(usual_size(sizes, sizes.size - unknowns) * _CAUCHY, _LEAST)
        return self._replace(weights=1 / np.sqrt(1 + (sizes / usual) ** 2))

    def step_within(self, basis: Matrix) -> _Step:
        """``step`` with the parameters fixed that would leave their bounds."""
        low, high = self.problem.family.bounds
        n2 = self.y.size - low.size
        value, fixed = self.y[n2:], np.zeros(low.size, dtype=np.bool_)
        while True:
            rows = n2 + np.flatnonzero(fixed)
            step = self.step(basis @ linalg.null_space(basis[rows]) if rows.size else basis)
            change = step.dy[n2:]
            beyond = ((value <= low) & (change < 0)) | ((value >= high) & (change > 0))
            if not np.any(beyond & ~fixed):
                return step
            fixed |= beyond

    def step(self, basis: Matrix) -> _Step:
        """The Gauss-Newton step in the directions ``basis`` and the instants."""
        problem, shot = self.problem, self.shot
        inserted = [k for k, m in enumerate(problem.moments) if m.hit and not m.measured]
        A = np.hstack([shot.by_start @ basis, shot.by_instant[:, inserted]])
        B = shot.by_instant[:, self.counted]
        d = -(shot.gaps - B @ self.shifts)
        if len(A) < A.shape[1]:
            raise IdentificationError(
                f"{len(A)} impacts for {A.shape[1]} unknowns; record longer, or free less"
            )
        x, e, root = constrained_least_squares(A, B / self.weights, d)
        e = e / self.weights
        r = basis.shape[1]
        t = self.t.copy()
        t[self.counted] = problem.stamps[self.counted] + e
        t[inserted] += x[r:]
        multipliers = linalg.lstsq(B.T, 2 * e * self.weights**2)[0]
        penalty = 2 * float(np.max(np.abs(multipliers), initial=0.0)) + 1e-30
        freedom = len(self.counted) - A.shape[1] + len(A) - np.linalg.matrix_rank(B)
        return _Step(basis @ x[:r], t, basis @ root[:r], freedom, penalty)

    def towards(self, step: _Step) -> tuple["_Iterate", float]:
        """The first of 1, 1/2, 1/4 .. of ``step`` that lowers the merit function, and which."""
        before = self.merit(step.penalty)
        low, high = self.problem.family.bounds
        n2 = self.y.size - low.size
        length = 1.0
        for _ in range(_HALVINGS):
            y, t = self.y + length * step.dy, self.t + length * (step.t - self.t)
            y[n2:] = np.clip(y[n2:], low, high)
            found = self._replace(y=y, t=t, shot=self.problem.shot(y, t))
            if found.merit(step.penalty) <= before * (1 + 1e-6) + 1e-22:
                return found, length
            length /= 2
        return self, 0.0

    def merit(self, penalty: float) -> float:
        """Sum of the squared shifts, and of the gaps with their penalty."""
        return float(
            np.sum((self.weights * self.shifts) ** 2) + penalty * np.sum(np.abs(self.shot.gaps))
        )


def constrained_least_squares(A: Matrix, B: Matrix, d: Vector) -> tuple[Vector, Vector, Matrix]:
    """``x`` and the least ``e`` with ``A x + B e = d``.

    Args:
        A: of full column rank, shape (r, k).
        B: shape (r, c).
        d: shape (r,).

    Returns:
        ``x``, ``e``, and how far each of ``e`` moves ``x``, shape (k, c): a root of the covariance
        of ``x`` where that of ``e`` is one.
    """
    k = A.shape[1]
    Q, R = linalg.qr(A)
    range_of_A, left = Q[:, :k].T, Q[:, k:].T @ B
    e = linalg.lstsq(left, Q[:, k:].T @ d)[0] if left.size else np.zeros(B.shape[1])
    free = linalg.null_space(left) if left.size else np.eye(B.shape[1])
    x = linalg.solve_triangular(R[:k], range_of_A @ (d - B @ e))
    return x, e, linalg.solve_triangular(R[:k], range_of_A @ B @ free) @ free.T
