# SPDX-License-Identifier: Apache-2.0
"""Cases of a sweep: a run of the plant, its sensor, an observer, and metrics of its estimate.

A new metric is a field of ``Outcome`` with the key of a metric of ``compare``; the column of the
file follows.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from impact_observer.compare.comparison import Comparison, compare_observer
from impact_observer.compare.metrics import METRICS
from impact_observer.compare.replicas import compare_replicas
from impact_observer.errors import ImpactObserverError
from impact_observer.events import ImpactEvent
from impact_observer.io.pairing import samples_of
from impact_observer.io.simulated_samples import (
    SampleFaults,
    SampleSimulation,
    samples_of_run,
)
from impact_observer.model import System
from impact_observer.observer import ReplicaLaw, initial_state, make_observer
from impact_observer.observer.samples import SensorSample
from impact_observer.plant import Run, simulate_sensor
from impact_observer.sweep.plan import Case, parsed, plant_run


@dataclass(frozen=True, slots=True)
class Outcome:
    """The metrics of a case; None for an undefined metric.

    Attributes:
        case: number of the case.
        settling_time: until V stays below ``settled`` times ``V_start``, s; None for never.
        V_start: V at the start, J.
        V_end: V at the end, J.
        V_ratio: V at the end over V at the start; None if V starts at zero.
        V_largest_rise: largest rise of V from one sample to the next, over V at the start.
        rate_per_second: decrease of ln V in a second; None if it did not decrease.
        rate_per_impact: decrease of ln V for each impact used; None if it did not decrease.
        events: reported by the sensor.
        impacts_used: reported or inserted.
        switches_rejected: of the reported ones.
        impacts_inserted: as missed detections.
        error: why the metrics are missing; empty if none are.
    """

    case: int
    settling_time: float | None = None
    V_start: float | None = None
    V_end: float | None = None
    V_ratio: float | None = None
    V_largest_rise: float | None = None
    rate_per_second: float | None = None
    rate_per_impact: float | None = None
    events: int | None = None
    impacts_used: int | None = None
    switches_rejected: int | None = None
    impacts_inserted: int | None = None
    error: str = ""


_NAMES = {each.name for each in fields(Outcome)}
_SHOWN = tuple(each for each in METRICS if each.key in _NAMES)
"""The metrics of an outcome."""


def run_case(case: Case) -> Outcome:
    """The outcome of a case, which depends on the case alone.

    A case that fails gives an outcome with the error, and the sweep goes on.
    """
    try:
        return outcome_alone(case)
    except ImpactObserverError as error:
        return Outcome(case.number, error=str(error))
    except Exception as error:  # noqa: BLE001 (a bug in one law must not stop the other cases)
        line = " ".join(f"{type(error).__name__}: {error}".split())
        return Outcome(case.number, error=line)


def run_batch(cases: Sequence[Case]) -> list[Outcome]:
    """The outcomes of one of ``Sweep.batches``: one observer runs all starts at once.

    The outcomes are those of ``run_case`` but for rounding. If a start fails, each case runs by
    itself.
    """
    if len(cases) > 1:
        try:
            return outcomes_together(cases)
        except Exception:  # noqa: BLE001 (the start that has failed will say why)
            pass
    return [run_case(case) for case in cases]


def outcome_alone(case: Case) -> Outcome:
    """The outcome of one case; V is the energy of the plant, also for another model."""
    run, system, events = _sensed(case)
    measurements, samples = case.measurements, list[SensorSample]()
    if measurements:
        faults = SampleFaults(rate=case.plant.rate)
        samples = samples_of_run(SampleSimulation(measurements, system, faults, case.seed), run)
    comparison = compare_observer(
        make_observer(parsed(case.variant.text), case.options, measurements=measurements),
        events,
        samples_of(run.stamps, run.states),
        system=system,
        settled=case.settled,
        needs_event=False,
        samples=samples,
    )
    return _outcome_of(case, comparison, len(events))


def outcomes_together(cases: Sequence[Case]) -> list[Outcome]:
    """The outcomes of cases with equal events."""
    first = cases[0]
    run, system, events = _sensed(first)
    model = parsed(first.variant.text)
    deviation = first.options.initial_deviation
    starts = (initial_state(each.initial_state, model.system, deviation) for each in cases[1:])
    others = [np.concatenate(each) for each in starts]
    options = replace(first.options, ensemble=len(cases))
    observer = make_observer(model, options, others=np.array(others))
    assert isinstance(observer.law, ReplicaLaw), "only these have batches"
    observer.law.forgives = False
    comparisons = compare_replicas(
        observer, events, run.stamps, run.states, system=system, settled=first.settled
    )
    return [_outcome_of(*each, len(events)) for each in zip(cases, comparisons, strict=True)]


def _sensed(case: Case) -> tuple[Run, System, list[ImpactEvent]]:
    """The plant's run, the plant, and the events that its sensor reports."""
    run, system = plant_run(case.plant), parsed(case.plant.text).system
    sensed = simulate_sensor(
        case.sensor,
        system,
        run.switchings,
        epoch=run.epoch,
        last=int(run.stamps[-1]),
        seed=case.seed,
    )
    events = sorted((each.event for each in sensed), key=lambda each: (each.stamp, each.sequence))
    return run, system, events


def _outcome_of(case: Case, comparison: Comparison, events: int) -> Outcome:
    shown = {each.key: each.value(comparison) for each in _SHOWN}
    return Outcome(case=case.number, events=events, **shown)
