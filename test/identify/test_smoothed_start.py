# SPDX-License-Identifier: Apache-2.0
"""A fit in a recording of bounces that settle begins at its smoothed motion."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from systems import EPOCH, Harmonic, forcing, run, system

from impact_observer.events import ImpactEvent, Kind
from impact_observer.identify import fit_report
from impact_observer.identify.first_guess import state_of_least_gaps
from impact_observer.identify.fit_check import check_fit
from impact_observer.identify.identification import identify
from impact_observer.identify.recorded_impacts import Recording
from impact_observer.identify.smoothed_start import (
    enough_samples,
    first_hits_from_inside,
    is_crowded,
)
from impact_observer.model import Model, System, parse_model
from impact_observer.model.free_parameters import parametric_family
from impact_observer.observer.episode import last_episode
from impact_observer.observer.samples import SensorSample
from impact_observer.plant import SensorModel, simulate_sensor

JITTER = 1e-4


def drill() -> System:
    """A hammer and a bit on springs; their hits bounce until the bit is carried along."""
    return system(
        np.diag([1.0, 0.5]),
        np.diag([10.0, 20.0]),
        np.diag([8000.0, 20000.0]),
        contacts=[([-1.0, 1.0], 0.001, 0.6)],
        force=forcing(2, 0.0, [Harmonic(75.4, [20.0, 0.0], [0.0, 0.0])]),
    )


def sensed(seconds: float, **faults: float) -> list[ImpactEvent]:
    """What a sensor reports of the drill, from rest."""
    model = drill()
    made = run(model, [0.0, 0.0], [0.0, 0.0], seconds=seconds)
    sensor = SensorModel(**faults)  # type: ignore[arg-type]
    last = int(made.stamps[-1])
    messages = simulate_sensor(sensor, model, made.switchings, epoch=EPOCH, last=last, seed=2)
    return sorted((each.event for each in messages), key=lambda each: each.stamp)


def guess() -> System:
    """The drill with a restitution that is 0.1 off and a gap that is a tenth off."""
    (hit,) = drill().contacts
    return replace(drill(), contacts=(replace(hit, restitution=0.5, gap=0.0011),))


def test_events_are_crowded_where_bounces_settle_within_errors_of_the_clock() -> None:
    """Of the first cycles every fourth hit follows another within 0.8 ms; within 8 us none."""
    events = sensed(0.2, jitter=JITTER)
    recording = Recording(last_episode(drill(), events))
    assert is_crowded(recording, JITTER)
    early = [each for each in events if each.stamp < EPOCH + 90_000_000]
    assert not is_crowded(Recording(last_episode(drill(), early)), JITTER)


@pytest.mark.long
def test_parameters_come_from_bounces_that_settle() -> None:
    """Errors are within four deviations, and no hit is lost: used, rejected or left out."""
    events, said = sensed(0.25, jitter=JITTER), list[str]()
    family = parametric_family(guess(), ["restitution", "gap"])
    found = identify(family, events, clock=JITTER, progress=said.append)
    assert found.converged
    assert np.all(np.abs(found.values - [0.6, 0.001]) < 4 * found.errors)
    assert np.all(found.errors < [0.02, 2e-4])
    assert found.rms < 1.5 * JITTER
    hits = {(e.stamp, 0) for e in events if any(s.kind is not Kind.OPEN for s in e.switches)}
    recording = found.recording
    used = {(stamp, i) for stamp, contacts in recording.hits() for i in contacts}
    assert hits == (used - recording.inserted) | recording.rejected | recording.settled
    assert len(recording.settled) > 20
    assert not used & recording.settled
    document = fit_report.for_json(found, check_fit(found))
    assert document["settled"] == [[s, "c1"] for s, _ in sorted(found.recording.settled)]
    assert any("filter 3 of" in each for each in said)
    assert any("step 2 of at most" in each for each in said)


def lever(stiffness: float) -> Model:
    """A motor that drives a lever against a stop through a spring, N m/rad."""
    return parse_model(
        f"""
        name: lever
        unit: rad
        bodies: [{{name: motor, mass: 0.002}}, {{name: lever, mass: 0.004}}]
        springs:
          - {{between: [ground, motor], stiffness: 0.4, damping: 0.0012}}
          - {{between: [motor, lever], stiffness: {stiffness}, damping: 0.0012}}
        forces: [{{body: motor, amplitude: 0.12, frequency: 9, phase: 0}}]
        stops: [{{name: anvil, body: lever, limit: 0.25, side: above, restitution: 0.6}}]
        """,
        "lever",
    )


@pytest.mark.slow
@pytest.mark.parametrize("clock", [0.001, pytest.param(None, marks=pytest.mark.long)])
def test_a_wrong_stiffness_is_found_though_a_tenth_of_the_impacts_is_missed(
    clock: float | None,
) -> None:
    """The spring is 5 % off, too far for a search that begins at the given values."""
    plant, guess = lever(1.6).system, lever(1.68)
    made = run(plant, [0.0, 0.0], [0.0, 0.0], seconds=30.0, rate=1.0)
    sensor = SensorModel(jitter=0.001, missed=0.1)
    last = int(made.stamps[-1])
    messages = simulate_sensor(sensor, plant, made.switchings, epoch=EPOCH, last=last, seed=1)
    events = [each.event for each in messages]
    free = ["stiffness.motor-lever", "restitution"]
    found = identify(parametric_family(guess.system, free, guess.elements), events, clock=clock)
    assert found.converged
    assert np.all(np.abs(found.values - [1.6, 0.6]) < 4 * found.errors)
    assert np.all(found.errors < [0.02, 0.04])
    recording = found.recording
    assert not recording.rejected
    assert len(recording.inserted) == len(made.switchings) - len(events)


def test_a_first_hit_is_not_taken_for_the_motion_from_inside_its_stop() -> None:
    """A motion without the hit leaves the stop then; with the hit accepted the start is right."""
    model = lever(1.6)
    made = run(model.system, [0.2, 0.2], [0.0, 2.0], seconds=10.0, rate=1.0)
    messages = simulate_sensor(
        SensorModel(),
        model.system,
        made.switchings,
        epoch=EPOCH,
        last=int(made.stamps[-1]),
        seed=1,
    )
    recording = Recording(last_episode(model.system, [each.event for each in messages]))
    (first, contacts), *_ = recording.hits()
    family = parametric_family(model.system, ["restitution"], model.elements)
    nominal = np.concatenate([np.zeros(4), family.nominal])
    hit = (first, contacts[0])
    without = recording.with_outliers({hit}, ())
    inside, _ = state_of_least_gaps(without.problem(family), nominal)
    assert model.system.penetrated(inside[:2]) == contacts
    assert first_hits_from_inside(without, model.system, inside[:4]) == {hit}
    right, _ = state_of_least_gaps(recording.problem(family), nominal)
    np.testing.assert_allclose(right[:4], [0.2, 0.2, 0.0, 2.0], atol=1e-6)
    assert first_hits_from_inside(recording, model.system, right[:4]) == set()


def test_a_start_takes_a_few_samples_of_each_sensor_between_two_events() -> None:
    """All of a slow sensor, evenly spaced ones of a fast sensor, in the order of their stamps."""
    fast = [SensorSample(0, 1000 * k, float(k)) for k in range(2000)]
    slow = [SensorSample(1, 100_000 * k + 1, 0.0) for k in range(20)]
    kept = enough_samples([*fast, *slow], events=10)
    assert [each for each in kept if each.sensor == 1] == slow
    few = [each.stamp for each in kept if each.sensor == 0]
    assert 80 <= len(few) < 160
    assert len({b - a for a, b in itertools.pairwise(few)}) == 1
    assert kept == sorted(kept, key=lambda each: each.stamp)
