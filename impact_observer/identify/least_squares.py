# SPDX-License-Identifier: Apache-2.0
"""The most likely motion whose contacts close at the recorded instants up to errors of the stamps.

Unknown are the initial state with the parameters, ``y``, and the instants ``t``. Given are the
stamps ``s``. The gaps of the contacts that hit vanish at ``t``, and ``t - s`` are the errors of
the clock: the most likely motion has the least sum of their squares. Gauss-Newton steps with
constraints (Bock, Recent advances in parameter identification techniques for O.D.E., 1983)
solve ::

    min |e|^2    subject to    A dy + B (s + e - t) + g = 0

by two orthogonal triangulations, as Paige (Computer solution and perturbation analysis of
generalized linear least squares problems, 1979). Samples of sensors add rows to ``A`` and ``B``,
and a prior adds rows to ``A``: their noise in units of the clock's error is among the ``e``, and
so are errors of impulses, if impulses scatter, with columns of their own beside ``B``. The
instants are unknowns, not results: a motion that is switched at given instants forgets its start,
so nothing in ``A`` or ``B`` grows with the length of the recording, however unstable the impacting
motion is by itself.
"""

from collections.abc import Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from impact_observer.errors import IdentificationError
from impact_observer.identify.constrained import constrained_least_squares, redundancies
from impact_observer.identify.first_guess import directions
from impact_observer.identify.problem import LEAST, Problem, Scattered, Solution, deviation
from impact_observer.identify.scatter import (
    innovations,
    log_determinant,
    shown_deviations,
    without_unknowns,
)
from impact_observer.identify.sensor_rows import Rows
from impact_observer.identify.shooting import Shot
from impact_observer.model.parametric_family import ModelParameter
from impact_observer.states import Matrix, Vector

_STEPS = 40
"""Most Gauss-Newton steps; a fit takes about six."""
_PATIENCE = 12
"""Steps after which a fit is given up that is still lost."""
_FAR = 0.1
"""Usual shift, over the time between two moments, of a fit that is lost."""
_HALVINGS = 12
"""Most halvings of a step."""
_WATCHED = 6
"""Most full steps in a row before the first of them is shortened."""
_CONVERGED = 1e-2
"""Size of the last step, relative to the standard errors."""
_SETTLED = 0.1
"""The same where impulses scatter: slopes by differences are not exact."""
_DIFFERENCE = 0.2
"""Difference by which slope and curvature are found, relative to the standard errors."""
_STEEPEST = 12.0
"""Largest slope of the logarithm of a determinant by one standard error."""
_CAUCHY = 2.0
"""Scale of the Cauchy weights, over the usual shift."""
_WEIGHINGS = 8
"""Most fits, each with the error of the clock that the one before has shown."""
_SHARPER = 0.25
"""Clock error that is tried next, over the one that the shifts show."""
_SMALLER = 0.5
"""Largest shifts of such a try that is taken, over those before."""


def weighed(problem: Problem, y: Vector, *, robust: bool = False) -> tuple[Problem, Solution]:
    """The most likely motion, with the error of the clock that the motion shows.

    A declared error stays, and any error stays if no samples and no prior are to be weighed.
    A prior may hold a motion whose shifts are large, and large shifts give the prior its weight:
    smaller clock errors are tried for as long as the shifts become smaller, too.

    Raises:
        IdentificationError: fewer hits and samples than unknowns.
        LinAlgError: impulses scatter, and contacts have no speed.
    """
    if problem.scatter:
        solution = solved(problem, y)
        return problem.weighed_by(solution), solution
    problem, solution = _as_shown(problem, solved(problem, y, robust=robust), robust=robust)
    while problem.has_prior and not problem.is_declared and problem.clock > problem.least_clock:
        clock = max(problem.clock * _SHARPER, problem.least_clock)
        sharper = problem._replace(clock=clock)
        found = solved(sharper, solution.y, robust=robust)
        if not found.converged or found.rms > problem.clock * _SMALLER:
            break
        problem, solution = _as_shown(sharper, found, robust=robust)
    return problem, solution


def _as_shown(problem: Problem, solution: Solution, *, robust: bool) -> tuple[Problem, Solution]:
    """The problem with deviations that its solution shows, and this solution, by iteration."""
    for _ in range(_WEIGHINGS if problem.is_weighed else 0):
        reweighed = problem.weighed_by(solution)
        if reweighed.is_like(problem):
            break
        problem, solution = reweighed, solved(reweighed, solution.y, robust=robust)
    return problem, solution


def solved(problem: Problem, y: Vector, *, robust: bool = False) -> Solution:
    """The most likely motion, searched from a ``y`` nearby.

    If ``robust`` a few shifts may be large: weights, renewed at every step, make the shifts count
    as if drawn from a Cauchy distribution. By how much impulses scatter is learned at every step,
    and so is the error of the clock unless declared.

    Raises:
        IdentificationError: fewer hits than unknowns.
        LinAlgError: impulses scatter, and contacts have no speed.
    """
    now = _Iterate.begin(problem, y.copy(), problem.begin, np.zeros(len(problem.moments)))
    basis = directions(problem, now.shot).determined
    converged = False
    for k in range(_STEPS):
        if robust:
            now = now.weighted()
        before, pull = now.problem, None
        if problem.scatter:
            now = now._replace(problem=before.scattering(now.scattered(basis).shown))
            pull = now.pull(basis)
        is_known = now.problem.is_like(before)
        step = now.step_within(basis, pull)
        converged = step.is_small(now) and is_known
        now, length = now.towards(step, basis, pull)
        rms = deviation(now.shifts, step.freedom)
        problem.report(f"step {k + 1} of at most {_STEPS}, shifts {rms:.2g} s")
        lost = k >= _PATIENCE and is_lost(problem, now.shifts, step.freedom)
        if converged or length == 0.0 or lost:
            break
    step = now.step_within(basis)
    errors = tuple(
        each.deviation * deviation(np.sqrt([rows.squares]), freedom)
        for each, rows, freedom in zip(
            problem.sensors, now.shot.sensors, step.of_sensors, strict=True
        )
    )
    cost = float(np.sum(now.shifts**2)) + now.squares
    motion = now.y, now.t, now.shot, now.shifts
    rest = now.scattered(basis) if problem.scatter else None
    own = now.counted, step.freedom, step.root
    return Solution(*motion, *own, converged, errors, cost, rest)


def savings(
    problem: Problem, solution: Solution, others: Sequence[ModelParameter]
) -> tuple[Vector, Vector]:
    """By how much each of ``others`` would lower the cost of a solution if free, linearised.

    Returns:
        What each would save, s^2, and its change from its value, in its unit, shape (others,)
        each.
    """
    family = problem.family.extended(others)
    wider = problem._replace(family=family)
    y = np.concatenate([solution.y, family.nominal[-len(others) :]])
    scattered = solution.scattered
    eta = np.zeros(solution.t.size) if scattered is None else scattered.impulses
    now = _Iterate.begin(wider, y, solution.t, eta)
    basis = directions(problem, solution.shot).determined
    return now.saved_by_last(np.pad(basis, ((0, len(others)), (0, 0))), len(others))


def usual_size(shifts: Vector, freedom: float) -> float:
    """Standard deviation of a stamp that a few large shifts do not change, s.

    A fit can make as many shifts zero as it has unknowns: the median is that of the others.
    """
    sizes = np.sort(np.abs(shifts))
    middle = (sizes.size - freedom) + (freedom - 1) / 2
    return float(1.4826 * np.interp(middle, np.arange(sizes.size), sizes))


def is_lost(problem: Problem, shifts: Vector, freedom: float) -> bool:
    """Whether even the usual ones of ``shifts``, s, are a part of the time between two moments."""
    return usual_size(shifts, freedom) > _FAR * problem.usual_flight


class _Step(NamedTuple):
    """A Gauss-Newton step.

    ``t`` are the new instants, s, and ``eta`` the new relative errors of impulses. ``penalty``
    (s^2/m) weighs a gap in the merit function, and is larger than any multiplier. ``of_sensors``
    are the degrees of freedom of each sensor's errors. ``Solution`` explains the others.
    """

    dy: Vector
    t: Vector
    eta: Vector
    root: Matrix
    freedom: float
    penalty: float
    of_sensors: tuple[float, ...] = ()

    def is_small(self, now: "_Iterate") -> bool:
        """Whether the step is small beside the standard errors."""
        clock = max(deviation(now.shifts, self.freedom), LEAST)
        size = clock * np.linalg.norm(self.root, axis=1)
        share = _SETTLED if now.problem.scatter else _CONVERGED
        small = np.abs(self.dy) <= share * size + 1e-12 * np.abs(now.y)
        return bool(np.all(small) and np.max(np.abs(self.t - now.t)) <= clock / 10)


class _Iterate(NamedTuple):
    """A point of the iteration; see ``Solution``.

    ``eta`` are relative errors of the impulses, shape (moments,), and ``weights`` those of the
    shifts, shape (counted,).
    """

    problem: Problem
    counted: NDArray[np.int64]
    y: Vector
    t: Vector
    eta: Vector
    shot: Shot
    weights: Vector

    @classmethod
    def begin(cls, problem: Problem, y: Vector, t: Vector, eta: Vector) -> "_Iterate":
        """The point ``y``, ``t``, ``eta``, where all shifts have the same weight."""
        counted = problem.counted
        shot = problem.shot(y, t, eta if problem.scatter else None)
        return cls(problem, counted, y, t, eta, shot, np.ones(counted.size))

    @property
    def shifts(self) -> Vector:
        """Instants minus stamps, s, shape (counted,)."""
        return np.asarray((self.t - self.problem.stamps)[self.counted])

    @property
    def squares(self) -> float:
        """Sum of the squared errors of samples, prior and impulses, as errors of stamps, s^2."""
        own = float(np.sum(self.problem.prior_errors(self.y) ** 2))
        if self.problem.scatter:
            own += float(np.sum((self.eta / self.problem.scatter) ** 2))
        return sum((rows.squares for rows in self.shot.sensors), own) * self.problem.clock**2

    def weighted(self) -> "_Iterate":
        """The iterate with smaller weights for shifts that are larger than usual."""
        sizes = np.abs(self.shifts)
        if not np.any(sizes):
            return self
        unknowns = min(self.y.size, sizes.size - 1)
        usual = max(usual_size(sizes, sizes.size - unknowns) * _CAUCHY, LEAST)
        return self._replace(weights=1 / np.sqrt(1 + (sizes / usual) ** 2))

    def step_within(self, basis: Matrix, pull: "_Pull | None" = None) -> _Step:
        """``step`` with the parameters fixed that would leave their bounds."""
        low, high = self.problem.family.bounds
        n2 = self.y.size - low.size
        value, fixed = self.y[n2:], np.zeros(low.size, dtype=np.bool_)
        while True:
            rows = n2 + np.flatnonzero(fixed)
            own = basis @ linalg.null_space(basis[rows]) if rows.size else basis
            step = self.step(own, pull)
            change = step.dy[n2:]
            beyond = ((value <= low) & (change < 0)) | ((value >= high) & (change > 0))
            if not np.any(beyond & ~fixed):
                return step
            fixed |= beyond

    def step(self, basis: Matrix, pull: "_Pull | None" = None) -> _Step:
        """The Gauss-Newton step in the directions ``basis`` and the instants.

        ``pull`` is that of a further term of the merit.
        """
        problem, shot = self.problem, self.shot
        inserted, A, B, further = self._gap_rows(basis)
        whole, weighed, d = self._stacked(A, B, further)
        if len(whole) < whole.shape[1]:
            raise IdentificationError(
                f"{len(A)} impacts for {whole.shape[1]} unknowns; record longer, or free less"
            )
        count, impulses = self.counted.size, problem.impulses
        x, errors, root = constrained_least_squares(whole, weighed, d)
        if pull is not None:
            x = pull.applied(x, root, np.pad(basis, ((0, 0), (0, len(inserted)))))
            errors = linalg.lstsq(weighed, d - whole @ x)[0]
        e = errors[:count] / self.weights
        r = basis.shape[1]
        t, eta = self.t.copy(), self.eta.copy()
        t[self.counted] = problem.stamps[self.counted] + e
        t[inserted] += x[r:]
        noises = count + impulses.size
        eta[impulses] = errors[count:noises] * problem.impulse_unit
        pulled = (weighed[len(A) :, :count] * self.weights).T @ errors[noises:]
        multipliers = linalg.lstsq(B.T, 2 * (e * self.weights**2 - pulled))[0]
        penalty = 2 * float(np.max(np.abs(multipliers), initial=0.0)) + 1e-30
        freedom: float = len(self.counted) - A.shape[1] + len(A) - np.linalg.matrix_rank(B)
        of_sensors: tuple[float, ...] = ()
        if further or impulses.size:
            left = redundancies(whole, weighed)
            freedom = float(np.sum(left[:count]))
            parts = np.split(left[noises:], np.cumsum([each.d.size for each in further]))
            of_sensors = tuple(  # parts of the prior come last
                float(np.sum(part)) + rows.alone
                for part, rows in zip(parts, shot.sensors, strict=False)
            )
        return _Step(basis @ x[:r], t, eta, basis @ root[:r], freedom, penalty, of_sensors)

    def _gap_rows(self, basis: Matrix) -> tuple[list[int], Matrix, Matrix, list["_GapRows"]]:
        """Moments that were missed, ``A`` and ``B`` of the gaps, and rows of samples and prior."""
        moments, shot = self.problem.moments, self.shot
        inserted = [k for k, m in enumerate(moments) if m.hit and not m.measured]
        A = np.hstack([shot.by_start @ basis, shot.by_instant[:, inserted]])
        further = [_GapRows.from_sensor(rows, basis, inserted, self) for rows in shot.sensors]
        if self.problem.has_prior:
            further.append(_GapRows.from_prior(basis, len(inserted), self))
        return inserted, A, shot.by_instant[:, self.counted], further

    def _stacked(
        self, A: Matrix, B: Matrix, further: Sequence["_GapRows"]
    ) -> tuple[Matrix, Matrix, Vector]:
        """``A``, ``B`` and ``d`` of gaps, samples and prior, with the weights of the shifts.

        Columns of ``B`` are those of stamps, of impulses, and of the noise of samples and prior.
        """
        C, eta = self.shot.by_impulse[:, self.problem.impulses], self.eta[self.problem.impulses]
        d = -(self.shot.gaps - B @ self.shifts - C @ eta)
        whole = np.vstack([A, *(each.A for each in further)])
        noises = sum(each.d.size for each in further)
        by_stamp = np.vstack([B, *(each.B for each in further)]) / self.weights
        by_impulse = np.pad(C * self.problem.impulse_unit, ((0, noises), (0, 0)))
        weighed = np.hstack([by_stamp, by_impulse, np.eye(len(whole), noises, -len(A))])
        return whole, weighed, np.concatenate([d, *(each.d for each in further)])

    @property
    def spread(self) -> float:
        """``log_determinant`` of the covariance of what is recorded, as squared errors, s^2."""
        _, A, B, further = self._gap_rows(np.zeros((self.y.size, 0)))
        whole, weighed, _ = self._stacked(A, B, further)
        last = self.counted.size + self.problem.impulses.size
        rows = without_unknowns(whole[: len(A)], weighed[: len(A), :last])
        return self.problem.clock**2 * log_determinant(rows, self.counted.size)

    def pull(self, basis: Matrix) -> "_Pull":
        """Slope and curvature of ``spread`` by y, along motions that explain the stamps.

        Each of the combinations of unknowns that are independent changes by a part of its standard
        error. Far from the answer slopes say little, and are limited.
        """
        problem, count, r = self.problem, self.counted.size, basis.shape[1]
        inserted, A, B, further = self._gap_rows(basis)
        whole, weighed, d = self._stacked(A, B, further)
        root = constrained_least_squares(whole, weighed, d)[2]
        axes, sizes, _ = linalg.svd(root, full_matrices=False)
        noises, variance = count + problem.impulses.size, problem.clock**2
        changes = _DIFFERENCE * problem.clock * sizes * axes
        errors, here = linalg.lstsq(weighed, -whole @ changes)[0].T, self.spread
        slopes, bends = np.zeros(sizes.size), np.zeros(sizes.size)
        for j, (dx, de) in enumerate(zip(changes.T, errors, strict=True)):
            dy, dt, d_eta = basis @ dx[:r], np.zeros_like(self.t), np.zeros_like(self.eta)
            dt[self.counted] = de[:count]
            dt[inserted] = dx[r:]
            d_eta[problem.impulses] = de[count:noises] * problem.impulse_unit
            more, less = (
                _Iterate.begin(problem, self.y + s * dy, self.t + s * dt, self.eta + s * d_eta)
                for s in (1, -1)
            )
            slopes[j] = (more.spread - less.spread) / (2 * _DIFFERENCE)
            bends[j] = (more.spread - 2 * here + less.spread) / _DIFFERENCE**2
        slopes = np.clip(slopes, -_STEEPEST * variance, _STEEPEST * variance)
        bends = np.maximum(bends, -variance)
        duals = linalg.pinv(basis).T @ (axes[:r] / (sizes * problem.clock))
        return _Pull(duals @ slopes, (duals * bends) @ duals.T)

    def scattered(self, basis: Matrix) -> Scattered:
        """The errors of the impulses, and the deviations that gaps, samples and prior show."""
        problem, count = self.problem, self.counted.size
        _, A, B, further = self._gap_rows(basis)
        whole, weighed, d = self._stacked(A, B, further)
        by_stamp, by_impulse, own = np.split(
            weighed, [count, count + problem.impulses.size], axis=1
        )
        others, least = np.hstack([by_stamp, own]), problem.least_clock
        shown = shown_deviations(
            whole,
            others,
            by_impulse / problem.impulse_unit,
            d,
            clock=problem.clock,
            least=None if problem.is_declared else least,
        )
        gaps = np.hstack([by_stamp, by_impulse, d[:, None]])[: len(A)]
        gaps = without_unknowns(A[:, basis.shape[1] :], gaps)
        errors = innovations(gaps[:, :-1], gaps[:, -1])
        return Scattered(self.eta, errors, float(len(A) - A.shape[1]), shown)

    def saved_by_last(self, basis: Matrix, count: int) -> tuple[Vector, Vector]:
        """``savings`` of the last ``count`` parameters; ``basis`` moves the others."""
        whole, weighed, d = self._stacked(*self._gap_rows(basis)[1:])
        last = np.eye(self.y.size)[:, -count:]
        _, A, B, further = self._gap_rows(last)
        columns = self._stacked(A, B, further)[0][:, :count]
        _, errors, _ = constrained_least_squares(whole, weighed, np.column_stack([d, columns]))
        e, moved = errors[:, 0], errors[:, 1:]
        squares = np.sum(moved**2, axis=0)
        changes = moved.T @ e / np.where(squares > 0, squares, np.inf)
        return changes**2 * squares, changes

    def towards(
        self, step: _Step, basis: Matrix, pull: "_Pull | None" = None
    ) -> tuple["_Iterate", float]:
        """The iterate after the first of 1, 1/2, .. of ``step`` with a lower merit, and which.

        Along a curved valley full steps raise the merit before they lower it (Maratos). So a few
        more full steps in the directions ``basis`` are tried before the step is shortened
        (Chamberlain, Powell, Lemarechal and Pedersen, The watchdog technique for forcing
        convergence in algorithms for constrained optimization, 1982).
        """
        merit = self.merit(step.penalty)
        least = merit + 1e-6 * abs(merit) + 1e-22
        length = 1.0
        for _ in range(_HALVINGS):
            # such as those of a motion that overflows
            with suppress(ValueError, linalg.LinAlgError):
                trial = self.stepped(step, length)
                for watched in reversed(range(_WATCHED if length == 1.0 else 1)):
                    if trial.merit(step.penalty) <= least:
                        return trial, length
                    if watched:
                        trial = trial.stepped(trial.step_within(basis, pull))
            length /= 2
        return self, 0.0

    def stepped(self, step: _Step, length: float = 1.0) -> "_Iterate":
        """The iterate after a part of ``step``, with parameters within their bounds.

        Raises:
            ValueError: the motion overflows.
        """
        low, high = self.problem.family.bounds
        y, t = self.y + length * step.dy, self.t + length * (step.t - self.t)
        eta = self.eta + length * (step.eta - self.eta)
        n2 = y.size - low.size
        y[n2:] = np.clip(y[n2:], low, high)
        return _Iterate.begin(self.problem, y, t, eta)._replace(weights=self.weights)

    def merit(self, penalty: float) -> float:
        """Sum of the squared shifts and errors, and of the gaps with their penalty."""
        own = float(np.sum((self.weights * self.shifts) ** 2))
        own += self.spread if self.problem.scatter else 0.0
        return own + self.squares + penalty * float(np.sum(np.abs(self.shot.gaps)))


class _Pull(NamedTuple):
    """A further term of the merit, by initial state and parameters y.

    Attributes:
        slope: in s^2, shape (2n + p,).
        curvature: shape (2n + p, 2n + p).
    """

    slope: Vector
    curvature: Matrix

    def applied(self, x: Vector, root: Matrix, basis: Matrix) -> Vector:
        """The least-squares solution ``x`` with this term, by a Newton step.

        ``root root^T`` is the inverse of the normal matrix, and y changes by ``basis x``.
        """
        axes, sizes, _ = linalg.svd(root, full_matrices=False)
        by_axis = basis @ axes * sizes
        bent = np.eye(sizes.size) + by_axis.T @ self.curvature @ by_axis / 2
        z = axes.T @ x / sizes - by_axis.T @ self.slope / 2
        return np.asarray(axes @ (sizes * linalg.solve(bent, z)))


class _GapRows(NamedTuple):
    """Rows of a sensor, or of the prior, in the form of gaps: ``A x + B e + e' = d``.

    The ``e'`` are errors in s, the ``e`` are shifts; see ``constrained_least_squares``.
    """

    A: Matrix
    B: Matrix
    d: Vector

    @classmethod
    def from_sensor(
        cls, rows: Rows, basis: Matrix, inserted: Sequence[int], now: _Iterate
    ) -> "_GapRows":
        clock, B = now.problem.clock, rows.by_instant[:, now.counted]
        A = np.hstack([rows.by_start @ basis, rows.by_instant[:, inserted]])
        return cls(clock * A, clock * B, clock * (rows.residual + B @ now.shifts))

    @classmethod
    def from_prior(cls, basis: Matrix, inserted: int, now: _Iterate) -> "_GapRows":
        problem = now.problem
        A = np.pad(problem.by_prior @ basis, ((0, 0), (0, inserted)))
        d = problem.prior_errors(now.y)
        return cls(problem.clock * A, np.zeros((d.size, now.counted.size)), problem.clock * d)
