"""The most likely motion whose contacts close at the recorded instants but for errors of stamps.

Unknown are the initial state with the parameters, ``y``, and the instants ``t``; known are the
stamps ``s``. The gaps of what hits vanish at ``t``, and the shifts ``t - s`` are the errors of the
clock: the most likely motion is that of the least sum of their squares. Gauss and Newton's steps
with constraints (Bock, Recent advances in parameter identification techniques for O.D.E., 1983)
solve ::

    min |s + e - s|^2    subject to    A dy + B (s + e - t) + g = 0

by two orthogonal triangulations, as Paige (Computer solution and perturbation analysis of
generalized linear least squares problems, 1979). The instants are unknowns, not results: a motion
that is switched where it is told to forgets its start, so nothing in ``A`` or ``B`` grows with the
length of the recording, however unstable the impacting motion is by itself.

What begins it is the same with the instants fixed at the stamps, which asks for the least gaps. It
is linear in the initial state.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, optimize

from impact_observer.errors import IdentificationError
from impact_observer.identify.motion import FlightEnd, Shot, shoot
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.states import Matrix, Vector

RANK = 1e-9
"""Singular value that counts as none, relative to the largest: what stamps of 1 ns could tell."""
_STEPS = 40
"""Most steps; a fit takes about six."""
_HALVINGS = 12
_CONVERGED = 1e-2
"""Last step, relative to the standard errors."""
_LOST = 0.02
"""Error of the instants, relative to the time between two, that asks for another try."""
_TRIES = 40
"""Most motions that one round looks at; ten are usual."""
_HELD = 0.03
"""Weight that holds parameters back, m for an error of their size."""
_LEAST = 1e-9
"""Least gap that is told from none, m, and least shift, s, where some may be large."""
_FORGIVEN = 2.0
"""Usual shifts from which on one counts for less (Cauchy)."""
_FIRST = 8
"""Moments that the other try begins with."""


class Problem(NamedTuple):
    """What is to be explained.

    Attributes:
        family: systems that may explain it.
        moments: what was recorded, in order.
        start: where the initial state holds, s since the epoch.
    """

    family: ParametricFamily
    moments: Sequence[FlightEnd]
    start: float

    @property
    def stamps(self) -> Vector:
        """As recorded, s since the epoch, shape (moments,)."""
        return np.array([each.t for each in self.moments])

    @property
    def interval(self) -> float:
        """Usual time between two moments, s."""
        return float(np.median(np.diff(self.stamps, prepend=self.start)))

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
        shifts: by which stamps are early, s, of the moments that count, shape (counted,).
        counted: indices of those: heard, and not grazing.
        freedom: how many shifts there are beyond what the unknowns took up.
        root: ``root root^T`` times the variance of a stamp is the covariance of ``y``.
        converged: whether the steps came to an end.
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
        return float(np.sqrt(np.sum(self.shifts**2) / max(self.freedom, 1)))


def start_of(problem: Problem) -> Vector:
    """Where to begin: the given parameters, and the initial state of the least gaps."""
    n = problem.family.system.n
    y = np.concatenate([np.zeros(2 * n), problem.family.nominal])
    shot = problem.shot(y)
    y[: 2 * n] = linalg.lstsq(shot.by_start[:, : 2 * n], -shot.gaps, cond=RANK)[0]
    return y


def by_gaps(problem: Problem, y: Vector, *, robust: bool = False) -> Vector:
    """``y`` of the least gaps at the stamps; by and by, where not all at once.

    A first round holds the parameters back a little: far from the answer motions without end
    would make small gaps too.

    Args:
        problem: what is to be explained.
        y: where to begin; see ``start_of``.
        robust: whether a few gaps may be large.
    """
    speed = float(np.linalg.norm(problem.shot(y).speeds))
    found = _least_gaps(problem, _least_gaps(problem, y, None, _HELD), robust=robust)
    if _error(problem, found, speed) <= _LOST * problem.interval:
        return found
    other, upto = y, _FIRST
    while upto < len(problem.moments):
        other = _least_gaps(problem, other, upto, _HELD)
        upto *= 2
    other = _least_gaps(problem, _least_gaps(problem, other, None, _HELD), robust=robust)
    return min(found, other, key=lambda each: _error(problem, each, speed))


def _least_gaps(
    problem: Problem,
    y: Vector,
    upto: int | None = None,
    held: float = 0.0,
    *,
    robust: bool = False,
) -> Vector:
    """``y`` of the least gaps at the first stamps, the parameters ``held`` back."""
    n, family, stamps = problem.family.system.n, problem.family, problem.stamps[:upto]
    low, high = (
        np.concatenate([np.full(2 * n, end), bound])
        for end, bound in zip((-np.inf, np.inf), family.bounds, strict=True)
    )
    back = held * np.hstack([np.zeros((family.size, 2 * n)), np.diag(1 / family.sizes)])

    start = np.concatenate([np.zeros(2 * n), family.nominal])
    shot = lru_cache(1)(lambda y: problem.shot(np.frombuffer(y), stamps))
    usual = float(np.median(np.abs(problem.shot(y, stamps).gaps)))
    found = optimize.least_squares(
        lambda y: np.concatenate([shot(y.tobytes()).gaps, back @ (y - start)]),
        np.clip(y, low, high),
        jac=lambda y: np.vstack([shot(y.tobytes()).by_start, back]),
        bounds=(low, high),
        x_scale=np.concatenate([np.ones(2 * n), family.sizes]),
        loss="soft_l1" if robust else "linear",
        f_scale=max(usual, _LEAST),
        xtol=1e-12,
        ftol=1e-12,
        gtol=1e-15,
        max_nfev=_TRIES,
    )
    return np.asarray(found.x)


def _error(problem: Problem, y: Vector, speed: float) -> float:
    """How far the gaps at the stamps are from zero, s, where contacts have that speed, m/s."""
    return float(np.linalg.norm(problem.shot(y).gaps) / speed)


class Directions(NamedTuple):
    """Directions of initial state and parameters.

    Attributes:
        told: those that gaps show, as columns, shape (2n + p, rank).
        unknown: those that no gap shows, shape (2n + p, 2n + p - rank).
        singular: how far each moves the gaps, m, the largest first, shape (2n + p,).
    """

    told: Matrix
    unknown: Matrix
    singular: Vector


def directions(problem: Problem, shot: Shot) -> Directions:
    """What the gaps can tell, and what they cannot.

    Directions are of unit length where states are in units of the motion's largest, and parameters
    of their sizes.
    """
    n = problem.family.system.n
    reach = np.max(np.abs(shot.states), axis=0)
    state = np.repeat([np.max(reach[:n]) or 1.0, np.max(reach[n:]) or 1.0], n)
    units = np.concatenate([state, problem.family.sizes])
    found, right = linalg.svd(shot.by_start * units)[1:]
    singular = np.zeros(units.size)
    singular[: found.size] = found
    rank = int(np.count_nonzero(singular > RANK * singular[0]))
    basis = units[:, None] * right.T
    return Directions(basis[:, :rank], basis[:, rank:], singular)


def solved(problem: Problem, y: Vector, *, robust: bool = False) -> Solution:
    """The most likely motion, from one near it.

    Args:
        problem: what is to be explained.
        y: where to begin; see ``by_gaps``.
        robust: whether a few shifts may be large: they count as if they were drawn from a Cauchy
            distribution, by weights that are drawn anew at every step.

    Raises:
        IdentificationError: fewer hits than unknowns.
    """
    shot = problem.shot(y)
    basis = directions(problem, shot).told
    y = y.copy()
    counts = _telling(problem)
    now = _State(problem, counts, y, problem.stamps, shot, np.ones(counts.size))
    converged = False
    for _ in range(_STEPS):
        if robust:
            now = now.weighted()
        step = now.step_within(basis)
        converged = step.is_nothing(now)
        now, length = now.towards(step)
        if converged:
            break
        if length == 0.0:
            break
    step = now.step_within(basis)
    left, root = step.freedom, step.root
    return Solution(now.y, now.t, now.shot, now.shifts, counts, left, root, converged)


def _telling(problem: Problem) -> NDArray[np.int64]:
    """Indices of the moments whose stamps are compared."""
    return np.array([k for k, each in enumerate(problem.moments) if each.heard and each.hit])


def usual_size(shifts: Vector, freedom: int) -> float:
    """Standard deviation of a stamp that a few large shifts do not change, s.

    As many shifts as there are unknowns can be made nothing: the median is that of the others.
    """
    sizes = np.sort(np.abs(shifts))
    middle = (sizes.size - freedom) + (freedom - 1) / 2
    return float(1.4826 * np.interp(middle, np.arange(sizes.size), sizes))


class _Step(NamedTuple):
    """A step of Gauss and Newton.

    Attributes:
        dy: of initial state and parameters, shape (2n + p,).
        t: the new instants, s, shape (moments,).
        root: of the covariance of ``y``; see ``Solution``.
        freedom: likewise.
        price: of a metre of gap, s^2, that no shift is worth.
    """

    dy: Vector
    t: Vector
    root: Matrix
    freedom: int
    price: float

    def is_nothing(self, now: "_State") -> bool:
        """Whether it is nothing beside what errors of stamps do."""
        clock = max(now.rms(self.freedom), _LEAST)
        size = clock * np.linalg.norm(self.root, axis=1)
        small = np.abs(self.dy) <= _CONVERGED * size + 1e-12 * np.abs(now.y)
        return bool(np.all(small) and np.max(np.abs(self.t - now.t)) <= clock / 10)


class _State(NamedTuple):
    """Where the steps have come to; see ``Solution``.

    Attributes:
        weights: of the shifts, shape (counted,).
    """

    problem: Problem
    counted: NDArray[np.int64]
    y: Vector
    t: Vector
    shot: Shot
    weights: Vector

    @property
    def shifts(self) -> Vector:
        """By which stamps are early, s, shape (counted,)."""
        return np.asarray((self.t - self.problem.stamps)[self.counted])

    def weighted(self) -> "_State":
        """The same; what is shifted by more than usual counts for less."""
        sizes = np.abs(self.shifts)
        if not np.any(sizes):
            return self
        taken = sum(each.heard and bool(each.hit) for each in self.problem.moments)
        unknowns = min(self.y.size, taken - 1)
        usual = max(usual_size(sizes, taken - unknowns) * _FORGIVEN, _LEAST)
        return self._replace(weights=1 / np.sqrt(1 + (sizes / usual) ** 2))

    def rms(self, freedom: int) -> float:
        """As of ``Solution``."""
        return float(np.sqrt(np.sum(self.shifts**2) / max(freedom, 1)))

    def step_within(self, basis: Matrix) -> _Step:
        """``step`` with parameters held that stand at a bound and would go beyond it."""
        low, high = self.problem.family.bounds
        n2 = self.y.size - low.size
        value, held = self.y[n2:], np.zeros(low.size, dtype=np.bool_)
        while True:
            rows = n2 + np.flatnonzero(held)
            step = self.step(basis @ linalg.null_space(basis[rows]) if rows.size else basis)
            change = step.dy[n2:]
            beyond = ((value <= low) & (change < 0)) | ((value >= high) & (change > 0))
            if not np.any(beyond & ~held):
                return step
            held |= beyond

    def step(self, basis: Matrix) -> _Step:
        """Gauss and Newton's step in the directions ``basis`` and the instants."""
        problem, shot = self.problem, self.shot
        missed = [k for k, m in enumerate(problem.moments) if m.hit and not m.heard]
        A = np.hstack([shot.by_start @ basis, shot.by_instant[:, missed]])
        B = shot.by_instant[:, self.counted]
        shift = (problem.stamps - self.t)[self.counted]
        d = -(shot.gaps + B @ shift)
        if len(A) < A.shape[1]:
            raise IdentificationError(
                f"{len(A)} impacts for {A.shape[1]} unknowns; record longer, or free less"
            )
        x, e, root = least(A, B / self.weights, d)
        e = e / self.weights
        r = basis.shape[1]
        t = self.t.copy()
        t[self.counted] = problem.stamps[self.counted] + e
        t[missed] += x[r:]
        price = float(np.max(np.abs(linalg.lstsq(B.T, 2 * e * self.weights**2)[0]), initial=0.0))
        freedom = len(self.counted) - A.shape[1] + len(A) - np.linalg.matrix_rank(B)
        return _Step(basis @ x[:r], t, basis @ root[:r], freedom, 2 * price + 1e-30)

    def towards(self, step: _Step) -> tuple["_State", float]:
        """As much of ``step`` as makes it better, and how much that is."""
        before = self.merit(step.price)
        low, high = self.problem.family.bounds
        n2 = self.y.size - low.size
        length = 1.0
        for _ in range(_HALVINGS):
            y, t = self.y + length * step.dy, self.t + length * (step.t - self.t)
            y[n2:] = np.clip(y[n2:], low, high)
            found = self._replace(y=y, t=t, shot=self.problem.shot(y, t))
            if found.merit(step.price) <= before * (1 + 1e-6) + 1e-22:
                return found, length
            length /= 2
        return self, 0.0

    def merit(self, price: float) -> float:
        """What steps make less: squares of shifts, and gaps at their price."""
        return float(
            np.sum((self.weights * self.shifts) ** 2) + price * np.sum(np.abs(self.shot.gaps))
        )


def least(A: Matrix, B: Matrix, d: Vector) -> tuple[Vector, Vector, Matrix]:
    """``x`` and the least ``e`` with ``A x + B e = d``.

    Args:
        A: of full column rank, shape (r, k).
        B: shape (r, c).
        d: shape (r,).

    Returns:
        ``x``, ``e`` and a root of the covariance of ``x`` where that of ``e`` is one.
    """
    k = A.shape[1]
    Q, R = linalg.qr(A)
    known, left = Q[:, :k].T, Q[:, k:].T @ B
    e = linalg.lstsq(left, Q[:, k:].T @ d)[0] if left.size else np.zeros(B.shape[1])
    free = linalg.null_space(left) if left.size else np.eye(B.shape[1])
    x = linalg.solve_triangular(R[:k], known @ (d - B @ e))
    return x, e, linalg.solve_triangular(R[:k], known @ B @ free)
