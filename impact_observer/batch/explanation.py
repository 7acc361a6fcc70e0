# SPDX-License-Identifier: Apache-2.0
"""The search for the account of a recording, and the motion that explains the account best.

All events as reported come first. Where no motion explains all of their stamps, and no revision
of their account ends with a motion that does, a filter goes through the recording: with the
parameters of parts of the recording that fit as reported, then with the given and with the fitted
ones. Each account is revised by its own motion: a stamp far off is spurious, and a motion through
a stop has missed an impact.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import log

import numpy as np

from impact_observer.batch.moments import Moment, Moments
from impact_observer.batch.motion_fit import LOST, BatchProblem, MotionFit, fitted
from impact_observer.batch.recorded_run import RecordedRun
from impact_observer.batch.revision import SPURIOUS, revised
from impact_observer.batch.verdict import FitVerdict, verdict_on
from impact_observer.errors import DynamicsError
from impact_observer.model.free_parameters import is_phase
from impact_observer.options import Options
from impact_observer.states import Vector

_SHARES = 0.1, 0.03, 0.01
"""Deviations of parameters over their sizes in the filters that make accounts."""
_PARTS, _PART = 4, 4
"""Parts of a recording that are tried, and moments in a part for each unknown."""
_SHARPEST = 1e-6
"""Least deviation of a parameter that a part tells, over its size."""
_REVISIONS = 6
"""Most revisions of an account."""
_WORTH = 5.0
"""Logarithm of the odds by which each further change of an account must be worth more."""
_UNLABELLED = 0.1
"""Probability of wrong contacts above which those of the events are no account."""
_LEAST = 1e-6
"""Least probability of a missed or a spurious impact."""
_PHASES = 8
"""Phases of an unknown drive with which searches begin."""
_UNKNOWN_PHASE = 1.0
"""Deviation of a phase from which on all phases are tried, rad."""
_FIRST_ROUNDS = 4
"""Linearisations by which phases are compared."""
_NEAR, _NEAR_ROUNDS = 0.03, 10
"""Deviations of parameters over their sizes with which a search begins, and its linearisations."""


@dataclass(frozen=True, slots=True, eq=False)
class Explanation:
    """An account of a recording, its motion, and whether the model fits.

    Attributes:
        fit: the motion.
        verdict: on the motion.
        evidence: logarithm of the density of the recording by the account.
    """

    fit: MotionFit
    verdict: FitVerdict
    evidence: float

    @property
    def is_lost(self) -> bool:
        """Whether no motion was found by which single events can be judged."""
        verdict = self.verdict
        return verdict.model > LOST or verdict.has_outliers or self.fit.is_astray

    @property
    def explains_all_stamps(self) -> bool:
        """Whether the model fits, and no stamp of the account looks spurious."""
        return self.verdict.fits and bool(np.all(np.abs(self.fit.standardized) <= SPURIOUS))

    @property
    def missed(self) -> int:
        """Number of inserted impacts of contacts that have a sensor."""
        problem = self.fit.problem
        return int(np.sum(problem.errors.has_sensor[problem.missed]))

    def is_better_than(self, other: "Explanation") -> bool:
        """Whether the account is likelier than ``other``: by more if it changes more events."""
        if self.verdict.fits != other.verdict.fits:
            return self.verdict.fits
        if self.is_lost != other.is_lost:
            return other.is_lost
        more = self.missed - other.missed
        return self.evidence > other.evidence + _WORTH * max(more, 0)


def explanation(
    problem: BatchProblem,
    run: RecordedRun,
    *,
    options: Options,
    trusts_events: bool = False,
    resolution: float = 0.0,
    show: Callable[[str], None] = lambda _: None,
) -> Explanation:
    """Search the account that explains a recording best.

    Args:
        problem: with the moments as reported.
        run: the events.
        options: of the filter, with probabilities of missed and spurious impacts.
        trusts_events: whether all events are as reported.
        resolution: of printed times, s: errors below half of it are no evidence.
        show: receives what is being done.

    Raises:
        DynamicsError: no motion at all was found.
    """
    reported, tried = problem.moments, set[tuple[tuple[Moment, ...], bool]]()
    best: Explanation | None = None

    def found_so_far() -> Explanation | None:
        return best

    accounts = _accounts(problem, run, options, trusts_events, found_so_far, show)
    for theta, moments in accounts:
        if (key := (moments.each, theta is None)) in tried:
            continue
        tried.add(key)
        try:
            found = _revised(replace(problem, moments=moments), theta, reported, options, show)
            found = _at_resolution(found, resolution, reported, options, show)
        except (DynamicsError, np.linalg.LinAlgError):
            continue
        if best is None or found.is_better_than(best):
            best = found
        if best.explains_all_stamps:
            break
    if best is None:
        raise DynamicsError("no motion explains the impacts")
    return best


def _accounts(  # noqa: PLR0917
    problem: BatchProblem,
    run: RecordedRun,
    options: Options,
    trusts_events: bool,
    best: Callable[[], Explanation | None],
    show: Callable[[str], None],
) -> Iterator[tuple[Vector | None, Moments]]:
    """Yield accounts with the parameters to begin with, None for unknown ones.

    ``best`` returns the explanation that has been found so far, None without one.
    """
    is_labelled = options.mislabelled <= _UNLABELLED
    if trusts_events or is_labelled:
        yield None, problem.moments
    if trusts_events:
        return
    if is_labelled:
        for fit in _parts(problem, show):
            d, least = problem.mean.size, (_SHARPEST * problem.family.sizes) ** 2
            covariance = fit.covariance[d:, d:] + np.diag(least)
            sure = replace(options, clock_error=fit.sizes.clock)
            yield fit.values, run.by_filter(problem.family, fit.values, covariance, sure, show)
    prior = np.linalg.norm(problem.theta, axis=1)
    for share in _SHARES:
        found = best()
        begin = None if found is None or share == _SHARES[0] else found.fit.values
        about = problem.family.nominal if begin is None else begin
        covariance = np.diag(np.minimum(prior, share * problem.family.sizes) ** 2)
        moments = run.by_filter(problem.family, about, covariance, options, show)
        if found is not None and not found.is_lost and moments.each == problem.moments.each:
            return  # the motion is near, and nothing is missing or false
        yield begin, moments


def _parts(problem: BatchProblem, show: Callable[[str], None]) -> Iterator[MotionFit]:
    """Yield the motions of parts of a recording that fit as reported.

    An event that is missing or false is in one part alone.
    """
    each, size = problem.moments.each, _PART * (problem.mean.size + problem.family.size)
    if len(each) < 2 * size:
        return
    for begin in np.linspace(0, len(each) - size, _PARTS).astype(int).tolist():
        own = Moments(each[begin].t, each[begin : begin + size])
        try:
            fit = _from_phases(replace(problem, moments=own, samples=()), None, show)
            if verdict_on(fit).fits:
                yield fit
        except (DynamicsError, np.linalg.LinAlgError):
            continue


def _revised(
    problem: BatchProblem,
    theta: Vector | None,
    reported: Moments,
    options: Options,
    show: Callable[[str], None],
) -> Explanation:
    """Return the account of a problem, revised as long as this makes the account likelier."""
    best = _explained(_from_phases(problem, theta, show), reported, options)
    for _ in range(_REVISIONS):
        moments = None if best.is_lost else revised(best.fit)
        if moments is None:
            break
        fit = fitted(replace(problem, moments=moments), theta=best.fit.values, show=show)
        found = _explained(fit, reported, options)
        if not found.is_better_than(best):
            break
        best = found
    return best


def _at_resolution(
    found: Explanation,
    resolution: float,
    reported: Moments,
    options: Options,
    show: Callable[[str], None],
) -> Explanation:
    """Return an explanation that fits by stamps of this ``resolution``, s; ``found`` without one.

    Of a periodic motion the rounding repeats itself, which says nothing of the model.
    """
    is_declared = found.fit.problem.clock is not None
    if found.verdict.fits or is_declared or found.fit.sizes.clock > resolution / 2:
        return found
    rounded = replace(found.fit.problem, clock=resolution)
    other = _explained(fitted(rounded, found.fit, show=show), reported, options)
    return other if other.verdict.fits else found


def _from_phases(
    problem: BatchProblem, theta: Vector | None, show: Callable[[str], None]
) -> MotionFit:
    """Return the best motion of searches that begin with all phases of an unknown drive."""
    family = problem.family
    deviations = np.sqrt(np.sum(problem.theta**2, axis=1))
    unknown = [
        j
        for j, name in enumerate(family.names)
        if is_phase(name) and deviations[j] >= _UNKNOWN_PHASE
    ]
    if theta is not None:
        return fitted(problem, theta=theta, show=show)
    if not unknown:
        narrow = np.diag(np.minimum(deviations, _NEAR * family.sizes))
        near = fitted(replace(problem, theta=narrow), rounds=_NEAR_ROUNDS, show=show)
        return fitted(problem, near, theta=near.values, show=show)
    begun = []
    for turn in np.arange(_PHASES) * 2 * np.pi / _PHASES:
        start = family.nominal.copy()
        start[unknown] += turn
        try:
            begun.append(fitted(problem, theta=start, show=show, rounds=_FIRST_ROUNDS))
        except (DynamicsError, np.linalg.LinAlgError):
            continue
    if not begun:
        raise DynamicsError("no motion explains the impacts")
    given, *others = (
        fitted(problem, each, show=show)
        for each in (begun[0], *sorted(begun[1:], key=lambda fit: -fit.log_density)[:2])
    )
    # a periodic motion may have several phases: the one from the given value is preferred
    best = max(others, key=lambda fit: (fit.rank, fit.worth), default=given)
    if best.rank != given.rank:
        return max(best, given, key=lambda fit: fit.rank)
    return best if best.worth > given.worth + _WORTH else given


def _explained(fit: MotionFit, reported: Moments, options: Options) -> Explanation:
    """Return the motion with its evidence and verdict."""
    moments = fit.problem.moments
    rejected = max(reported.row_moment.size - moments.row_moment.size, 0)
    flight = float(np.mean(reported.flights)) or 1.0
    missed = np.maximum(fit.problem.errors.missed[fit.problem.missed], _LEAST)
    evidence = fit.log_density + float(np.sum(np.log(missed)))
    evidence += rejected * log(max(options.spurious, _LEAST) / flight)
    return Explanation(fit, verdict_on(fit, rejected), evidence)
