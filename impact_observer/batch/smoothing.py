# SPDX-License-Identifier: Apache-2.0
"""Smooths the events of a recording, each run of the sender by itself."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from scipy.linalg import block_diag

from impact_observer.batch.explanation import Explanation, explanation
from impact_observer.batch.filter_account import TracedLaw
from impact_observer.batch.motion_fit import BatchProblem
from impact_observer.batch.recorded_run import RecordedRun
from impact_observer.batch.sample_rows import flight_samples
from impact_observer.batch.smoothed_run import SmoothedRun
from impact_observer.errors import BagError, UsageError
from impact_observer.events import ImpactEvent
from impact_observer.model import Model, System
from impact_observer.model.contact_sensors import NO_SENSORS, ContactErrors
from impact_observer.model.free_parameters import OFFSET, parameters_beside, parametric_family
from impact_observer.model.measurement import Measurement
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.model.system import refuse_squares
from impact_observer.observer import Options, initial_state, make_observer
from impact_observer.observer.observer import require_epoch
from impact_observer.observer.samples import SensorSample
from impact_observer.observer.sender_runs import runs_of
from impact_observer.observer.uncertainty import Uncertainty
from impact_observer.stamps import MAX_STAMP
from impact_observer.states import Matrix

Progress: TypeAlias = Callable[[str, int, int], None]
"""Called with the name of the job, the part done, and the total, 0 where unknown."""
Connected: TypeAlias = Callable[[System, int], System]
"""The system with its live forces, by the stamp of ``t = 0``, ns."""
_FITTED = 30.0
"""Prior deviations of parameters that were fitted to the same events, over the declared ones:
the events count 0.1 % twice."""


def no_progress(what: str, done: int, total: int) -> None:
    """Do nothing."""
    del what, done, total


def _as_given(system: System, epoch: int) -> System:
    """Return a system without live forces."""
    del epoch
    return system


def smoothed_runs(
    model: Model | System,
    events: Sequence[ImpactEvent],
    options: Options,
    *,
    measurements: Sequence[Measurement] = (),
    samples: Sequence[SensorSample] = (),
    progress: Progress = no_progress,
    connected: Connected = _as_given,
    known: Explanation | None = None,
) -> list[SmoothedRun]:
    """The smoothed motion in each run of the sender in a recording, in order.

    Args:
        model: the model, or the system alone.
        events: in order of reception.
        options: of the observer.
        measurements: of sensors beside the impacts.
        samples: of these sensors, in order of stamps.
        progress: see ``Progress``.
        connected: gives the system the recorded samples of live forces.
        known: the motion of the last run, where it was found before.

    Raises:
        UsageError: an option cannot be used, or the model is a robot.
        BagError: the recording holds no impact.
        DynamicsError: no motion explains the events.
    """
    if isinstance(model, Model) and model.robot is not None:
        raise UsageError("smooth: the model is a robot; expected observe, which takes robots")
    if options.model_error >= 0:
        raise UsageError(
            f"model_error: {options.model_error:g} found; smooth finds the error of the model"
        )
    runs = runs_of(events)
    if not runs:
        raise BagError("it holds no impact")
    begins = [min(each.stamp for each in run) for run in runs]
    found = list[SmoothedRun]()
    for own, (begin, end) in zip(runs, pairwise([*begins, MAX_STAMP + 1]), strict=True):
        first = begin if found else 0
        near = [each for each in samples if first <= each.stamp < end]
        found.append(
            _smoothed(
                model,
                own,
                options,
                measurements,
                near,
                progress,
                connected,
                known if end > MAX_STAMP else None,
            )
        )
    if not any(each.fit.problem.moments.each for each in found):
        raise BagError("no impact was applied")
    return found


def _smoothed(  # noqa: PLR0917
    model: Model | System,
    events: Sequence[ImpactEvent],
    options: Options,
    measurements: Sequence[Measurement],
    samples: Sequence[SensorSample],
    progress: Progress,
    connected: Connected,
    known: Explanation | None,
) -> SmoothedRun:
    given = model.system if isinstance(model, Model) else model
    epoch = options.epoch or max(each.epoch for each in events)
    refuse_squares(given, "smooth")
    require_epoch(given, epoch)
    system = replace(connected(given, epoch), live=None)
    chosen = replace(options, law=TracedLaw.name, ensemble=1, epoch=epoch)
    declared = make_observer(model, chosen, law=TracedLaw).law.uncertainty
    run = RecordedRun.of(system, events, epoch)
    if not run.keys:
        raise BagError("it holds no impact of the model's contacts")
    if known is not None:
        return SmoothedRun(run, known, declared)
    sensors = model.sensors if isinstance(model, Model) else NO_SENSORS
    uncertain = model.uncertainty if isinstance(model, Model) else None
    is_fitted = uncertain is not None and uncertain.is_fitted_to(key.stamp for key in run.keys)
    family, root = _unknowns(model, system, declared, _FITTED if is_fitted else 1.0)
    last = max([*(key.stamp for key in run.keys), *(each.stamp for each in samples)])
    x = np.concatenate(initial_state(options.initial_state, system))
    at = np.array([run.start - run.epoch])
    problem = BatchProblem(
        family=family,
        moments=run.reported(),
        mean=system.to_frame(at, x[None])[0],
        start=declared.root(system.n),
        theta=root,
        errors=ContactErrors.of(sensors, system.contact_names, options.missed),
        clock=declared.clock_error,
        samples=flight_samples(system, measurements, samples, run.epoch, (run.start, last)),
        dead_time=options.dead_time,
        least_clock=run.rounding,
    )

    with np.errstate(all="ignore"):
        found: Explanation = explanation(
            problem,
            run,
            options=options,
            trusts_events=declared.trusts_events,
            show=lambda what: progress(what, 0, 0),
        )
    return SmoothedRun(run, found, declared)


def _unknowns(
    model: Model | System, system: System, declared: Uncertainty, factor: float
) -> tuple[ParametricFamily, Matrix]:
    """Return the uncertain parameters, with the root of their covariance."""
    family, root = ParametricFamily(system, ()), np.zeros((0, 0))
    if (unknowns := declared.unknowns) is not None:
        family, root = ParametricFamily(system, unknowns.family.parameters), unknowns.root
    known = model.uncertainty if isinstance(model, Model) else None
    for name, deviation in () if known is None else known.deviation_by_name.items():
        if name not in family.names and deviation:  # of the motion of a ground
            assert isinstance(model, Model), "its numbers have deviations"
            family = family.extended(parametric_family(system, (name,), model.elements).parameters)
            root = block_diag(root, [[deviation]])
    root = factor * root
    if late := declared.clock_offset_error:
        offset = next(each for each in parameters_beside(family) if each.name == OFFSET)
        family, root = family.extended([offset]), block_diag(root, [[late]])
    return family, root
