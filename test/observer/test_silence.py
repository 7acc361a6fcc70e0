# SPDX-License-Identifier: Apache-2.0
"""Predicted impacts that do not come: a dead sensor, a stopped plant, and sensors that live."""

import numpy as np
import pytest
from systems import EPOCH, run, sample

from impact_observer.observer import make_observer
from impact_observer.observer.observer import Observer
from impact_observer.options import Options
from impact_observer.plant import Run
from impact_observer.plant.sensor import SensorModel, simulate_sensor
from impact_observer.stamps import NS_PER_S

DEAD = EPOCH + 30 * NS_PER_S
"""When the sensor dies."""


def run_of(name: str, seconds: int) -> Run:
    """A run of a sample model."""
    model = sample(name)
    return run(model.system, *model.initial_state(), seconds=seconds, rate=10.0)


def watcher_of(name: str) -> Observer:
    """An observer with default options, but for its law."""
    model = sample(name)
    return make_observer(model, Options(law="minimum-variance"))


@pytest.mark.parametrize("name", ["two_mass", "three_mass"])
def test_a_dead_sensor_is_noticed_within_six_predicted_impacts(name: str) -> None:
    """Then nothing is synchronized, and the covariance takes in a plant that has stopped."""
    whole, watcher = run_of(name, 60), watcher_of(name)
    for each in whole.events:
        if each.stamp < DEAD:
            watcher.receive(each)
    unreported = [each.stamp for each in whole.events if each.stamp >= DEAD]
    warned = [bool(watcher.silence(stamp + NS_PER_S // 100)) for stamp in unreported]
    assert 3 <= warned.index(True) <= 5
    assert all(warned[warned.index(True) :])
    late = watcher.estimate(whole.events[-1].stamp + NS_PER_S // 100)
    assert "not reported" in late.misfit
    assert not late.synchronized
    assert watcher.obstacle(late.stamp) == "predicted impacts are not reported"
    deviations = np.sqrt(np.diag(np.reshape(late.covariance, (2 * late.q.size,) * 2)))
    assert np.all(np.abs(np.concatenate([late.q, late.u])) < 3 * deviations)
    early = watcher.estimate(DEAD)
    assert early.synchronized
    assert not early.misfit


def test_a_sensor_that_comes_back_is_followed_again() -> None:
    """The warning ends with the first impact; within ten seconds the error is that of before."""
    whole, watcher = run_of("two_mass", 60), watcher_of("two_mass")
    back = DEAD + 15 * NS_PER_S
    end = back + 10 * NS_PER_S
    for each in whole.events:
        if each.stamp < DEAD:
            watcher.receive(each)
    first, *others = (each for each in whole.events if back <= each.stamp < end)
    assert watcher.silence(first.stamp - 1)
    watcher.receive(first)
    assert not watcher.silence(first.stamp)
    for each in others:
        watcher.receive(each)
    k = int(np.searchsorted(whole.stamps, end))
    found = watcher.estimate(int(whole.stamps[k]))
    assert found.synchronized
    np.testing.assert_allclose(np.concatenate([found.q, found.u]), whole.states[k], atol=1e-6)


@pytest.mark.long
@pytest.mark.parametrize(("jitter", "missed"), [(0.0, 0.0), (1e-3, 0.0), (1e-3, 0.2)])
@pytest.mark.parametrize("name", ["two_mass", "three_mass"])
def test_a_sensor_that_lives_is_not_called_dead(name: str, jitter: float, missed: float) -> None:
    """However its stamps err, and though it misses a fifth of the impacts."""
    watcher, whole = watcher_of(name), run_of(name, 60)
    last = int(whole.stamps[-1])
    sensor = SensorModel(jitter=jitter, missed=missed)
    system = sample(name).system
    sent = simulate_sensor(sensor, system, whole.switchings, epoch=EPOCH, last=last, seed=7)
    said = []
    for k, each in enumerate(message.event for message in sent):
        if k:
            said.append(watcher.silence(each.stamp - 1))
        watcher.receive(each)
    assert len(said) > 15
    assert not any(said)
