# SPDX-License-Identifier: Apache-2.0
"""What an observer estimates of each impact: against the jumps of the plant."""

from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from systems import EPOCH, run, sample, system
from true_impacts import numbers, true_impacts

from benchmarks.rigs import fast
from impact_observer.events import (
    ImpactEstimate,
    ImpactEvent,
    Kind,
    Ruling,
    Switch,
    Verdict,
    rejected_impacts,
)
from impact_observer.events import final_rulings as final
from impact_observer.model import Model, System, parse_model
from impact_observer.observer import make_observer, replay_batches
from impact_observer.observer.replay import Impacts, noting_impacts
from impact_observer.options import Options
from impact_observer.plant import SensorModel, simulate_sensor
from impact_observer.plant.simulation import Run

NOW = np.empty(0, dtype=np.int64)


def noted(
    model: Model | System, events: Sequence[ImpactEvent], **options: object
) -> tuple[Impacts, list[Verdict]]:
    """The estimates of impacts by the stamp, sequence and contact of their verdicts, and these."""
    observer = make_observer(model, Options(**{"law": "minimum-variance", **options}))  # type: ignore[arg-type]
    found: Impacts = {}
    made = noting_impacts(replay_batches(observer, events, NOW), observer, found)
    return found, [each for each in made if isinstance(each, Verdict)]


def reported(system: System, of: Run, seed: int, sensor: SensorModel) -> list[ImpactEvent]:
    """The events that a ``sensor`` makes of a run."""
    last = int(of.stamps[-1])
    made = simulate_sensor(sensor, system, of.switchings, epoch=EPOCH, last=last, seed=seed)
    return [each.event for each in made]


@pytest.mark.parametrize("name", ["two_mass", "three_mass", "ball_on_table"])
def test_impacts_are_those_of_the_plant_once_the_estimate_has_found_the_motion(name: str) -> None:
    """Of exact events from a wrong start, also on a stop that moves."""
    model = sample(name)
    plant = run(model.system, *model.initial_state(), seconds=25 if name != "ball_on_table" else 2)
    truth = true_impacts(model.system, plant.switchings)
    found, _ = noted(model, plant.events)
    assert len(found) == len(truth)
    values, deviations = numbers(found.values())
    errors = np.abs(values - [truth[stamp, contact] for stamp, _, contact in found])
    later = slice(2 * len(errors) // 3, None)
    assert np.all(errors[later] < 1e-6)
    assert np.all(errors < 3 * deviations)
    assert all(abs(each.stamp - key[0]) <= 1 for key, each in [*found.items()][later])
    assert {each.ruling for each in found.values()} == {Ruling.APPLIED}


@pytest.mark.parametrize("law", ["geometric", "kinematic", "unilateral"])
def test_laws_without_a_covariance_tell_the_speeds_of_their_replica(law: str) -> None:
    """From a right start those of the plant, without deviations."""
    model = sample("three_mass")
    plant = run(model.system, *model.initial_state(), seconds=10)
    start = ",".join(map(repr, np.concatenate(model.initial_state()).tolist()))
    found, _ = noted(model, plant.events, law=law, initial_state=start)
    values, deviations = numbers(found.values())
    truth = true_impacts(model.system, plant.switchings)
    np.testing.assert_allclose(values, [*truth.values()], rtol=1e-5)
    assert np.all(deviations == -1)


def test_deviations_hold_the_errors_where_stamps_jitter() -> None:
    """Of five starts, from the fourth impact on, with the errors of clock and model declared."""
    model, sensor, ratios = sample("two_mass"), SensorModel(jitter=1e-3), list[float]()
    for seed in range(5):
        x = np.random.default_rng(seed).normal(0, [0.1, 0.1, 0.3, 0.3])
        plant = run(model.system, *np.split(x, 2), seconds=20, rate=1)
        truth = [*true_impacts(model.system, plant.switchings).values()]
        events = reported(model.system, plant, seed, sensor)
        found, _ = noted(model, events, clock_error=1e-3, model_error=0.0)
        values, deviations = numbers(found.values())
        ratios += ((values - truth) / deviations)[3:].ravel().tolist()
    assert 0.5 < np.sqrt(np.mean(np.square(ratios))) < 1.2
    assert np.mean(np.abs(ratios) < 2) > 0.93


def test_a_missed_impact_is_estimated_where_it_is_inserted() -> None:
    """The sensor misses one; its estimate is as good as those of the others."""
    model = sample("two_mass")
    plant = run(model.system, *model.initial_state(), seconds=20)
    left_out, *_ = missing = plant.events[-3:-2]
    events = [each for each in plant.events if each not in missing]
    found, _ = noted(model, [replace(e, sequence=k) for k, e in enumerate(events, 1)])
    (inserted,) = (each for each in found.values() if each.ruling is Ruling.INSERTED)
    truth = true_impacts(model.system, plant.switchings)[left_out.stamp, "stop"]
    values, deviations = numbers([inserted])
    assert inserted.sequence == 0
    assert abs(inserted.stamp - left_out.stamp) < 1000
    assert np.all(np.abs(values[0] - truth) < 1e-6)
    assert np.all(deviations < 1e-3)


def test_an_inserted_impact_has_an_estimate_until_it_is_withdrawn() -> None:
    """Of verdicts on a drill that are asked for after all events."""
    model, sensor = parse_model(fast(), "drill"), SensorModel(jitter=1e-4, missed=0.2, spurious=5)
    plant = run(model.system, *model.initial_state(), seconds=5)
    events = reported(model.system, plant, 1, sensor)
    observer = make_observer(model, Options(law="minimum-variance"))
    made = [each for event in events for each in observer.receive(event)]
    withdrawn = {e.stamp for e in made if e.ruling is Ruling.REJECTED and not e.sequence}
    inserted = [each for each in made if each.ruling is Ruling.INSERTED]
    untold = {each.stamp for each in inserted if observer.impact(each) is None}
    assert untold
    assert untold <= withdrawn


def test_every_reported_impact_has_one_estimate_or_is_rejected() -> None:
    """Of a sensor with missed and false impacts; rejected ones have no numbers."""
    model = sample("two_mass")
    plant = run(model.system, *model.initial_state(), seconds=30)
    sensor = SensorModel(jitter=1e-3, missed=0.15, spurious=0.2)
    events = reported(model.system, plant, 1, sensor)
    found, verdicts = noted(model, events, clock_error=1e-3)
    rejected = rejected_impacts(final(verdicts), events)
    assert rejected
    assert {each[4:] for each in rejected} == {(0.0,) * 4 + (-1.0,) * 4}
    applied = [key[:2] for key, each in found.items() if each.ruling is Ruling.APPLIED]
    rows = Counter([*applied, *((each.stamp, each.sequence) for each in rejected)])
    assert rows == Counter((each.stamp, each.sequence) for each in events)


def test_openings_that_are_rejected_are_no_impacts() -> None:
    """A release has no row, whatever becomes of it."""
    event = ImpactEvent(EPOCH, (Switch("a", Kind.OPEN), Switch("b", Kind.CLOSE)), 1)
    ruled = {(EPOCH, 1, name): Ruling.REJECTED for name in "ab"}
    assert rejected_impacts(ruled, [event]) == [ImpactEstimate(EPOCH, "b", Ruling.REJECTED, 1)]


def test_an_impact_that_is_rejected_has_an_estimate_without_numbers() -> None:
    """So has an inserted one that was none; a release has no estimate."""
    observer = make_observer(sample("two_mass"), Options("geometric"))
    for k, kind in enumerate((Kind.IMPACT, Kind.OPEN), start=1):
        observer.receive(ImpactEvent(EPOCH + k, (Switch("stop", kind),), k, epoch=EPOCH))
    no = [Verdict(EPOCH + k, Ruling.REJECTED, k % 3, "stop") for k in (1, 2, 3)]
    wanted = [ImpactEstimate(each.stamp, "stop", Ruling.REJECTED, each.sequence) for each in no]
    assert [observer.impact(each) for each in no] == [wanted[0], None, wanted[2]]


def test_a_ball_that_comes_to_rest_has_lost_what_it_fell_with() -> None:
    """The energies of all impacts add up to m g h, the last of which closes the contact."""
    model = parse_model(
        "{name: ball, bodies: [{name: h, mass: 2}], forces: [{body: h, constant: -19.62}],"
        " stops: [{name: floor, body: h, limit: 0, side: below, restitution: 0.5}],"
        " initial_state: {position: [0.5], velocity: [0]}}",
        "ball",
    )
    plant = run(model.system, [0.5], [0.0], seconds=2)
    assert plant.events[-1].switches == (Switch("floor", Kind.CLOSE),)
    found, _ = noted(model, plant.events, initial_state="0.5,0", initial_deviation="1e-6")
    values, _ = numbers(found.values())
    assert len(found) == len(plant.events)
    assert values[:, 3].sum() == pytest.approx(0.5 * 19.62, rel=1e-6)


def test_contacts_that_hit_at_one_instant_have_a_row_each() -> None:
    """Two equal oscillators of 1 and 3 kg hit stops of their own together."""
    made = system(
        np.diag([1.0, 3.0]),
        np.zeros((2, 2)),
        np.diag([4.0, 12.0]),
        contacts=[([1, 0], 0.1, 0.5), ([0, 1], 0.1, 0.8)],
    )
    plant = run(made, [0.3, 0.3], [0, 0], seconds=1.2)
    both = [each for each in plant.events if len(each.switches) == 2]
    found, _ = noted(made, both, initial_state="0.3,0.3,0,0", initial_deviation="0.001")
    speed = 2 * np.sqrt(0.3**2 - 0.1**2)
    values, _ = numbers(found.values())
    assert len(both) == 1
    wanted = np.array([[1, 0.5, 1.5, 0.75 / 2], [1, 0.8, 3 * 1.8, 3 * 0.36 / 2]])
    np.testing.assert_allclose(values, wanted * [speed, speed, speed, speed**2], rtol=1e-6)


def test_an_impact_of_another_contact_than_reported_is_that_of_the_other() -> None:
    """One stop is reported for the other at the end of an exact recording."""
    model = sample("three_mass")
    plant = run(model.system, *model.initial_state(), seconds=20)
    *events, last = plant.events
    (true,) = (switch.contact for switch in last.switches)
    (other,) = {*model.system.contact_names} - {true}
    found, verdicts = noted(model, [*events, replace(last, switches=(Switch(other),))])
    assert verdicts[-1].hit_contact == true != verdicts[-1].contact
    (made,) = deque(found.values(), maxlen=1)
    assert made.contact == true
    truth = true_impacts(model.system, plant.switchings)[last.stamp, true]
    np.testing.assert_allclose(numbers([made])[0][0], truth, rtol=1e-5)


def test_a_restitution_that_is_learned_counts() -> None:
    """Declared 0.6 +- 0.1, in the plant 0.7: at last the speeds have that ratio, not before."""
    model = sample("two_mass")
    guess = parse_model(
        model.text().replace("restitution: 0.7", "restitution: {value: 0.6, deviation: 0.1}"),
        "guess",
    )
    plant = run(model.system, *model.initial_state(), seconds=30)
    found, _ = noted(guess, plant.events, estimate_parameters=("restitution=0.1",))
    values, deviations = numbers(found.values())
    errors = values - [*true_impacts(model.system, plant.switchings).values()]
    assert values[0, 1] / values[0, 0] == pytest.approx(0.6, abs=0.03)
    assert np.all(np.abs(errors[-3:]) < 1e-3)
    assert np.all(np.abs(errors) < 3 * deviations)
