# SPDX-License-Identifier: Apache-2.0
"""From a recording of impact times to the parameters of its model."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from impact_observer.batch.explanation import Explanation, explanation
from impact_observer.batch.motion_fit import BatchProblem, MotionFit, fitted
from impact_observer.batch.recorded_run import RecordedRun
from impact_observer.batch.sample_rows import flight_samples
from impact_observer.batch.verdict import FitVerdict, verdict_on
from impact_observer.draw.reports import counted
from impact_observer.errors import DynamicsError, IdentificationError, UsageError
from impact_observer.events import ImpactEvent
from impact_observer.model.contact_sensors import NO_SENSORS, ContactErrors, ContactSensors
from impact_observer.model.free_parameters import OFFSET, is_phase, parameters_beside
from impact_observer.model.live_signals import refused
from impact_observer.model.measurement import Measurement
from impact_observer.model.parameter_uncertainty import ParameterUncertainty, root_in_own_units
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.model.system import refuse_squares
from impact_observer.observer import Options
from impact_observer.observer.observer import require_epoch
from impact_observer.observer.samples import SensorSample
from impact_observer.observer.uncertainty import deviation_of, suggested_deviation
from impact_observer.states import Matrix, Vector

_WIDE = 10.0
"""Deviations of parameters of which none is declared, over their sizes."""
_START = 10.0
"""Deviations of the start, over those that are suggested for a rig of this size."""
_TRIED = 3
"""Other parameters that are tried as the cause of a misfit."""
_INTERPOLATED = 0.01
"""Least standard deviation of a stamp between two samples, over the time between them."""
_ROUNDS_OF_OTHER = 2
"""Linearisations by which other parameters are compared."""


@dataclass(frozen=True, slots=True)
class Cause:
    """A parameter that was not free, with which the model fits or explains much more.

    Attributes:
        name: of the parameter.
        given: as in the model.
        value: with which the model fits best.
        error: standard error of this value.
        found: the motion with the parameter free, too.
    """

    name: str
    given: float
    value: float
    error: float
    found: Explanation

    @property
    def fits(self) -> bool:
        """Whether the model fits with the parameter free, too."""
        return self.found.verdict.fits


@dataclass(frozen=True, eq=False)
class Identification:
    """A model fitted to a recording.

    Attributes:
        family: the given system and its free parameters.
        run: the events.
        found: the account of the events, the motion and the verdict.
        values: of the parameters, shape (p,), SI units.
        covariance: of start and parameters, shape (2n + p, 2n + p); of a model that does not fit
            with noises as large as they may be.
        prior: deviations of the given values; None without.
        causes: parameters that were not free and explain a misfit, the best first.
    """

    family: ParametricFamily
    run: RecordedRun
    found: Explanation
    values: Vector
    covariance: Matrix
    prior: ParameterUncertainty | None = None
    causes: tuple[Cause, ...] = ()

    @property
    def fit(self) -> MotionFit:
        """The motion."""
        return self.found.fit

    @property
    def verdict(self) -> FitVerdict:
        """Whether the model fits."""
        return self.found.verdict

    @property
    def errors(self) -> Vector:
        """Standard errors of the parameters, shape (p,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance))[self.start.size :])

    @property
    def start(self) -> Vector:
        """Initial state (q, u) in the frame, shape (2n,)."""
        return np.asarray(self.fit.states[0][0])

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Names of the parameters of which the recording says nothing."""
        pairs = zip(self.family.parameters, self.errors.tolist(), strict=True)
        return tuple(
            each.name
            for each, error in pairs
            if error > each.deviation_range[1] and not is_phase(each.name)
        )

    @property
    def bounded(self) -> tuple[str, ...]:
        """Names of the parameters at a bound."""
        low, high = self.family.bounds
        at = (self.values <= low) | (self.values >= high)
        return tuple(np.array(self.family.names)[at].tolist())


def identify(
    family: ParametricFamily,
    events: Sequence[ImpactEvent],
    *,
    clock: float | None = None,
    resolution: float = 0.0,
    trust_events: bool = False,
    progress: Callable[[str], None] = lambda _: None,
    measurements: Sequence[Measurement] = (),
    samples: Sequence[SensorSample] = (),
    dead_time: float = Options.dead_time,
    mislabelled: float = Options.mislabelled,
    prior: ParameterUncertainty | None = None,
    sensors: ContactSensors = NO_SENSORS,
) -> Identification:
    """Fit the parameters of a family, and the initial state, to impact times and to samples.

    Args:
        family: a system and its free parameters.
        events: their last episode counts.
        clock: standard deviation of a stamp, s; None to estimate it.
        resolution: time between samples, s; that of printed times is found.
        trust_events: whether to reject no impact as spurious and to insert no missed one.
        progress: receives what is being done.
        measurements: of sensors beside the impacts.
        samples: of these sensors.
        dead_time: after an event, in which the sensor reports no other hit of the contact, s.
        mislabelled: probability that an impact is reported for another contact.
        prior: how well the given values of parameters are known; None if unknown.
        sensors: declared errors of the sensors of single contacts.

    Raises:
        UsageError: something arrives live, the clock's offset is free under a sampled forcing, or
            the forcing depends on time and no event says its epoch.
        BagError: the events contain no impact of the system's contacts.
        IdentificationError: fewer impacts than unknowns, or no motion explains the impacts.
    """
    system = family.system
    refused(system, "identify")
    refuse_squares(system, "identify")
    if system.forcing.sampled is not None and OFFSET in family.names:
        raise UsageError(
            f"{system.name}: its forcing is sampled, so {OFFSET} cannot be identified; expected"
            " other parameters, or a constant and harmonics"
        )
    run = RecordedRun.last(system, events)
    require_epoch(system, max(each.epoch for each in events))
    options = Options(
        dead_time=dead_time,
        mislabelled=mislabelled,
        clock_error=-1.0 if clock is None else clock,
        initial_deviation=suggested_deviation(system) or Options.initial_deviation,
    )
    within = run.start, max(key.stamp for key in run.keys)
    problem = BatchProblem(
        family=family,
        moments=run.reported(),
        mean=np.zeros(2 * system.n),
        start=_START * np.diag(deviation_of(str(options.initial_deviation), system)),
        theta=prior_root(family, prior),
        errors=ContactErrors.of(sensors, system.contact_names, Options.missed),
        clock=clock,
        samples=flight_samples(system, measurements, samples, run.epoch, within),
        dead_time=dead_time,
        least_clock=max(run.rounding, _INTERPOLATED * resolution),
    )
    _check_enough(problem)

    try:
        with np.errstate(all="ignore"):  # far from the answer a trial motion may grow
            found = explanation(
                problem,
                run,
                options=options,
                trusts_events=trust_events,
                resolution=max(resolution, run.resolution),
                show=progress,
            )
            causes = () if found.verdict.fits else _causes(found.fit, progress)
            found = _judged(found)
    except DynamicsError as error:
        raise IdentificationError(str(error)) from None
    turned = np.array([is_phase(name) for name in family.names], dtype=bool)
    values = found.fit.values
    turns = np.round((values - family.nominal) / (2 * np.pi))
    values = values - 2 * np.pi * np.where(turned, turns, 0.0)
    honest = found.fit
    if not found.verdict.fits:  # what no noise explains may be as large as its largest shift
        shift = float(np.max(np.abs(honest.predicted), initial=honest.sizes.clock))
        honest = honest.published(fits=False)
        honest = replace(honest, sizes=honest.sizes._replace(clock=shift))
    return Identification(family, run, found, values, honest.covariance, prior, causes)


def _judged(found: Explanation) -> Explanation:
    """Return the explanation; it does not fit where no stamp is left to judge by."""
    fit = found.fit
    stamps, unknowns = fit.residuals.size, fit.x.shape[1] + fit.problem.family.size
    if fit.problem.samples or stamps > unknowns:
        return found
    reason = f"{counted(stamps, 'stamp')} cannot contradict {unknowns} unknowns, the start too"
    verdict = replace(found.verdict, reasons=(reason, *found.verdict.reasons))
    return replace(found, verdict=verdict)


def prior_root(family: ParametricFamily, prior: ParameterUncertainty | None) -> Matrix:
    """A root of the covariance of the parameters: declared, else wide, shape (p, p)."""
    names = () if prior is None else prior.names
    wide = [
        _WIDE * each.size if not is_phase(each.name) else each.size for each in family.parameters
    ]
    root = np.diag(wide)
    own = [j for j, name in enumerate(family.names) if name in names]
    if prior is None or not own:
        return root
    which = [names.index(family.names[j]) for j in own]
    root[np.ix_(own, own)] = root_in_own_units(prior.covariance[np.ix_(which, which)])
    return root


def _check_enough(problem: BatchProblem) -> None:
    """Raise IdentificationError where a recording has fewer numbers than there are unknowns."""
    unknowns = 2 * problem.family.system.n + problem.family.size
    rows = problem.moments.row_moment.size + sum(len(each.t) for each in problem.samples)
    if rows < unknowns - _declared(problem):
        raise IdentificationError(
            f"{rows} impacts and samples for {unknowns} unknowns, the start among them; expected"
            " more impacts, fewer free parameters, or deviations of the values that are known"
        )


def _declared(problem: BatchProblem) -> int:
    """Return the number of parameters of which a deviation is declared."""
    spread = np.linalg.norm(problem.theta, axis=1)
    return int(np.sum(spread < 0.999 * _WIDE * problem.family.sizes))


def _causes(fit: MotionFit, progress: Callable[[str], None]) -> tuple[Cause, ...]:
    """Return the parameters that explain a misfit, each alone beside those that are free."""
    begun = list[MotionFit]()
    for each in parameters_beside(fit.problem.family):
        progress(f"whether {each.name} is the cause")
        problem = _with(fit.problem, fit.problem.family.extended([each]))
        theta = np.append(fit.values, each.value)
        with suppress(DynamicsError, np.linalg.LinAlgError):
            begun.append(fitted(problem, fit, theta=theta, rounds=_ROUNDS_OF_OTHER))
    begun.sort(key=lambda each: -each.log_density)
    causes = list[Cause]()
    for near in begun[:_TRIED]:
        family = near.problem.family
        progress(f"whether {family.names[-1]} is the cause")
        found = fitted(near.problem, near)
        if found.log_density <= fit.log_density + 1.0:
            continue
        error = float(np.sqrt(found.covariance[-1, -1]))
        own = family.parameters[-1]
        explained = Explanation(found, verdict_on(found), found.log_density)
        causes.append(Cause(own.name, own.value, float(found.values[-1]), error, explained))
        if causes[-1].fits:
            break
    return tuple(sorted(causes, key=lambda each: not each.fits))


def _with(problem: BatchProblem, family: ParametricFamily) -> BatchProblem:
    """Return the problem in which the last parameter of ``family`` is free, too."""
    theta = block_diag(problem.theta, [[_WIDE * family.sizes[-1]]])
    return replace(problem, family=family, theta=theta)
