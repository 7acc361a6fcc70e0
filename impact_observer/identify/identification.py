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

"""From a recording of impact times to the parameters of its model."""

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from impact_observer.errors import IdentificationError, UsageError
from impact_observer.estimation.square_root import sparse_basis
from impact_observer.events import ImpactEvent
from impact_observer.identify.first_guess import (
    by_gaps,
    by_gaps_near,
    directions,
    own_impacts,
    start_of,
)
from impact_observer.identify.late_start import late_start
from impact_observer.identify.least_squares import usual_size, weighed
from impact_observer.identify.outliers import outliers_by_motion, outliers_by_observer
from impact_observer.identify.problem import Problem, Solution
from impact_observer.identify.recorded_impacts import Recording
from impact_observer.identify.residuals import ROUNDED, HeldBack, widening
from impact_observer.identify.sensor_fit import SensorFit, sensor_fits
from impact_observer.identify.sensor_rows import used_samples
from impact_observer.model import System
from impact_observer.model.free_parameters import OFFSET
from impact_observer.model.live_signals import refused
from impact_observer.model.measurement import Measurement
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.observer.episode import last_episode, require_epoch
from impact_observer.observer.samples import SensorSample
from impact_observer.stamps import seconds_between
from impact_observer.states import Matrix, Vector, frozen

_ROUNDS = 12
"""Most rounds of rejecting and inserting impacts."""
_SUSPICIOUS = 0.01
"""Error of stamps, relative to the time between two, above which outliers are searched."""
_EXCESS = 1.5
"""Error of stamps over a declared one above which outliers are searched."""
_LOST = 0.02
"""Error of stamps, relative to the time between two, above which nothing is explained, unless it
is as declared.
"""
_STILL = 1e-9
"""Contact speed of no motion, m/s."""
_WRONG = 0.03
"""Declared error of the model, as an error of the stamps relative to the time between two."""
_ACCEPTED = 2 / 3
"""Least share of accepted, measured impacts in a recording that is explained."""
_FEWEST = 3
"""Fewest impacts that are held back, and fewest degrees of freedom of the fit of the others."""
_PART = 1e-3
"""Smallest term of a combination, relative to the largest."""
_GATINGS = 5
"""Most rounds of rejecting samples."""
_MINOR = 0.2
"""Smallest term of a weakly determined combination, relative to the largest."""


@dataclass(frozen=True, slots=True, eq=False)
class Identification:
    """A model fitted to impact times.

    Attributes:
        family: the given system and its free parameters.
        recording: the events, with rejected and inserted impacts.
        values: of the parameters, shape (p,), SI units.
        covariance: of initial state and parameters, shape (2n + p, 2n + p), widened.
        widened: factor by which standard errors are wider than white errors of the clock give
            them, because the model does not explain the shifts so.
        start: initial state (q, u) in the system's frame, shape (2n,), at ``recording.start``.
        clock: standard deviation of a stamp on which the errors rest, s.
        declared: whether it was declared; else it is estimated from the shifts.
        rms: of the shifts, over their degrees of freedom, s.
        freedom: degrees of freedom of the shifts.
        stamps: of the impacts that were compared, s since the epoch, shape (counted,).
        shifts: instants of the motion minus these stamps, s, shape (counted,).
        contacts: the contacts of each.
        singular: singular values of the gaps with respect to the unknowns, each in its unit, over
            the largest, shape (2n + p,).
        undetermined: combinations of parameters that the impacts do not determine: the change
            of each by name, in its unit.
        converged: whether the fit converged to a motion that explains the stamps.
        held_back: the last impacts, predicted from a fit of the others; None if none are.
        doubted: most impacts that were rejected and inserted in any search for outliers.
        accepted: standard deviation of a stamp estimated with all impacts accepted, s.
        sensors: how samples of what is measured beside the impacts fit.
    """

    family: ParametricFamily
    recording: Recording
    values: Vector
    covariance: Matrix
    widened: float
    start: Vector
    clock: float
    declared: bool
    rms: float
    freedom: int
    stamps: Vector
    shifts: Vector
    contacts: tuple[tuple[str, ...], ...]
    singular: Vector
    undetermined: tuple[dict[str, float], ...]
    converged: bool
    held_back: HeldBack | None = None
    doubted: int = 0
    accepted: float = 0.0
    sensors: tuple[SensorFit, ...] = ()

    @property
    def errors(self) -> Vector:
        """Standard errors of the parameters, shape (p,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance))[self.start.size :])

    @property
    def correlation(self) -> Matrix:
        """Of the parameters, shape (p, p)."""
        own = self.covariance[self.start.size :, self.start.size :]
        scale = np.where(self.errors > 0, self.errors, 1.0)
        return np.asarray(own / np.outer(scale, scale))

    @property
    def system(self) -> System:
        """The fitted system.

        Raises:
            ModelError: the values make no valid system.
        """
        return self.family.system_at(self.values)

    @property
    def bounded(self) -> tuple[str, ...]:
        """Names of the parameters at a bound."""
        low, high = self.family.bounds
        at = (self.values <= low) | (self.values >= high)
        return tuple(np.array(self.family.names)[at].tolist())


@contextmanager
def _quiet() -> Iterator[None]:
    """Without warnings of overflow and the like: far from the answer a trial motion may grow."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        yield


@_quiet()
def identify(
    family: ParametricFamily,
    events: list[ImpactEvent],
    *,
    clock: float | None = None,
    horizon: float | None = None,
    trust_events: bool = False,
    held_back: float = 0.2,
    progress: Callable[[str], None] = lambda _: None,
    measurements: Sequence[Measurement] = (),
    samples: Sequence[SensorSample] = (),
) -> Identification:
    """Fit the parameters of a family, and the initial state, to impact times and to samples.

    Args:
        family: a system and its free parameters.
        events: their last episode counts.
        clock: standard deviation of a stamp, s; None to estimate it.
        horizon: seconds of the recording that count; None for all.
        trust_events: whether to reject no impact as spurious and to insert no missed one.
        held_back: share of the impacts, the last ones, on which a fit of the others is checked;
            the values are from all impacts. With too few impacts none are held back.
        progress: receives what is being done.
        measurements: what sensors measure beside the impacts.
        samples: of them; those up to the last impact count.

    Raises:
        UsageError: something arrives live, the clock's offset is free under a sampled forcing,
            the forcing depends on time and no event says its epoch, or a sensor or a parameter
            does not go with the other.
        BagError: the events contain no impact of the system's contacts.
        IdentificationError: fewer impacts than unknowns, or parameters that move no impact.
        ImpactLawError: the impact law has no solution at an event.
    """
    refused(family.system, "identify")
    if family.system.forcing.sampled is not None and OFFSET in family.names:
        raise UsageError(
            f"{family.system.name}: its forcing is sampled, so {OFFSET} cannot be identified;"
            " expected other parameters, or a constant and harmonics"
        )
    episode = last_episode(family.system, events)
    require_epoch(family.system, max(each.epoch for each in events))
    if horizon is not None:
        start, keys = episode.start, episode.keys
        keys = [key for key in keys if seconds_between(start, key.stamp) <= horizon]
        episode = episode._replace(keys=keys)
    state = None
    if family.system.guides:
        episode, state = late_start(family.system, episode, events)
    whole = _with_samples(Recording(episode, state=state), family, clock, measurements, samples)
    progress("all impacts accepted")
    recording, (problem, solution) = whole, _gated(*_fit(whole.problem(family)))
    first = _identification(recording, problem, solution, clock)
    accepted = max(usual_size(solution.shifts, solution.freedom), ROUNDED)
    least = _SUSPICIOUS * problem.interval if clock is None else _EXCESS * max(clock, 1e-9)
    if trust_events or (solution.converged and solution.rms <= least):
        checked = _held_back(problem, solution, held_back)
        return replace(first, held_back=checked, accepted=accepted)
    found, doubted = replace(first, converged=False), 0
    for wrong in (_WRONG * problem.interval, None):
        progress("searching spurious and missed impacts")
        recording = outliers_by_observer(family.system, whole, events, wrong)
        doubted = max(doubted, recording.outliers)
        try:
            recording, again, refit = _without_outliers(recording, family, clock, progress)
            again, refit = _gated(again, refit)
        except IdentificationError:
            continue  # too few impacts are left
        doubted = max(doubted, recording.outliers)
        found = _identification(recording, again, refit, clock)
        if found.converged:
            problem, solution = again, refit
            break
    if not found.converged and first.converged and first.rms <= _SUSPICIOUS * problem.interval:
        found = first  # a declared clock error that is too small
    checked = _held_back(problem, solution, held_back) if found.converged else None
    return replace(found, held_back=checked, doubted=doubted, accepted=accepted)


def _with_samples(
    recording: Recording,
    family: ParametricFamily,
    clock: float | None,
    measurements: Sequence[Measurement],
    samples: Sequence[SensorSample],
) -> Recording:
    """The recording with the samples up to its last event."""
    if not measurements:
        return recording
    episode = recording.episode
    within = episode.start, episode.keys[-1].stamp
    found = used_samples(family, measurements, samples, episode.epoch, within)
    known = _SUSPICIOUS * recording.problem(family).interval if clock is None else clock
    return replace(
        recording, sensors=found, clock=max(known, ROUNDED), is_declared=clock is not None
    )


def _gated(problem: Problem, solution: Solution) -> tuple[Problem, Solution]:
    """Without samples that their gates reject, fitted again."""
    for _ in range(_GATINGS):
        sensors = tuple(
            each.within_gate(rows.errors)
            for each, rows in zip(problem.sensors, solution.shot.sensors, strict=True)
        )
        if all(a.t.size == b.t.size for a, b in zip(sensors, problem.sensors, strict=True)):
            break
        problem, solution = weighed(problem._replace(sensors=sensors), solution.y)
    return problem, solution


def _held_back(problem: Problem, solution: Solution, share: float) -> HeldBack | None:
    """The last impacts as the others predict them; None where one of the parts has too few."""
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
        _, first = _fit(problem._replace(moments=moments, is_declared=True), solution.y)
    except IdentificationError:
        return None
    return HeldBack.between(first, solution)


def _without_outliers(
    recording: Recording,
    family: ParametricFamily,
    clock: float | None,
    progress: Callable[[str], None],
) -> tuple[Recording, Problem, Solution]:
    """The recording in which the fitted motion finds no further outlier, and the fit."""
    problem, solution = _fit(recording.problem(family), robust=True)
    for round_ in range(_ROUNDS):
        after = outliers_by_motion(recording, problem, solution, clock)
        if (after.rejected, after.inserted) == (recording.rejected, recording.inserted):
            break
        recording = after
        progress(f"spurious and missed impacts, round {round_ + 1}")
        problem, solution = _fit(recording.problem(family), solution.y, robust=True)
    return recording, *_fit(recording.problem(family), solution.y)


def _fit(
    problem: Problem, near: Vector | None = None, *, robust: bool = False
) -> tuple[Problem, Solution]:
    """The motion that explains a recording best, searched near ``near``, else from the least gaps.

    ``robust`` says that some impacts may be wrong.
    """
    unknowns = 2 * problem.family.system.n + problem.family.size
    hits = sum(len(each.hit) for each in problem.moments if each.measured)
    samples = sum(each.t.size for each in problem.sensors)
    if hits + samples <= unknowns:
        beside = f" and {samples} samples" if problem.sensors else ""
        raise IdentificationError(
            f"{hits} impacts{beside} for {unknowns} unknowns, {problem.family.size} of them"
            " parameters; expected more: record longer, or free less"
        )
    if near is not None:
        found = weighed(problem, near, robust=robust)
        if found[1].converged:
            return found
    if problem.near is not None:
        return weighed(problem, by_gaps_near(problem, problem.near), robust=robust)
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
    found = []
    for direction in sparse_basis(left[:, singular > _PART].T):
        largest = np.max(np.abs(direction))
        found.append(
            {
                name: float(value * size / largest)
                for name, value, size in zip(family.names, direction, family.sizes, strict=True)
                if abs(value) > _PART * largest
            }
        )
    return tuple(found)


def combination(terms: Mapping[str, float]) -> str:
    """A combination in words, such as ``+1 mass-scale +1 stiffness-scale``."""
    return " ".join(f"{change:+.3g} {name}" for name, change in terms.items())


def _identification(
    recording: Recording, problem: Problem, solution: Solution, clock: float | None
) -> Identification:
    family, n = problem.family, problem.family.system.n
    used = max(solution.rms if clock is None else clock, ROUNDED)
    fits = sensor_fits(problem, solution)
    widened = max(widening(solution, clock), *(each.widening for each in fits), 1.0)
    root = solution.root * used * widened
    covariance = root @ root.T
    found = directions(problem, solution.shot)
    own = covariance[2 * n :, 2 * n :] / np.outer(family.sizes, family.sizes)
    values, axes = linalg.eigh(own) if own.size else (np.zeros(0), np.zeros((0, 0)))
    axes = axes[:, values > 1.0]
    # With few stamps an axis is rotated a little: small terms may be well determined.
    axes = np.where(np.abs(axes) < _MINOR * np.max(np.abs(axes), axis=0, initial=0.0), 0.0, axes)
    weak = np.vstack([np.zeros((2 * n, axes.shape[1])), axes * family.sizes[:, None]])
    hits, names = recording.hits(), family.system.contact_names
    return Identification(
        family=family,
        recording=recording,
        values=frozen(solution.y[2 * n :]),
        covariance=frozen(covariance),
        widened=widened,
        start=frozen(solution.y[: 2 * n]),
        clock=used,
        declared=clock is not None,
        rms=solution.rms,
        freedom=round(solution.freedom),
        sensors=fits,
        stamps=frozen(problem.stamps[solution.counted]),
        shifts=frozen(solution.shifts),
        contacts=tuple(tuple(names[i] for i in hits[k][1]) for k in solution.counted),
        singular=frozen(found.singular / found.singular[0]),
        undetermined=combinations_of(problem, np.hstack([found.undetermined, weak])),
        converged=solution.converged
        and solution.rms <= max(_LOST * problem.interval, _EXCESS * (clock or 0.0))
        and solution.counted.size >= _ACCEPTED * (solution.counted.size + recording.outliers),
    )
