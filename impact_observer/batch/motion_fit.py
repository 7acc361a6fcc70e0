# SPDX-License-Identifier: Apache-2.0
"""The motion, the parameters and the sizes of the noises that explain a recording best.

Gauss and Newton's method: linearise about states at the moments, pass forward and back, move the
states. Each size of a noise is the one of the largest density of all that is measured, in which
start and parameters are integrated over (restricted maximum likelihood; Patterson and Thompson,
Recovery of inter-block information when block sizes are unequal, 1971). While a model is far off,
its error is noise, so a search begins with little trust in flights, and ends with as much as the
recording shows.
"""

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from impact_observer.batch.linearised_motion import Array, linearised
from impact_observer.batch.moments import Moments, grouped
from impact_observer.batch.passes import (
    Backward,
    Forward,
    Gaussian,
    LinearStep,
    MeasuredRow,
    NoiseSizes,
    backward,
    forward,
)
from impact_observer.batch.sample_rows import FlightSamples, sample_rows
from impact_observer.dynamics.tangent import Tangent
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.states import Matrix, Vector

ROUNDED = 1e-9 / np.sqrt(12)
"""Standard deviation of a stamp that is wrong by its rounding only, s."""
LARGEST_CLOCK = 1.5e-3
"""Largest error of stamps that is found where none is declared, s: larger ones would explain
errors of the model away."""
LARGEST_MODEL = 0.3
"""Largest error of accelerations that is found; the least that is not zero is 1e-7."""
_LEAST_MODEL = 1e-7
_SCATTER = 1e-4, 0.3
"""Range of the scatter of rebounds that is found, beside zero."""
_WORTH = 3.0
"""Logarithm of the odds by which one more kind of noise must explain a recording better."""
_HUBER = 3.0
"""Deviations of a stamp up to which its square counts, and beyond which its size counts."""
_ROUNDS = 25
"""Most linearisations of a search."""
LOST = 0.1
"""Error of accelerations from which on a motion says nothing of single events."""
_LATE = 10
"""Linearisations after which no kind of noise comes or goes."""
_LOST_AFTER = 8
"""Linearisations after which a search ends where the motion is still lost."""
_SETTLED = 0.02
"""Largest change of states and parameters at the end of a search, in standard deviations."""
_STEADY = 0.01
"""Change of the weight of a stamp that counts as none."""
_FIRST_GRID, _GRIDS = (30.0,), (4.0, 1.4)
"""Factors within which sizes are searched, one after the other: at first, and later."""
_TRIED = 7
"""Sizes that are tried at once."""
_ROUNDING = 1e-11
"""Rounding of states and parameters, over their usual sizes."""
_UNLIKELY = 2.0
"""Logarithm of the odds by which a size of a noise may be less likely than the likeliest one."""
_PERSISTING = 2.0
"""Factor of deviations by errors of the model, which persist."""
_SURE = 4.0
"""Deviations of the clock from an impact within which a sample may be before or after."""


@dataclass(frozen=True, slots=True, eq=False)
class BatchProblem:
    """What is to be explained.

    Attributes:
        family: the system and its unknown parameters.
        moments: the recorded moments.
        mean: of the initial state (q, u) in the frame, shape (2n,).
        start: root of its covariance, shape (2n, 2n).
        theta: root of the covariance of the parameters about their nominal values, shape (p, p).
        clock: declared standard deviation of a stamp, s; None to estimate the deviation.
        samples: of sensors beside the impacts.
        least_model: declared error of accelerations, over the usual ones.
    """

    family: ParametricFamily
    moments: Moments
    mean: Vector
    start: Matrix
    theta: Matrix
    clock: float | None = None
    samples: tuple[FlightSamples, ...] = ()
    least_model: float = 0.0

    def __post_init__(self) -> None:
        """Take the rounding of stamps to 1 ns for the least error of a clock."""
        if self.clock is not None:
            object.__setattr__(self, "clock", max(self.clock, ROUNDED))


class MotionFit:
    """A motion that explains a recording.

    Attributes:
        problem: what is explained.
        theta: the parameters, shape (p,).
        x: states before the moments about which is linearised, shape (K + 1, 2n).
        sizes: of the noises.
        motion: linearised about ``x`` and ``theta``.
        samples: as rows of the motion.
        prior: at the start.
        steps: from each moment over its jump and the next flight: 2 K + 1.
        inflation: deviations of stamps over that of the clock, shape (R,): more than 1 where a
            stamp is far off.
        is_settled: whether the search has converged.
        rounds: linearisations of the search.
    """

    def __init__(  # noqa: PLR0917
        self,
        problem: BatchProblem,
        theta: Vector,
        x: Matrix,
        sizes: NoiseSizes,
        inflation: Vector,
        sample_inflation: Vector,
        *,
        is_first: bool = False,
        is_late: bool = False,
    ) -> None:
        """Linearise, and find the sizes near ``sizes``.

        Parameters stay where ``is_first``; which kinds of noise there are stays where ``is_late``.
        """
        self.problem, self.theta, self.x, self.inflation = problem, theta, x, inflation
        self.tangent = Tangent(problem.family, theta)
        self.motion = linearised(self.tangent, problem.moments, x)
        near = _SURE * float(sizes.clock[0]) * float(not is_first)
        self.samples = sample_rows(
            self.tangent, problem.moments, self.motion, problem.samples, near
        )
        if sample_inflation.size != self.samples.value.size:
            sample_inflation = np.ones(self.samples.value.size)
        self.sample_inflation = sample_inflation
        self.prior = _prior(problem, x[0], theta, is_first=is_first)
        self.steps = _steps(self)
        self.sizes = found_sizes(
            self.prior, self.steps, sizes, problem, is_first=is_first, is_late=is_late
        )
        self.is_settled, self.rounds = False, 0

    @cached_property
    def way(self) -> Forward:
        """The way forward by the sizes."""
        return forward(self.prior, self.steps, self.sizes, keep=True)

    @cached_property
    def back(self) -> Backward:
        """The unknowns by all measurements: nodes before and after each moment in turn."""
        return backward(self.prior, self.way)

    @cached_property
    def intensity(self) -> tuple[float, ...]:
        """Intensity of white accelerations that are as large as those of the motion, m/s^1.5.

        White noise changes within the inverse of the fastest rate.
        """
        moments, n = self.problem.moments, self.tangent.n
        accelerations = np.empty((moments.count, n))
        for before, own in grouped([one.switching.before for one in moments.each]).items():
            t = [moments.each[k].t for k in own.tolist()]
            accelerations[own] = self.tangent.rates(t, self.x[own + 1], before)[0][:, n:]
        usual = np.sqrt(np.mean(np.square(accelerations), axis=0))
        rate = self.tangent.phase(()).flow.exponential.rate
        tau = 1.0 / rate if rate > 0 else float(np.mean(moments.flights))
        return tuple((usual * np.sqrt(tau)).tolist())

    @property
    def log_density(self) -> float:
        """Logarithm of the density of all that is measured."""
        return float(self.way.log_density[0])

    @property
    def change(self) -> Matrix:
        """What the states before the moments and the parameters are to be moved by, (K + 1, N)."""
        return self.back.nodes.mean[0::2]

    @property
    def distance(self) -> float:
        """Largest ``change``, in standard deviations."""
        root, d = self.back.nodes.root[0::2], self.x.shape[1]
        deviation = np.sqrt(np.einsum("kij,kij->ki", root, root))
        moved = self.x + self.change[:, :d]
        deviation[:, :d] += _ROUNDING * np.sqrt(np.mean(np.square(moved), axis=0))
        deviation[:, d:] += _ROUNDING * self.problem.family.sizes
        return float(np.max(np.abs(self.change) / np.where(deviation > 0, deviation, np.inf)))

    def published(self) -> "MotionFit":
        """The same motion with noises as large as they may be, for honest deviations.

        Where a recording shows an error of the model or a scatter of rebounds, the error of the
        model is the largest one that is not much less likely, and counts twice: errors of models
        persist from flight to flight, white noise does not.
        """
        clock, scatter, model = (float(each[0]) for each in self.sizes)
        if not model and not scatter:
            return self
        tried = np.geomspace(max(model, _LEAST_MODEL), LARGEST_MODEL, 4 * _TRIED)
        trial = NoiseSizes(*(np.full(tried.size, each) for each in (clock, scatter, 0.0)))
        trial = trial._replace(model=tried)
        density = forward(self.prior, self.steps, trial).log_density
        likely = density >= self.log_density - _UNLIKELY
        largest = max(model, float(np.max(tried[likely], initial=0.0)))
        wide = copy(self)
        wide.__dict__.pop("way", None), wide.__dict__.pop("back", None)
        wide.sizes = NoiseSizes(
            *(np.array([each]) for each in (clock, scatter, _PERSISTING * largest))
        )
        return wide

    @property
    def states(self) -> tuple[Matrix, Matrix]:
        """States before and after the moments, shape (K + 1, 2n) each."""
        d, mean = self.x.shape[1], self.back.nodes.mean
        return self.x + mean[0::2, :d], self.motion.after + mean[1::2, :d]

    @property
    def values(self) -> Vector:
        """The parameters, shape (p,)."""
        low, high = self.problem.family.bounds
        return np.clip(self.theta + self.change[-1, self.x.shape[1] :], low, high)

    @cached_property
    def covariance(self) -> Matrix:
        """Covariance of initial state and parameters, shape (2n + p, 2n + p)."""
        root = self.back.nodes.root[0]
        return np.asarray(root @ root.T)

    @cached_property
    def residuals(self) -> Vector:
        """Instants of the motion minus stamps, shape (R,), s."""
        h = np.hstack([self.motion.late_by_x, self.motion.late_by_theta])
        change = self.change[1 + self.problem.moments.row_moment]
        return np.asarray(self.motion.late + np.einsum("rn,rn->r", h, change))

    @property
    def innovations(self) -> tuple[Vector, Vector]:
        """Innovations of the stamps in deviations, and these, s.

        Those of the first impacts, which find the start and the parameters, are left out.
        """
        is_instant = [row.is_instant for step in self.steps for row in step.rows]
        first = self.x.shape[1] + self.problem.family.size
        nu, s = self.way.innovations[0], self.way.spreads[0]
        return nu[is_instant][first:], s[is_instant][first:]

    @property
    def predicted(self) -> Vector:
        """Instants that the motion up to there predicts minus stamps, shape (any,), s."""
        nu, s = self.innovations
        return nu * s

    @cached_property
    def standardized(self) -> Vector:
        """Residuals of the stamps over their own deviations, shape (R,)."""
        sigma = float(self.sizes.clock[0])
        h = np.hstack([self.motion.late_by_x, self.motion.late_by_theta])
        roots = self.back.nodes.root[0::2][1 + self.problem.moments.row_moment]
        taken = np.einsum("rn,rnm->rm", h, roots)
        left = (sigma * self.inflation) ** 2 - np.einsum("rm,rm->r", taken, taken)
        return np.asarray(self.residuals / np.sqrt(np.maximum(left, (1e-2 * sigma) ** 2)))

    @property
    def freedom(self) -> float:
        """Degrees of freedom of the residuals of the stamps."""
        h = np.hstack([self.motion.late_by_x, self.motion.late_by_theta])
        roots = self.back.nodes.root[0::2][1 + self.problem.moments.row_moment]
        taken = np.einsum("rn,rnm->rm", h, roots) / (self.sizes.clock[0] * self.inflation)[:, None]
        return float(self.residuals.size - np.sum(taken**2))


def fitted(
    problem: BatchProblem,
    near: MotionFit | None = None,
    *,
    theta: Vector | None = None,
    rounds: int = _ROUNDS,
    show: Callable[[str], None] = lambda _: None,
) -> MotionFit:
    """Search the motion that explains a recording best.

    Args:
        problem: what is to be explained.
        near: a motion of other parameters or of the same moments, from which to begin.
        theta: parameters with which to begin; None for those of ``near``, or nominal ones.
        rounds: most linearisations.
        show: receives what is being done.

    Raises:
        DynamicsError: the forcing has no sample at a moment.
    """
    family, moments = problem.family, problem.moments
    low, high = family.bounds
    rows = moments.row_moment.size
    x = np.tile(problem.mean, (moments.count + 1, 1))
    inflation, of_samples, firsts = np.ones(rows), np.zeros(0), 2
    sizes = NoiseSizes(*np.array([[problem.clock or LARGEST_CLOCK], [0.0], [LARGEST_MODEL]]))
    if near is not None and near.problem.moments is moments:
        x, inflation, sizes, firsts = near.states[0], near.inflation, near.sizes, 0
        of_samples = near.sample_inflation
    if theta is None:
        theta = family.nominal if near is None else near.values
    theta = np.array(theta)
    number = 0
    while True:
        is_first = number < firsts
        fit = MotionFit(
            problem,
            theta,
            x,
            sizes,
            inflation,
            of_samples,
            is_first=is_first,
            is_late=number >= _LATE,
        )
        were, sizes, fit.rounds = sizes, fit.sizes, number + 1
        size = ", ".join(f"{float(each[0]):.1g}" for each in sizes)
        show(f"motion {number + 1} (clock, rebounds, model: {size})")
        far = fit.distance
        z = np.abs(fit.residuals) / float(sizes.clock[0])
        before, inflation = inflation, np.sqrt(np.maximum(z / _HUBER, 1.0))
        of_samples = fit.samples.inflation(fit.back.nodes.mean[1::2])
        steady = np.max(np.abs(before / inflation - 1), initial=0.0) < _STEADY
        if not is_first and far < _SETTLED and steady and sizes.is_like(were):
            fit.is_settled = True
            break
        number += 1
        if number == rounds or (number > _LOST_AFTER and sizes.model[0] > LOST):
            break
        x = x + fit.change[:, : x.shape[1]]
        theta = np.clip(theta + fit.change[-1, x.shape[1] :], low, high)
    return fit


def _prior(problem: BatchProblem, x: Vector, theta: Vector, *, is_first: bool) -> Gaussian:
    """Return what is known of start and parameters, relative to where is linearised."""
    d, p = x.size, theta.size
    root, mean = np.zeros((d + p, d + p)), np.zeros(d + p)
    root[:d, :d], mean[:d] = problem.start, problem.mean - x
    if not is_first:
        root[d:, d:], mean[d:] = problem.theta, problem.family.nominal - theta
    return Gaussian(mean, root)


def _steps(fit: MotionFit) -> list[LinearStep]:
    """Return the jumps and flights between the nodes, with all that is measured."""
    motion, moments = fit.motion, fit.problem.moments
    K, d = moments.count, motion.x.shape[1]
    jumps = np.concatenate([motion.jump, motion.jump_by_theta], axis=2)
    flights = np.concatenate([motion.Phi, motion.Gamma], axis=2)
    h = np.hstack([motion.late_by_x, motion.late_by_theta])
    hits = [list[MeasuredRow]() for _ in range(K)]
    for r, k in enumerate(moments.row_moment.tolist()):
        hits[k].append(MeasuredRow(h[r], float(motion.late[r]), float(fit.inflation[r])))
    sampled = fit.samples.compressed(fit.sample_inflation, K + 1)
    noise, still = _noise(fit), np.zeros(d)
    steps = list[LinearStep]()
    for k in range(K + 1):
        kick = motion.kick[k, :, None] if np.any(motion.kick[k]) else np.zeros((d, 0))
        steps.append(LinearStep(jumps[k], still, kick, is_jump=True, rows=sampled[k]))
        if k < K:
            steps.append(LinearStep(flights[k], motion.defect[k], noise[k], rows=hits[k]))
    return steps


def _noise(fit: MotionFit) -> Array:
    """Return roots of the process noise of the flights at unit model error, (K, 2n, 2n)."""
    moments, n = fit.problem.moments, fit.tangent.n
    noise = np.empty((moments.count, 2 * n, 2 * n))
    held_in_flight = [(), *(one.switching.held for one in moments.each[:-1])]
    for held, own in grouped(held_in_flight).items():
        noise[own] = fit.tangent.noise(moments.flights[own], held, fit.intensity)
    return noise


def found_sizes(
    prior: Gaussian,
    steps: list[LinearStep],
    sizes: NoiseSizes,
    problem: BatchProblem,
    *,
    is_first: bool = False,
    is_late: bool = False,
) -> NoiseSizes:
    """The sizes of the noises of the largest density, from sizes nearby.

    At first, where a motion is far off, only those of the clock and the model count. When it
    ``is_late`` no noise comes or goes, so that a search settles.
    """
    now = [float(each[0]) for each in sizes]
    clock = (ROUNDED, LARGEST_CLOCK) if problem.clock is None else (problem.clock,) * 2
    ranges = [clock, _SCATTER, (max(_LEAST_MODEL, problem.least_model), LARGEST_MODEL)]
    for number, factor in enumerate(_FIRST_GRID if is_first else _GRIDS):
        for which in (2, 0) if is_first else (2, 0, 1):
            low, high = ranges[which]
            is_absent = which and not now[which]
            if low == high or (is_absent and (number or is_late)):
                continue
            exponents = np.linspace(-1, 1, _TRIED)
            tried = np.unique(np.clip((now[which] or low) * factor**exponents, low, high))
            if is_absent:
                tried = np.geomspace(low, high, 2 * _TRIED)
            is_optional = which == 1 or (which == 2 and not problem.least_model)
            is_optional = is_optional and not is_late
            if is_optional:
                tried = np.append(0.0, tried)
            trial = [np.full(tried.size, each) for each in now]
            trial[which] = tried
            density = forward(prior, steps, NoiseSizes(*trial)).log_density
            if is_optional:
                density[0] += _WORTH
            now[which] = float(tried[np.argmax(density)])
    return NoiseSizes(*(np.array([each]) for each in now))
