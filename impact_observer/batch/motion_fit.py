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
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from impact_observer.batch.linearised_motion import Array, LinearisedMotion, linearised
from impact_observer.batch.moments import Indices, Moments, grouped
from impact_observer.batch.noise_sizes import LARGEST_CLOCK, LARGEST_MODEL, ROUNDED, NoiseDensity
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
from impact_observer.batch.sample_rows import FlightSamples, SampleRows, sample_rows
from impact_observer.dynamics.tangent import Tangent
from impact_observer.errors import DynamicsError
from impact_observer.model.contact_sensors import ContactErrors
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.states import Matrix, Vector

_HUBER = 3.0
"""Deviations of a stamp up to which its square counts, and beyond which its size counts."""
_ROUNDS = 25
"""Most linearisations of a search."""
_UNREACHED = 0.1
"""Part of the measured gaps above which a motion that does not reach them is a wrong one."""
LOST = 0.1
"""Error of accelerations from which on a motion says nothing of single events."""
_FARTHEST = 8.0
"""Deviations of a given value within which a parameter is searched."""
_FAR = 30.0
"""Deviations from which on an error of the model is not taken for none."""
_FIRST = 2
"""Linearisations of a motion that is far off."""
_LATE = 10
"""Linearisations after which no kind of noise comes or goes."""
_LOST_AFTER = 8
"""Linearisations after which a search ends where the motion is still lost."""
_SETTLED = 0.02
"""Largest change of states and parameters at the end of a search, in standard deviations."""
_SETTLED_EXACT = 1.0
"""The same where stamps are as exact as their rounding, and a step gains nothing any more."""
_GAIN = 0.1
"""Gain of the log density that counts as nothing there."""
_STEADY = 0.01
"""Change of the weight of a stamp that counts as none."""
_ALIKE = 0.05
"""Change of the size of a noise that counts as none."""
_ROUNDING = 1e-11
"""Rounding of states and parameters, over their usual sizes."""
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
        errors: declared errors of each contact's sensor.
        clock: declared standard deviation of other stamps, s; None to estimate the deviation.
        samples: of sensors beside the impacts.
        dead_time: after an event, in which the sensor reports no other of the contact, s.
        least_clock: least standard deviation of stamps where none is declared, s.
    """

    family: ParametricFamily
    moments: Moments
    mean: Vector
    start: Matrix
    theta: Matrix
    errors: ContactErrors
    clock: float | None = None
    samples: tuple[FlightSamples, ...] = ()
    dead_time: float = 0.0
    least_clock: float = ROUNDED

    @property
    def missed(self) -> Indices:
        """Contacts of the missed detections that a sensor could have reported, shape (any,)."""
        return self.moments.missed(self.dead_time)

    def __post_init__(self) -> None:
        """Take the rounding of stamps to 1 ns for the least declared error of a clock."""
        if self.clock is None and not np.isnan(self.errors.clock).any():
            object.__setattr__(self, "clock", float(np.max(self.errors.clock, initial=0.0)))
        if self.clock is not None:
            object.__setattr__(self, "clock", max(self.clock, ROUNDED))

    @property
    def searched(self) -> tuple[Vector, Vector]:
        """Bounds of the parameters in a search, shape (p,) each."""
        low, high = self.family.bounds
        reach = _FARTHEST * np.linalg.norm(self.theta, axis=1)
        return (
            np.maximum(low, self.family.nominal - reach),
            np.minimum(high, self.family.nominal + reach),
        )

    def stamp_deviations(self, sizes: NoiseSizes) -> Vector:
        """Standard deviations of the stamps of all measured gaps, shape (R,), s."""
        declared = self.errors.clock[self.moments.row_contact]
        return np.where(np.isnan(declared), sizes.clock, np.maximum(declared, ROUNDED))


@dataclass(frozen=True, eq=False)
class MotionFit:
    """A motion that explains a recording: the unknowns by all measurements, linearised.

    Attributes:
        problem: what is explained.
        tangent: the system with the parameters about which is linearised.
        x: states before the moments about which is linearised, shape (K + 1, 2n).
        motion: linearised.
        samples: as rows of the motion.
        inflation: deviations of stamps over that of the clock, shape (R,): more than 1 where a
            stamp is far off.
        sample_inflation: the same of samples, over the declared deviations, shape (S,).
        intensity: of white accelerations that are as large as those of the motion, m/s^1.5.
        prior: at the start.
        steps: from each moment over its jump and the next flight: 2 K + 1.
        sizes: of the noises.
        is_settled: whether the search has converged.
    """

    problem: BatchProblem
    tangent: Tangent
    x: Matrix
    motion: LinearisedMotion
    samples: SampleRows
    inflation: Vector
    sample_inflation: Vector
    intensity: tuple[float, ...]
    prior: Gaussian
    steps: list[LinearStep]
    sizes: NoiseSizes
    is_settled: bool = False

    @cached_property
    def way(self) -> Forward:
        """The way forward by the sizes."""
        return forward(self.prior, self.steps, self.sizes)

    @cached_property
    def back(self) -> Backward:
        """The unknowns by all measurements: nodes before and after each moment in turn."""
        return backward(self.prior, self.way)

    @cached_property
    def density(self) -> NoiseDensity:
        """The density of all that is measured, by the sizes."""
        least = self.problem.least_clock
        return NoiseDensity(self.prior, self.steps, self.way, self.sizes, least)

    @property
    def log_density(self) -> float:
        """Logarithm of the density of all that is measured."""
        return self.way.log_density

    @property
    def worth(self) -> float:
        """The same, less what each kind of noise has to be worth."""
        return self.log_density - self.sizes.price

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

    @property
    def rank(self) -> tuple[bool, bool]:
        """What makes a motion better than another one, whatever the ``worth`` of both is."""
        return not self.is_astray, self.is_settled

    def published(self, *, fits: bool) -> "MotionFit":
        """The same motion with noises as large as they may be, for honest deviations.

        Where a recording shows an error of the model or a scatter of rebounds, or the model does
        not fit, the error of the model is the largest one that is not much less likely, and counts
        twice: errors of models persist from flight to flight, white noise does not.
        """
        if fits and not self.sizes.model and not self.sizes.scatter:
            return self
        largest = LARGEST_MODEL
        if not self.is_astray:
            largest = self.density.largest_model_error(self.sizes)
        return replace(self, sizes=self.sizes._replace(model=_PERSISTING * largest))

    @property
    def unreached(self) -> int:
        """How many measured gaps are not zero near their stamps."""
        return int(np.sum(~self.motion.is_regular[self.problem.moments.row_moment]))

    @property
    def misses_impacts(self) -> bool:
        """Whether many gaps are not zero near their stamps; the first stamp may be the start."""
        return self.unreached > 1 + _UNREACHED * self.residuals.size

    @property
    def is_behind_stops(self) -> bool:
        """Whether contacts open where they should close."""
        speeds = self.motion.speed
        return bool(speeds.size and float(np.median(speeds)) > 0)

    @property
    def is_astray(self) -> bool:
        """Whether the motion has other impacts than those of the recording."""
        return self.misses_impacts or self.is_behind_stops

    @property
    def states(self) -> tuple[Matrix, Matrix]:
        """States before and after the moments, shape (K + 1, 2n) each."""
        d, mean = self.x.shape[1], self.back.nodes.mean
        return self.x + mean[0::2, :d], self.motion.after + mean[1::2, :d]

    @property
    def values(self) -> Vector:
        """The parameters, shape (p,)."""
        low, high = self.problem.family.bounds
        return np.clip(self.tangent.theta + self.change[-1, self.x.shape[1] :], low, high)

    @cached_property
    def covariance(self) -> Matrix:
        """Covariance of initial state and parameters, shape (2n + p, 2n + p)."""
        root = self.back.nodes.root[0]
        return np.asarray(root @ root.T)

    @cached_property
    def residuals(self) -> Vector:
        """Instants of the motion minus stamps, shape (R,), s."""
        change = self.change[1 + self.problem.moments.row_moment]
        return np.asarray(self.motion.late + np.einsum("rn,rn->r", self.motion.late_by_y, change))

    @cached_property
    def standardized(self) -> Vector:
        """Residuals of the stamps over their own deviations, shape (R,)."""
        roots = self.back.nodes.root[0::2][1 + self.problem.moments.row_moment]
        taken = np.einsum("rn,rnm->rm", self.motion.late_by_y, roots)
        sigma = self.problem.stamp_deviations(self.sizes)
        left = (sigma * self.inflation) ** 2 - np.einsum("rm,rm->r", taken, taken)
        return np.asarray(self.residuals / np.sqrt(np.maximum(left, (1e-2 * sigma) ** 2)))

    @cached_property
    def sample_errors(self) -> Vector:
        """What the motion predicts of samples minus what was measured, shape (S,)."""
        return self.samples.errors(self.back.nodes.mean[1::2])

    @property
    def innovations(self) -> tuple[Vector, Vector]:
        """Innovations of the stamps in deviations, and these, s.

        Those of the first impacts, which find the start and the parameters, are left out.
        """
        found = [
            (update.innovation, update.spread)
            for step, trace in zip(self.steps, self.way.traces, strict=True)
            for update in trace.updates
            if not step.is_jump
        ]
        first = self.x.shape[1] + self.problem.family.size
        nu, s = np.reshape(found[first:], (-1, 2)).T
        return nu, s

    @property
    def predicted(self) -> Vector:
        """Instants that the motion up to there predicts minus stamps, shape (any,), s."""
        nu, s = self.innovations
        return nu * s

    @property
    def rms(self) -> float:
        """Root mean square of ``predicted``, s."""
        late = self.predicted
        return float(np.linalg.norm(late) / np.sqrt(max(late.size, 1)))


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
        DynamicsError: the forcing has no sample at a moment, or the motion grows without bounds.
    """
    family, moments = problem.family, problem.moments
    x = np.tile(problem.mean, (moments.count + 1, 1))
    begun = _Search(
        x, family.nominal, NoiseSizes(problem.clock or LARGEST_CLOCK, 0.0, LARGEST_MODEL)
    )
    if near is not None:
        begun = begun._replace(theta=near.values)
        if near.problem.moments is moments:
            begun = _Search.about(near)
    if theta is not None:
        begun = begun._replace(theta=np.array(theta))
    found = _settled(problem, begun, problem.clock, rounds, show)
    if not found.is_settled and (found.sizes.model > LOST or rounds < _ROUNDS):
        return found
    about = _Search.about(found)._replace(is_late=found.is_settled)
    others = list[tuple[NoiseSizes, float | None]]()
    if (sizes := found.density.likeliest_of_all(found.sizes, problem.clock)) != found.sizes:
        others.append((sizes, problem.clock))
    if problem.clock is None and (scatter := found.sizes.scatter or found.sizes.model):
        others.append((NoiseSizes(problem.least_clock, scatter), problem.least_clock))
    motions = [found]
    for sizes, clock in others:
        with suppress(DynamicsError):
            motions.append(_settled(problem, about._replace(sizes=sizes), clock, rounds, show))
    return max(motions, key=lambda each: (each.rank, each.worth))


class _Search(NamedTuple):
    """Where a search is: what is linearised next.

    Attributes:
        x: states before the moments, shape (K + 1, 2n).
        theta: parameters, shape (p,).
        sizes: of the noises.
        inflation: deviations of stamps over that of the clock, shape (R,); None for 1.
        of_samples: the same of samples, shape (S,).
        is_near: whether the motion is that of another search.
        is_late: whether no kind of noise comes or goes any more.
    """

    x: Matrix
    theta: Vector
    sizes: NoiseSizes
    inflation: Vector | None = None
    of_samples: Vector | None = None
    is_near: bool = False
    is_late: bool = False

    @classmethod
    def about(cls, fit: MotionFit) -> "_Search":
        """The search from a motion that was found."""
        return cls(
            *(fit.states[0], fit.values, fit.sizes, fit.inflation, fit.sample_inflation),
            is_near=True,
        )


def _settled(
    problem: BatchProblem,
    begun: _Search,
    clock: float | None,
    rounds: int,
    show: Callable[[str], None],
) -> MotionFit:
    """Return the motion at which a search settles, or its last one.

    The size of the clock's noise is ``clock``, or is found.
    """
    (low, high), worth = problem.searched, -np.inf
    x, theta, sizes, inflation, of_samples, is_near, is_late = begun
    if inflation is None:
        inflation = np.ones(problem.moments.row_moment.size)
    fit: MotionFit | None = None
    for number in range(rounds):
        is_first = not is_near and number < _FIRST
        found = linearised_fit(
            problem,
            theta,
            x,
            sizes=sizes,
            inflation=inflation,
            sample_inflation=of_samples,
            is_first=is_first,
        )
        if not (np.isfinite(found.log_density) and found.density.is_finite):
            break
        fit = found
        is_late = is_late or number >= _LATE
        likeliest = fit.density.likeliest(sizes, clock, is_first=is_first, is_late=is_late)
        fit = fit if likeliest == sizes else replace(fit, sizes=likeliest)
        if sizes.model and not likeliest.model and fit.distance > _FAR:
            kept = fit.density.likeliest(sizes, clock, is_first=is_first, is_late=True)
            fit = replace(fit, sizes=kept)
        were, sizes = sizes, fit.sizes
        size = ", ".join(f"{each:.1g}" for each in sizes)
        show(f"motion {number + 1} (clock, rebounds, model: {size})")
        z = np.abs(fit.residuals) / problem.stamp_deviations(sizes)
        before, inflation = inflation, np.sqrt(np.maximum(z / _HUBER, 1.0))
        of_samples = fit.samples.inflation(fit.sample_errors)
        steady = np.max(np.abs(before / inflation - 1), initial=0.0) < _STEADY
        alike = np.allclose(sizes, were, rtol=_ALIKE, atol=0.0)
        is_still = fit.distance < _SETTLED
        is_rounding = sizes.clock <= ROUNDED  # what is left of the search
        if is_rounding and fit.distance < _SETTLED_EXACT:
            is_still = is_still or fit.worth < worth + _GAIN
        worth = fit.worth
        if not is_first and is_still and steady and alike:
            return replace(fit, is_settled=True)
        if number >= _LOST_AFTER and sizes.model > LOST:
            break
        x = x + fit.change[:, : x.shape[1]]
        theta = np.clip(theta + fit.change[-1, x.shape[1] :], low, high)
    if fit is None:
        raise DynamicsError("no motion explains the impacts")
    return fit


def linearised_fit(
    problem: BatchProblem,
    theta: Vector,
    x: Matrix,
    *,
    sizes: NoiseSizes,
    inflation: Vector | None = None,
    sample_inflation: Vector | None = None,
    is_first: bool,
) -> MotionFit:
    """Linearise about states and parameters; the parameters stay where ``is_first``.

    Args:
        problem: what is to be explained.
        theta: parameters, shape (p,).
        x: states before the moments, shape (K + 1, 2n).
        sizes: of the noises.
        inflation: deviations of stamps over that of the clock, shape (R,); 1 without.
        sample_inflation: the same of samples, shape (S,); 1 without, or of another length.
        is_first: whether the motion is far off.

    Raises:
        DynamicsError: the forcing has no sample at a moment.
    """
    tangent, moments = Tangent(problem.family, theta), problem.moments
    motion = linearised(tangent, moments, x, problem.errors, is_scattered=sizes.scatter > 0)
    near = 0.0 if is_first else _SURE * sizes.clock
    samples = sample_rows(tangent, moments, motion, problem.samples, near)
    if inflation is None:
        inflation = np.ones(moments.row_moment.size)
    if sample_inflation is None or sample_inflation.size != samples.value.size:
        sample_inflation = np.ones(samples.value.size)
    intensity = _intensity(tangent, moments, x)
    K, still = moments.count, np.zeros(x.shape[1])
    jumps = np.concatenate([motion.jump, motion.jump_by_theta], axis=2)
    flights = np.concatenate([motion.Phi, motion.Gamma], axis=2)
    hits = [list[MeasuredRow]() for _ in range(K)]
    is_common = np.isnan(problem.errors.clock)[moments.row_contact].tolist()
    deviation = inflation * problem.stamp_deviations(NoiseSizes(1.0))
    for r, k in enumerate(moments.row_moment.tolist()):
        value, own = float(motion.late[r]), float(deviation[r])
        hits[k].append(MeasuredRow(motion.late_by_y[r], value, own, is_common[r]))
    sampled, noise = (
        samples.compressed(sample_inflation, K + 1),
        _noise(tangent, moments, intensity),
    )
    steps = list[LinearStep]()
    for k in range(K + 1):
        kick = motion.kick[k, :, None] if np.any(motion.kick[k]) else np.zeros((still.size, 0))
        steps.append(LinearStep(jumps[k], still, kick, is_jump=True, rows=sampled[k]))
        if k < K:
            steps.append(LinearStep(flights[k], motion.defect[k], noise[k], rows=hits[k]))
    return MotionFit(
        problem=problem,
        tangent=tangent,
        x=x,
        motion=motion,
        samples=samples,
        inflation=inflation,
        sample_inflation=sample_inflation,
        intensity=intensity,
        prior=_prior(problem, x[0], theta, is_first=is_first),
        steps=steps,
        sizes=sizes,
    )


def _prior(problem: BatchProblem, x: Vector, theta: Vector, *, is_first: bool) -> Gaussian:
    """Return what is known of start and parameters, relative to where is linearised."""
    d, p = x.size, theta.size
    root, mean = np.zeros((d + p, d + p)), np.zeros(d + p)
    root[:d, :d], mean[:d] = problem.start, problem.mean - x
    if not is_first:
        root[d:, d:], mean[d:] = problem.theta, problem.family.nominal - theta
    return Gaussian(mean, root)


def _intensity(tangent: Tangent, moments: Moments, x: Matrix) -> tuple[float, ...]:
    """Return the intensity of white accelerations as large as those of a motion, m/s^1.5.

    White noise changes within the inverse of the fastest rate.
    """
    accelerations = np.empty((moments.count, tangent.n))
    for before, own in grouped([one.switching.before for one in moments.each]).items():
        t = [moments.each[k].t for k in own.tolist()]
        accelerations[own] = tangent.rates(t, x[own + 1], before)[0][:, tangent.n :]
    usual = np.sqrt(np.mean(np.square(accelerations), axis=0))
    rate = tangent.phase(()).flow.exponential.rate
    tau = 1.0 / rate if rate > 0 else float(np.mean(moments.flights))
    return tuple((usual * np.sqrt(tau)).tolist())


def _noise(tangent: Tangent, moments: Moments, intensity: tuple[float, ...]) -> Array:
    """Return roots of the process noise of the flights at unit model error, (K, 2n, 2n)."""
    d = 2 * tangent.n
    noise = np.empty((moments.count, d, d))
    held_in_flight = [(), *(one.switching.held for one in moments.each[:-1])]
    for held, own in grouped(held_in_flight).items():
        noise[own] = tangent.noise(moments.flights[own], held, intensity)
    return noise
