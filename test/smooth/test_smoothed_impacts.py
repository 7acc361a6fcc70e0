# SPDX-License-Identifier: Apache-2.0
"""What a smoothed motion says of each impact: against the jumps of the plant."""

import numpy as np
import pytest
from systems import EPOCH, run, sample
from true_impacts import numbers, true_impacts

from impact_observer.events import Ruling
from impact_observer.model import Model, System, parse_model
from impact_observer.options import Options
from impact_observer.plant import SensorModel, simulate_sensor
from impact_observer.smooth import smoothed_runs
from impact_observer.states import Matrix


def errors(
    plant: System, model: Model, seed: int, seconds: float, clock: float
) -> tuple[Matrix, Matrix]:
    """Errors of the numbers of all impacts, and these in deviations, shape (impacts, 4) each.

    The plant starts anywhere, and its sensor has the error of the ``clock``.
    """
    x = np.random.default_rng(seed).normal(0, np.repeat([0.1, 0.3], plant.n))
    made = run(plant, *np.split(x, 2), seconds=seconds, rate=1)
    truth = true_impacts(plant, made.switchings)
    events = simulate_sensor(
        SensorModel(jitter=clock),
        plant,
        made.switchings,
        epoch=EPOCH,
        last=int(made.stamps[-1]),
        seed=seed,
    )
    options = Options(law="minimum-variance", clock_error=clock or -1.0)
    (motion,) = smoothed_runs(model, [each.event for each in events], options)
    found = [*motion.impact_estimates()]
    assert {each.ruling for each in found} == {Ruling.APPLIED}
    assert [each.contact for each in found] == [contact for _, contact in truth]
    values, deviations = numbers(found)
    return values - [*truth.values()], (values - [*truth.values()]) / deviations


@pytest.mark.parametrize("name", ["two_mass", "three_mass"])
def test_all_impacts_of_exact_events_are_those_of_the_plant(name: str) -> None:
    """Also the first ones, of a start that nobody knows."""
    model = sample(name)
    found, _ = errors(model.system, model, 1, 15, 0.0)
    assert np.all(np.abs(found) < 1e-6)


def test_deviations_hold_the_errors_where_stamps_jitter() -> None:
    """Of all impacts of three recordings."""
    model = sample("two_mass")
    ratios = np.vstack([errors(model.system, model, seed, 15, 1e-3)[1] for seed in range(3)])
    assert 0.6 < np.sqrt(np.mean(ratios**2)) < 1.2
    assert np.mean(np.abs(ratios) < 2) > 0.93


def test_a_restitution_with_a_deviation_counts() -> None:
    """Each plant has its own, 0.7 +- 0.03; few impacts hardly tell it."""
    text, ratios = sample("two_mass").text(), list[Matrix]()
    assert text.count("restitution: 0.7") == 1
    for seed in range(5):
        true = 0.7 + 0.03 * np.random.default_rng(100 + seed).normal()
        plant = parse_model(text.replace("restitution: 0.7", f"restitution: {true}"), "plant")
        declared = "restitution: {value: 0.7, deviation: 0.03}"
        model = parse_model(text.replace("restitution: 0.7", declared), "model")
        ratios.append(errors(plant.system, model, seed, 8, 1e-3)[1])
    pooled = np.vstack(ratios)
    assert 0.5 < np.sqrt(np.mean(pooled**2)) < 1.3
    assert np.mean(np.abs(pooled) < 2) > 0.9
