# SPDX-License-Identifier: Apache-2.0
"""From a recording of impact times to the parameters of its model."""

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import product, starmap
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from impact_observer.errors import (
    DynamicsError,
    IdentificationError,
    ModelError,
    UsageError,
)
from impact_observer.events import ImpactEvent, Kind
from impact_observer.identify.first_guess import directions, start_of
from impact_observer.identify.fit_check import check_fit
from impact_observer.identify.fit_progress import FitProgress
from impact_observer.identify.growing import Grown, grown, phase_changes, phases_of, stage_of
from impact_observer.identify.least_squares import is_lost, usual_size, weighed
from impact_observer.identify.other_parameters import (
    OtherParameter,
    fits_with_others,
    missed_parameters,
)
from impact_observer.identify.outliers import has_hit_twice
from impact_observer.identify.prior import PriorShift, chance_of, prior_covariance, prior_shifts
from impact_observer.identify.problem import ROUNDED, Problem, Solution
from impact_observer.identify.recorded_impacts import Recording
from impact_observer.identify.residuals import (
    DOUBTED,
    REJECTED,
    UNDECLARED,
    HeldBack,
    explained,
    probability_of_size,
    widening,
)
from impact_observer.identify.scatter_hypothesis import (
    is_scatter_accepted,
    may_scatter,
    with_scatter,
)
from impact_observer.identify.search import (
    combinations_of,
    fit,
    gated,
    last_impacts,
    without_outliers,
)
from impact_observer.identify.sensor_fit import SensorFit, sensor_fits
from impact_observer.identify.sensor_rows import used_samples
from impact_observer.identify.smoothed_start import enough_samples, is_crowded, smoothed_start
from impact_observer.identify.unreported import (
    as_closings,
    dead_time_of,
    has_rows,
    is_same,
    opened,
    with_rows,
)
from impact_observer.model import System
from impact_observer.model.free_parameters import OFFSET, parameters_beside
from impact_observer.model.live_signals import refused
from impact_observer.model.measurement import Measurement
from impact_observer.model.parameter_uncertainty import ParameterUncertainty, correlations_of
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.model.system import refuse_squares
from impact_observer.observer.episode import last_episode, require_epoch
from impact_observer.observer.samples import SensorSample
from impact_observer.options import Options
from impact_observer.states import Matrix, Vector, frozen

_SUSPICIOUS = 0.01
"""Error of stamps, relative to the time between two, above which outliers are searched."""
_EXCESS = 1.5
"""Error of stamps over a declared one above which outliers are searched."""
_LOST = 0.02
"""Error of stamps, relative to the time between two, above which nothing is explained, unless
so large an error is declared.
"""
_ACCEPTED = 2 / 3
"""Least share of accepted, measured impacts in a recording that is explained."""
_FIRST = 64
"""Events with which the search of a recording begins that has more than twice as many."""
_PART = 32
"""Events of each further part of a long recording."""
_PARTS = 8
"""Most further parts."""
_ROW_ROUNDS = 60
"""Most fits, each with the bounces of the one before: each may show one row more."""
_UNDECLARED = 24
"""Most events for which such bounces are tried without a declared dead time: 40 take 17 s."""
_HELD_BACK = 0.2
"""Share of the impacts, the last ones, on which a fit of the others is checked."""
_FAILURES = 3
"""Such fits in a row that do not converge, after which no more follow."""
_MOTIONS = 400
"""Most motions of all impacts in each kind of search; what succeeds takes up to 200."""
_OF_ANOTHER = 30
"""Most of these motions in the fit of a parameter that was not free."""
_OF_SCATTER = 400
"""Most of these motions in a fit in which impulses scatter."""
_NO_MOTION = IdentificationError, DynamicsError, ValueError, linalg.LinAlgError
"""Errors of a search that ends at no motion."""
_FEW = 64
"""Impacts of which these motions are at least."""
_SHARES = 1.0, 0.3
"""Shares of the usual deviations of parameters with which a motion is smoothed, in order."""
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
        widened: factor by which standard errors exceed those of white clock errors, because such
            errors do not explain the shifts.
        start: initial state (q, u) in the system's frame, shape (2n,), at ``recording.start``.
        clock: standard deviation of a stamp on which the errors rest, s.
        declared: whether ``clock`` was declared; else the shifts give the estimate.
        rms: of the shifts, over their degrees of freedom, s.
        freedom: degrees of freedom of the shifts.
        stamps: of the impacts that were compared, s since the epoch, shape (counted,).
        shifts: instants of the motion minus these stamps, s, shape (counted,).
        contacts: names of the contacts of each of these impacts.
        singular: singular values of the gaps with respect to the unknowns, each in its unit, over
            the largest, shape (2n + p,).
        lost: which of ``start`` the impacts do not determine, as where a contact rests after the
            first of them, shape (2n,); ``covariance`` says nothing of these.
        undetermined: combinations of parameters that the impacts do not determine: the change
            of each by name, in its unit.
        converged: whether the fit converged to a motion that explains the stamps.
        held_back: the last impacts, predicted from a fit of the others; None if none were.
        doubted: most impacts that were rejected and inserted in any search for outliers.
        accepted: standard deviation of a stamp estimated with all impacts accepted, s.
        sensors: how samples of what is measured beside the impacts fit.
        missed: names of parameters that were not free, each of which explains more of the shifts
            than chance does; none of a fit that did not converge.
        others: fits with one of these free, too, or with any other where the fit did not converge;
            none where the model fits.
        unsearched: events after the first ones of a long recording, none of whose parts a motion
            explains: only the first ones are in ``recording``.
        reached: the first impacts that a fit explains where none explains all; None if none does,
            or where one does.
        refuted: the prior without which alone the model fits; None if there is none.
        scatter: standard deviation of the relative error of an impulse; 0 where none is needed.
        residuals: what should be independent errors of the clock, s: shifts, or innovations of
            the gaps if impulses scatter.
        redundancy: degrees of freedom of the residuals.
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
    residuals: Vector
    redundancy: float
    scatter: float
    singular: Vector
    lost: NDArray[np.bool_]
    undetermined: tuple[dict[str, float], ...]
    converged: bool
    held_back: HeldBack | None = None
    doubted: int = 0
    accepted: float = 0.0
    sensors: tuple[SensorFit, ...] = ()
    missed: tuple[str, ...] = ()
    others: tuple[OtherParameter, ...] = ()
    unsearched: int = 0
    reached: Grown | None = None
    refuted: ParameterUncertainty | None = None

    @property
    def large(self) -> bool:
        """Whether shifts are above ``UNDECLARED`` and no clock error is declared."""
        return not self.declared and self.rms > UNDECLARED

    @property
    def carries_over(self) -> bool:
        """Whether impacts held back are as good as the fit, or within the declared clock error."""
        held = self.held_back
        within = held is not None and self.declared and held.residual <= self.clock
        return held is None or within or held.carries_over

    @property
    def errors(self) -> Vector:
        """Standard errors of the parameters, shape (p,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance))[self.start.size :])

    @property
    def cause(self) -> OtherParameter | None:
        """The first parameter with which, free too, a model fits that does not; None without."""
        return next((each for each in self.others if each.fits), None)

    @property
    def prior_shifts(self) -> tuple[PriorShift, ...]:
        """What the fit changed in parameters that have a prior, or a refuted one."""
        errors = self.errors / self.widened
        if self.refuted is not None:
            return prior_shifts(self.refuted, self.family, self.values, errors, is_used=False)
        return prior_shifts(self.recording.prior, self.family, self.values, errors)

    @property
    def correlation(self) -> Matrix:
        """The correlations of the parameters, shape (p, p)."""
        return correlations_of(self.covariance[self.start.size :, self.start.size :])

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
    """Suppress warnings of overflow: far from the answer a trial motion may grow."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        yield


@_quiet()
def identify(
    family: ParametricFamily,
    events: list[ImpactEvent],
    *,
    clock: float | None = None,
    trust_events: bool = False,
    progress: Callable[[str], None] = lambda _: None,
    measurements: Sequence[Measurement] = (),
    samples: Sequence[SensorSample] = (),
    dead_time: float = 0.0,
    mislabelled: float = Options.mislabelled,
    prior: ParameterUncertainty | None = None,
) -> Identification:
    """Fit the parameters of a family, and the initial state, to impact times and to samples.

    Args:
        family: a system and its free parameters.
        events: their last episode counts.
        clock: standard deviation of a stamp, s; None to estimate it.
        trust_events: whether to reject no impact as spurious and to insert no missed one.
        progress: receives what is being done.
        measurements: what sensors measure beside the impacts.
        samples: of them; those up to the last impact count.
        dead_time: after an event, in which the sensor reports no other hit of the contact, s.
        mislabelled: probability that an impact is reported for another contact.
        prior: how well the given values of parameters are known, from other sources than these
            events; None if unknown.

    Raises:
        UsageError: something arrives live, the clock's offset is free under a sampled forcing,
            the forcing depends on time and no event says its epoch, or a sensor or a parameter
            does not go with the other.
        BagError: the events contain no impact of the system's contacts.
        IdentificationError: fewer impacts than unknowns, or parameters that move no impact.
        ImpactLawError: the impact law has no solution at an event.
    """
    refused(family.system, "identify")
    refuse_squares(family.system, "identify")
    if family.system.forcing.sampled is not None and OFFSET in family.names:
        raise UsageError(
            f"{family.system.name}: its forcing is sampled, so {OFFSET} cannot be identified;"
            " expected other parameters, or a constant and harmonics"
        )
    episode = last_episode(family.system, events)
    require_epoch(family.system, max(each.epoch for each in events))
    report = FitProgress(progress)
    whole = Recording(episode, report=report, dead_time=dead_time, mislabelled=mislabelled)
    whole = _with_samples(whole, family, clock, measurements, samples)
    search = _Search(family, events, whole, clock, trust_events, measurements, samples, report)
    if (with_prior := _with_prior(whole, family, clock, prior)) is whole:
        return search.identification()
    found = search._replace(whole=with_prior).identification()
    if found.converged and chance_of(found.prior_shifts) >= DOUBTED:
        return found
    report.stage("without the declared deviations")
    plain = search._replace(trust_events=True, is_grown=False, is_smoothed=True)
    try:
        if not explained(plain.fit_as_reported().solution, clock):
            return found
        alone = search.identification()
    except IdentificationError:  # impacts alone do not determine all that is free
        return found
    return replace(alone, refuted=prior) if check_fit(alone).fits and alone.converged else found


class _Fitted(NamedTuple):
    """A fit, with its problem and solution."""

    identification: Identification
    problem: Problem
    solution: Solution


class _Search(NamedTuple):
    """The input of ``identify``, and the ways to a fit.

    ``whole`` has all events accepted; ``is_grown`` says whether fits of more and more impacts are
    tried where others fail, and ``is_smoothed`` whether the smoothed motion is tried no more.
    """

    family: ParametricFamily
    events: list[ImpactEvent]
    whole: Recording
    clock: float | None
    trust_events: bool
    measurements: Sequence[Measurement]
    samples: Sequence[SensorSample]
    report: FitProgress
    is_grown: bool = True
    is_smoothed: bool = False

    def identification(self) -> Identification:
        """The fit, checked on the last impacts, with the parameters that were not free."""
        fitted = self.unexplained() or self.with_fewer_outliers(self.explaining_fit())
        own, problem, solution = fitted
        is_checked = own.converged or self.trust_events
        checked = last_impacts(problem, solution, _HELD_BACK) if is_checked else None
        return self.with_others(fitted._replace(identification=replace(own, held_back=checked)))

    def explaining_fit(self) -> _Fitted:
        """The fit, by the first way that leads to a motion that explains the stamps."""
        if not self._is_often_mislabelled:
            if self.clock is None or not is_crowded(self.whole, self.clock):
                return self.fit_from_events()
            return self._smoothed(self.clock) or self._replace(is_smoothed=True).fit_from_events()
        interval = self.whole.problem(self.family).interval
        smoothed = self._smoothed(_SUSPICIOUS * interval if self.clock is None else self.clock)
        if smoothed and smoothed.identification.converged:
            return smoothed
        try:
            fitted = self._replace(is_smoothed=self.clock is not None).fit_from_events()
        except IdentificationError:  # of contacts that no event names, for example
            if smoothed is None:
                raise
            return smoothed
        return fitted if fitted.identification.converged else smoothed or fitted

    def with_fewer_outliers(self, fitted: _Fitted) -> _Fitted:
        """The fit, or that of the motion smoothed with its values if this has fewer outliers.

        A fit that began with wrong values may have a hit twice: rejected, and inserted beside.
        """
        found = fitted.identification
        interval = self.whole.problem(self.family).interval
        if not found.converged or not has_hit_twice(found.recording, interval):
            return fitted
        change = found.values - self.family.nominal
        again = self._smoothed_with((), (), self.clock, change, _SHARES[-1])
        if again is None or not again.identification.converged:
            return fitted
        is_better = again.identification.recording.outliers < found.recording.outliers
        return again if is_better and self._explains(*again[1:]) else fitted

    def fit_from_events(self) -> _Fitted:
        """The fit that begins at the events, by the first way that leads to one."""
        whole, closings = self.whole, as_closings(self.whole, self.family.system)
        if has_rows(whole, self.family.system):
            begins = (whole, closings) if whole.dead_time else (whole,)
            tried = starmap(self._with_rows, product(begins, phase_changes(self.family)))
            if rowed := next(filter(None, tried), None):
                return rowed
        fitted = self._replace(whole=opened(whole)).fit_as_reported()
        is_short = self.is_grown and len(whole.episode.keys) <= _UNDECLARED
        if fitted.identification.converged or whole.dead_time or not is_short:
            return fitted
        unchanged = np.zeros(self.family.size)
        rowed = self._with_rows(closings, unchanged) if closings.is_debounced else None
        return rowed if rowed and dead_time_of(rowed.identification.recording) else fitted

    def fit_as_reported(self) -> _Fitted:
        """The fit without bounces that the sensor does not report."""
        family = self.family
        if begun := self._scattered_as_the_first():
            return begun
        self.report.stage("all impacts accepted")
        problem, solution = gated(*fit(self.whole.problem(family)))
        first = self._accepting(self.whole, problem, solution)
        plain = _Fitted(first, problem, solution)
        if not explained(solution, self.clock) and (scattered := self._scattered(plain)):
            return scattered
        if self._explains(problem, solution) or (self.trust_events and first.converged):
            return plain
        reached: Grown | None = None
        if turns := bool(phases_of(self.family)):  # a fit half a turn off rejects what is right
            reached, begun = self._grown(problem)
            if begun is not None:
                return begun
        fitted = plain if self.trust_events else self._searched(plain)
        if not fitted.identification.converged and self.is_grown and not turns:
            reached, begun = self._grown(problem)
            if begun is not None:
                return begun
        is_part = reached is not None and reached.moments < len(problem.moments)
        own = replace(fitted.identification, reached=reached if is_part else None)
        return fitted._replace(identification=own)

    def _with_rows(self, recording: Recording, change: Vector) -> _Fitted | None:
        """The fit with the bounces that the sensor does not report; None if it explains nothing.

        The search begins without bounces: a contact that closes rests, until it hits again where
        no opening is reported.
        """
        self.report.stage("bounces that are not reported")
        try:
            with self.report.at_most(_MOTIONS * self._size):
                fitted = self._rowed(recording, change)
        except (IdentificationError, DynamicsError, ModelError, linalg.LinAlgError):
            return None
        is_one = fitted.identification.recording.rows and self._explains(*fitted[1:])
        return fitted if is_one else None

    def _rowed(self, recording: Recording, change: Vector) -> _Fitted:
        """The fit with the bounces that it makes itself, begun without any, and with given values.

        The given values and ``change``, shape (p,), are added.

        A contact that does not bounce says nothing of its restitution.
        """
        n2, begin = 2 * self.family.system.n, self.family.nominal + change
        given = ParametricFamily(self.family.system_at(begin), ())
        problem, solution = fit(recording.problem(given))
        if not problem.has_closings and is_lost(problem, solution.shifts, solution.freedom):
            raise IdentificationError(
                "bounces of a motion that is far from the events say nothing"
            )
        for family in (given, self.family):
            y = np.concatenate([solution.y[:n2], begin[: family.size]])
            failures = 0
            for _ in range(_ROW_ROUNDS):
                after = with_rows(recording, problem, solution, self.clock or 0.0)
                if failures == _FAILURES or (
                    is_same(after, recording) and problem.family is family
                ):
                    break
                recording = after
                problem, solution = weighed(recording.problem(family), y)
                lost = not solution.converged or is_lost(
                    problem, solution.shifts, solution.freedom
                )
                y, failures = solution.y, failures + 1 if lost else 0
            if not self.family.size:
                break
        problem, solution = gated(problem, solution)
        return _Fitted(self._accepting(recording, problem, solution), problem, solution)

    def _scattered(self, plain: _Fitted) -> _Fitted | None:
        """The fit in which impulses scatter; None if this explains the impacts no better.

        The fit begins at the given parameters, then at those of a ``plain`` fit.
        """
        problem, solution = plain.problem, plain.solution
        if not may_scatter(problem):
            return None
        near = [start_of(problem)] + ([solution.y] if solution.converged else [])
        begun = with_scatter(problem, self.clock, solution.rms)
        found = next(filter(None, (self._scattered_near(begun, y) for y in near)), None)
        if found is None:
            return None
        others = fits_with_others(
            parameters_beside(self.family),
            [problem],
            solution,
            self.clock,
            is_lost=not solution.converged,
            flights=_OF_ANOTHER * self._size,
        )
        return None if any(each.fits for each in others) else found

    def _scattered_near(self, problem: Problem, y: Vector) -> _Fitted | None:
        """The fit in which impulses scatter, searched from a ``y`` nearby; None if none is."""
        self.report.stage("impulses that scatter")
        with self.report.at_most(_OF_SCATTER * self._size), suppress(*_NO_MOTION):
            found = weighed(problem, y)
            if is_scatter_accepted(found[1], self.clock):
                return _Fitted(self._accepting(self.whole, *found), *found)
        return None

    def _scattered_as_the_first(self) -> _Fitted | None:
        """The fit in which impulses scatter, if they do so in the first part of a recording.

        A fit without scatter takes longest where there is one.
        """
        if len(self.whole.episode.keys) <= _FIRST or not may_scatter(
            problem := self.whole.problem(self.family)
        ):
            return None
        part = self._replace(whole=self._part(0, _FIRST), trust_events=True, is_grown=False)
        first = part.fit_as_reported()
        if not first.identification.scatter:
            return None
        begun = with_scatter(problem, self.clock, first.problem.clock)
        return self._scattered_near(begun, first.solution.y)

    def _accepting(
        self, recording: Recording, problem: Problem, solution: Solution
    ) -> Identification:
        """The identification by a fit of a ``recording``, with the usual shift of that fit."""
        found = _identification(recording, problem, solution, self.clock)
        accepted = max(usual_size(solution.shifts, solution.freedom), ROUNDED)
        return replace(found, accepted=accepted)

    def _searched(self, plain: _Fitted) -> _Fitted:
        """The fit that a search for outliers finds, after a ``plain`` one of all impacts."""
        smoothed = None if self.is_smoothed else self._smoothed(self.clock)
        if smoothed and smoothed.identification.converged:
            return smoothed
        with self.report.at_most(_MOTIONS * self._size):
            return self._without_outliers(plain)

    def _grown(self, problem: Problem) -> tuple[Grown | None, _Fitted | None]:
        """How far fits of more and more impacts come, and the fit of all of them, if one is."""

        def explains(part: Problem, solution: Solution) -> bool:
            usual = usual_size(solution.shifts, solution.freedom)
            return solution.converged and solution.is_outside and usual <= self._least(part)

        self.report.stage(stage_of(problem))
        with self.report.at_most(_MOTIONS * self._size):
            reached = grown(problem, explains, self.report)
        if reached is None or reached.moments < len(problem.moments):
            return reached, None
        problem, solution = gated(*fit(problem, reached.y))
        recording = self.whole
        if not self.trust_events and not self._explains(problem, solution):
            self.report.stage("spurious and missed impacts")
            try:
                with self.report.at_most(_MOTIONS * self._size):
                    recording, problem, solution = without_outliers(
                        self.whole, self.family, self.clock, reached.y
                    )
            except IdentificationError:  # too few impacts are left, or nothing is found in time
                return reached, None
            problem, solution = gated(problem, solution)
        own = self._accepting(recording, problem, solution)
        own = replace(own, doubted=recording.outliers)
        return reached, _Fitted(own, problem, solution) if own.converged else None

    @property
    def _within(self) -> list[SensorSample]:
        """The samples up to the last event."""
        last = self.whole.episode.keys[-1].stamp
        return [each for each in self.samples if each.stamp <= last]

    @property
    def _size(self) -> int:
        """Flights of a motion of all impacts, as a search counts them."""
        return max(len(self.whole.episode.keys), _FEW)

    def unexplained(self) -> _Fitted | None:
        """The fit of the first events of a long recording, none of whose parts a motion explains.

        None if a motion may explain the whole: a motion that does explains the parts, too.
        """
        keys = self.whole.episode.keys
        is_plain = all(kind is Kind.IMPACT for key in keys for _, kind in key.switches)
        if self.measurements or not is_plain or len(keys) <= 2 * _FIRST:
            return None
        first = self._part(0, _FIRST)
        events = [each for each in self.events if each.stamp <= keys[_FIRST - 1].stamp]
        fitted = self._replace(events=events, whole=first).explaining_fit()
        if fitted.identification.converged:
            return None
        starts = np.linspace(_FIRST, len(keys) - _PART, _PARTS).astype(int).tolist()
        for number, start in enumerate(starts):
            self.report.stage(f"part {number + 1} of {len(starts)}")
            part = self._replace(
                whole=self._part(start, start + _PART), trust_events=True, is_grown=False
            )
            if part.explaining_fit().identification.converged:
                return None
        left = replace(fitted.identification, unsearched=len(keys) - _FIRST)
        return fitted._replace(identification=left)

    def _part(self, begin: int, end: int) -> Recording:
        """The recording of some of the events, from the event before them."""
        episode = self.whole.episode
        start = episode.keys[begin - 1].stamp if begin else episode.start
        part = episode._replace(keys=episode.keys[begin:end], start=start)
        return replace(self.whole, episode=part)

    def with_others(self, fitted: _Fitted) -> Identification:
        """The identification with the fits of other parameters, if the model does not fit.

        The standard errors become at least the changes of the values by these fits.
        """
        own, problem, solution = fitted
        rows, tried = (problem, solution, self.clock), parameters_beside(self.family)
        limit = DOUBTED if own.scatter else REJECTED
        missed = missed_parameters(*rows, limit) if own.converged else ()
        own = replace(own, missed=tuple(each.name for each in missed))
        odd = missed or own.large or not all(each.fits for each in own.sensors)
        if own.converged and not odd and explained(solution, self.clock):
            return own
        self.report.stage("other parameters")
        problems = [self.whole.problem(self.family)] if own.recording.outliers else []
        if own.converged or not problems:
            problems.append(problem)
        if own.converged:
            tried = missed_parameters(*rows, DOUBTED)
        lost = not own.converged
        flights = (_OF_SCATTER if own.scatter else _OF_ANOTHER) * self._size
        others = fits_with_others(
            tried, problems, solution, self.clock, is_lost=lost, flights=flights
        )
        moved = [np.abs(each.values - own.values) / own.errors for each in others if own.converged]
        more = max((float(np.max(each, initial=1.0)) for each in moved), default=1.0)
        covariance, widened = frozen(own.covariance * more**2), own.widened * more
        return replace(own, others=others, covariance=covariance, widened=widened)

    def _explains(self, problem: Problem, solution: Solution) -> bool:
        """Whether a fit is good enough to need no search for outliers.

        Of a few shifts the declared clock error often gives a larger rms than of many.
        """
        if not (solution.converged and solution.is_outside):
            return False
        size = 0.0
        if self.clock is not None:
            clock = max(self.clock, ROUNDED)
            size = probability_of_size(solution.shifts, clock, solution.freedom)
        return solution.rms <= self._least(problem) or size >= DOUBTED

    @property
    def _is_often_mislabelled(self) -> bool:
        """Whether events are declared to name another contact more often than is usual.

        A fit of all impacts begins with wrong contacts then; a filter finds the right ones.
        """
        is_many = self.whole.mislabelled > Options.mislabelled and self.family.system.m > 1
        return is_many and not self.trust_events

    def _least(self, problem: Problem) -> float:
        """The usual shift up to which a fit needs no search for outliers, s."""
        clock = self.clock
        return _SUSPICIOUS * problem.interval if clock is None else _EXCESS * max(clock, 1e-9)

    def _smoothed(self, clock: float | None) -> _Fitted | None:
        """The fit that begins at a smoothed motion; None if there is no such motion.

        Where there are samples, a few of them are smoothed with the impacts: wrong phases are
        given up after the first impacts. Impacts alone follow. A filter that allows its parameters
        much may settle at wrong ones, and then one that allows them less is tried. Phases that are
        free begin all around the circle. ``clock`` is the approximate standard deviation of a
        stamp, s; None if unknown.
        """
        fitted: _Fitted | None = None
        events = len(self.whole.episode.keys)
        sensed = (self.measurements, enough_samples(self._within, events))
        besides = (sensed, ((), ())) if self.measurements else (sensed,)
        for beside, change in product(besides, [*phase_changes(self.family)]):
            for share in _SHARES[:1] if np.any(change) else _SHARES:
                fitted = self._smoothed_with(*beside, clock, change, share) or fitted
                if fitted and fitted.identification.converged:
                    return fitted
        return fitted

    def _smoothed_with(
        self,
        measurements: Sequence[Measurement],
        samples: Sequence[SensorSample],
        clock: float | None,
        change: Vector,
        share: float,
    ) -> _Fitted | None:
        """The fit that begins at the motion smoothed from impacts and these samples, if any is."""
        self.report.stage("smoothed motion")
        start = smoothed_start(
            self.family,
            self.whole,
            self.events,
            clock,
            self._least(self.whole.problem(self.family)),
            change=change,
            share=share,
            trust_events=self.trust_events,
            measurements=measurements,
            samples=samples,
            report=self.report,
        )
        if start is None:
            return None
        try:
            recording, y = start
            problem, solution = gated(*fit(recording.problem(self.family), y))
            is_left = solution.converged and not self._explains(problem, solution)
            if is_left and not self.trust_events:
                recording, problem, solution = without_outliers(
                    recording, self.family, self.clock, y
                )
                problem, solution = gated(problem, solution)
        except (IdentificationError, DynamicsError):
            return None  # too few impacts are left, or the motion has no solution
        identification = _identification(recording, problem, solution, self.clock)
        identification = replace(
            identification, doubted=recording.outliers, accepted=identification.rms
        )
        return _Fitted(identification, problem, solution)

    def _without_outliers(self, before: _Fitted) -> _Fitted:
        """The fit without spurious impacts and with missed ones, after one of all impacts."""
        first, problem, _ = before
        # Right impacts are rejected where the declared clock error is too small.
        explained = first.converged and first.rms <= _SUSPICIOUS * problem.interval
        left = before._replace(identification=replace(first, converged=explained))
        self.report.stage("spurious and missed impacts")
        try:
            recording, again, refit = without_outliers(self.whole, self.family, self.clock)
            again, refit = gated(again, refit)
        except (IdentificationError, DynamicsError):
            return left  # too few impacts are left, or none is found in time, or by this motion
        found = _identification(recording, again, refit, self.clock)
        fitted = left if explained and not found.converged else _Fitted(found, again, refit)
        own = replace(fitted.identification, doubted=recording.outliers, accepted=first.accepted)
        return fitted._replace(identification=own)


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
    counted = used_samples(family, measurements, samples, episode.epoch, within)
    return _weighing(replace(recording, sensors=counted), family, clock)


def _with_prior(
    recording: Recording,
    family: ParametricFamily,
    clock: float | None,
    prior: ParameterUncertainty | None,
) -> Recording:
    """The recording with a ``prior`` of parameters of the family, if there is any."""
    if not prior_covariance(prior, family)[0]:
        return recording
    first = _SUSPICIOUS * recording.problem(family).interval
    return replace(_weighing(recording, family, clock), prior=prior, first_clock=first)


def _weighing(recording: Recording, family: ParametricFamily, clock: float | None) -> Recording:
    """The recording with the error of its clock, declared or a first guess."""
    known = _SUSPICIOUS * recording.problem(family).interval if clock is None else clock
    return replace(recording, clock=max(known, ROUNDED), is_declared=clock is not None)


def _identification(
    recording: Recording, problem: Problem, solution: Solution, clock: float | None
) -> Identification:
    family, n = problem.family, problem.family.system.n
    shown = solution.rms if solution.scattered is None else solution.scattered.shown.clock
    used = max(shown if clock is None else clock, ROUNDED)
    fits = sensor_fits(problem, solution)
    widened = max(widening(solution, clock), *(each.widening for each in fits), 1.0)
    root = solution.root * used * widened
    covariance = root @ root.T
    span = directions(problem, solution.shot)
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
        residuals=frozen(solution.residuals),
        redundancy=solution.redundancy,
        scatter=0.0 if solution.scattered is None else solution.scattered.shown.scatter,
        singular=frozen(span.singular / span.singular[0]),
        lost=span.lost[: 2 * n],
        undetermined=combinations_of(problem, np.hstack([span.undetermined, weak])),
        converged=solution.converged
        and solution.is_outside
        and solution.rms <= max(_LOST * problem.usual_flight, _EXCESS * (clock or 0.0))
        and solution.counted.size >= _ACCEPTED * (solution.counted.size + recording.outliers),
    )
