# SPDX-License-Identifier: Apache-2.0
"""Sensors that differ from contact to contact, as the model file declares them."""

from dataclasses import replace

import numpy as np
from systems import EPOCH, run, sample

from impact_observer.events import Ruling
from impact_observer.model import Model
from impact_observer.model.contact_sensors import ContactSensor
from impact_observer.observer import Observer, make_observer
from impact_observer.options import Options
from impact_observer.plant import Run
from impact_observer.stamps import NS_PER_S


def three_mass(**sensors: ContactSensor | None) -> tuple[Model, Run]:
    """Three masses with these sensors, and 40 s of their motion."""
    model = sample("three_mass")
    whole = run(model.system, *model.initial_state(), seconds=40.0, rate=10.0)
    return replace(model, sensors=sensors), whole


def watching(model: Model) -> Observer:
    """An observer that starts at a tenth of a metre from the plant, and knows that."""
    start = ",".join(map(repr, (np.concatenate(model.initial_state()) + 0.1).tolist()))
    chosen = Options("minimum-variance", start, epoch=EPOCH, initial_deviation="0.1")
    return make_observer(model, chosen)


def error(watcher: Observer, whole: Run) -> float:
    """Largest error of any component at the end, m or m/s."""
    last = watcher.estimate(int(whole.stamps[-1]))
    return float(np.max(np.abs(np.concatenate([last.q, last.u]) - whole.states[-1])))


def test_impacts_of_a_contact_without_a_sensor_are_inserted() -> None:
    """The right stop has none; its impacts are found, and no sensor is called dead."""
    model, whole = three_mass(right=None)
    watcher, inserted = watching(model), 0
    for each in whole.events:
        if each.switches[0].contact == "left":
            verdicts = watcher.receive(each)
            inserted += sum(v.ruling is Ruling.INSERTED and v.contact == "right" for v in verdicts)
    hidden = sum(each.switches[0].contact == "right" for each in whole.events)
    assert inserted >= hidden - 2
    assert error(watcher, whole) < 1e-3
    assert not watcher.silence(watcher.last_event)


def test_a_latency_of_one_contact_is_taken_off_its_stamps() -> None:
    """The right sensor is 2 ms late, as declared: the estimate is sharp."""
    late = 2 * NS_PER_S // 1000
    model, whole = three_mass(right=ContactSensor(latency=2e-3))
    watcher = watching(model)
    for each in whole.events:
        shift = late if each.switches[0].contact == "right" else 0
        watcher.receive(replace(each, stamp=each.stamp + shift))
    assert error(watcher, whole) < 1e-6
