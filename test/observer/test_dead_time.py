# SPDX-License-Identifier: Apache-2.0
"""A sensor's dead time that is declared: the hits in it are no missed detections."""

from collections.abc import Sequence

import numpy as np
import pytest
from systems import EPOCH, run, sample

from impact_observer.batch.smoothing import smoothed_runs
from impact_observer.events import ImpactEvent, Ruling, Verdict, final_rulings, rejected_impacts
from impact_observer.observer import Options, make_observer, replay
from impact_observer.plant import Run, SensorModel, simulate_sensor
from impact_observer.states import Estimate

DEAD = 0.6
"""Of the sensor, s: 21 of the 46 hits of a minute are lost in it."""


def recorded(jitter: float) -> tuple[Run, list[ImpactEvent]]:
    """A minute of two_mass, and what a sensor with a dead time reports of it."""
    model = sample("two_mass")
    made = run(model.system, *model.initial_state(), seconds=60.0, rate=10.0)
    sensor, last = SensorModel(dead_time=DEAD, jitter=jitter), int(made.stamps[-1])
    messages = simulate_sensor(
        sensor, model.system, made.switchings, epoch=EPOCH, last=last, seed=3
    )
    return made, sorted((each.event for each in messages), key=lambda each: each.stamp)


def observed(
    made: Run, events: Sequence[ImpactEvent], options: Options
) -> tuple[list[Estimate], list[Verdict]]:
    """The estimates at the stamps of a run, and the verdicts."""
    observer = make_observer(sample("two_mass").system, options)
    every = [*replay(observer, list(events), made.stamps)]
    estimates = [each for each in every if isinstance(each, Estimate)]
    return estimates, [each for each in every if isinstance(each, Verdict)]


def declared(dead_time: float, jitter: float) -> Options:
    """Everything else at its default but the clock, which is known."""
    return Options(
        law="minimum-variance", dead_time=dead_time, clock_error=jitter, ensemble=1, history=100.0
    )


@pytest.mark.long
@pytest.mark.parametrize("jitter", [0.0, 1e-3])
def test_hits_in_a_declared_dead_time_are_no_misfit(jitter: float) -> None:
    """All are inserted, no event is rejected, and no model is doubted."""
    made, events = recorded(jitter)
    estimates, verdicts = observed(made, events, declared(DEAD, jitter))
    assert not any(each.misfit for each in estimates)
    final = final_rulings(verdicts)
    assert [*final.values()].count(Ruling.INSERTED) >= 20
    assert not rejected_impacts(final, events)
    inserted = [each for each in verdicts if each.ruling is Ruling.INSERTED]
    assert all("in the dead time" in each.reason for each in inserted)
    half = len(made.stamps) // 2
    errors = np.array([[*each.q, *each.u] for each in estimates]) - made.states
    deviations = np.sqrt([np.diag(np.asarray(each.covariance)) for each in estimates])
    z = np.abs(errors / deviations)[half:]
    assert np.mean(z < 2.0) > 0.9
    assert np.max(np.abs(errors[half:])) < max(0.02 * jitter / 1e-3, 1e-8)


@pytest.mark.long
def test_a_smoothed_recording_knows_the_dead_time() -> None:
    """Impacts that the sensor could not report are inserted, and the model fits."""
    _, events = recorded(1e-3)
    (motion,) = smoothed_runs(sample("two_mass").system, events, declared(DEAD, 1e-3))
    inserted = sum(not each.is_measured for each in motion.fit.problem.moments.each)
    assert inserted >= 20
    assert not motion.misfit
