# SPDX-License-Identifier: Apache-2.0
"""Simulated sensors whose errors differ from contact to contact."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from sensing import THREE, impacts, switching
from systems import EPOCH, sample

from impact_observer.cli.main import main
from impact_observer.errors import UsageError
from impact_observer.events import Kind, Switch
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import events_in, model_of
from impact_observer.model.contact_sensors import ContactSensor, ContactSensors
from impact_observer.plant import (
    SensorMessage,
    SensorModel,
    SensorSimulation,
    Switching,
    simulate_sensor,
)
from impact_observer.stamps import NS_PER_S, from_seconds

MANY = 2_000
"""Impacts of a contact."""
LEAST = 1e-3
"""Least p-value accepted; seeds are fixed."""
NAMES = THREE.contact_names


def own(**sensors: ContactSensor | None) -> ContactSensors:
    """Sensors by contact."""
    return sensors


def sent(
    sensor: SensorModel, switchings: Sequence[Switching], sensors: ContactSensors, seed: int = 1
) -> list[SensorMessage]:
    """Messages in the order of arrival."""
    last = max([EPOCH + 1000 * NS_PER_S, *(each.instant.stamp for each in switchings)])
    return [
        *simulate_sensor(
            sensor, THREE, switchings, sensors=sensors, epoch=EPOCH, last=last, seed=seed
        )
    ]


def errors_of(contact: str, found: Sequence[SensorMessage]) -> np.ndarray:
    """Errors of the stamps of a contact that hits at whole seconds, s."""
    stamps = [
        each.event.stamp
        for each in found
        if each.event.switches == (Switch(contact, Kind.IMPACT),)
    ]
    late = (np.array(stamps) - EPOCH) / NS_PER_S
    return np.asarray(late - np.round(late))


def test_each_contact_has_its_own_clock_and_latency() -> None:
    """The one without own values has those of the sensor, bit for bit."""
    sensor = SensorModel(jitter=0.003, delay=0.02)
    sensors = own(
        c1=ContactSensor(clock_error=0.001, latency=-0.05), c2=ContactSensor(latency=0.0)
    )
    switchings = impacts(3 * MANY)
    found = sent(sensor, switchings, sensors)
    for name, mean, deviation in (("c1", -0.05, 0.001), ("c2", 0.0, 0.003), ("c3", 0.02, 0.003)):
        errors = errors_of(name, found)
        assert errors.size == MANY
        assert stats.kstest((errors - mean) / deviation, "norm").pvalue > LEAST
    plain = sent(sensor, switchings, {})
    np.testing.assert_array_equal(errors_of("c3", found), errors_of("c3", plain))


def test_errors_of_contacts_that_hit_at_once_are_independent() -> None:
    """Contacts with clocks of their own report in messages of their own."""
    switchings = [switching(k + 1.0, [(0, Kind.IMPACT), (1, Kind.IMPACT)]) for k in range(MANY)]
    each = ContactSensor(clock_error=0.002)
    found = sent(SensorModel(), switchings, own(c1=each, c2=each))
    errors = [errors_of(name, found) for name in NAMES[:2]]
    assert abs(np.corrcoef(errors)[0, 1]) < 4 / math.sqrt(MANY)


def test_each_contact_misses_impacts_by_its_own_probability() -> None:
    """Within four standard deviations; 0 misses none and 1 all."""
    sensors = own(c1=ContactSensor(missed=0.3), c2=ContactSensor(missed=0.0))
    found = sent(SensorModel(missed=0.1), impacts(3 * MANY), sensors)
    for name, missed in (("c1", 0.3), ("c2", 0.0), ("c3", 0.1)):
        lost = MANY - errors_of(name, found).size
        assert abs(lost - MANY * missed) <= 4 * math.sqrt(MANY * missed * (1 - missed))


def test_contact_without_sensor_reports_nothing() -> None:
    """No IMPACT, CLOSE, OPEN, spurious or mislabelled impact bears its name."""
    pairs = [(Kind.CLOSE, 1.0), (Kind.OPEN, 1.5)]
    switchings = [
        switching(4 * k + s, [(i, kind) for i in range(3)])
        for k in range(200)
        for kind, s in pairs
    ]
    sensor = SensorModel(spurious=0.5, mislabelled=0.3, dead_time=1e-6)
    found = sent(sensor, switchings, own(c2=None))
    names = {switch.contact for each in found for switch in each.event.switches}
    assert names == {"c1", "c3"}
    kinds = {switch.kind for each in found for switch in each.event.switches}
    assert kinds == {Kind.IMPACT, Kind.CLOSE, Kind.OPEN}


def test_labels_and_spurious_impacts_need_contacts_with_sensors() -> None:
    """One line, as for a model with too few contacts."""
    none = own(c1=None, c2=None)
    with pytest.raises(UsageError, match="2 contacts or more: test has 1"):
        sent(SensorModel(mislabelled=0.1), [], none)
    with pytest.raises(UsageError, match="1 contacts or more: test has 0"):
        sent(SensorModel(spurious=0.1), [], own(c1=None, c2=None, c3=None))


def test_ideal_sensors_of_contacts_report_as_one() -> None:
    """Contacts that hit at once are in one message where their sensors say one instant."""
    switchings = [switching(1.0, [(0, Kind.IMPACT), (1, Kind.CLOSE), (2, Kind.IMPACT)])]
    ideal = own(c1=ContactSensor(latency=0.0), c2=ContactSensor(clock_error=0.0))
    assert sent(SensorModel(), switchings, ideal) == sent(SensorModel(), switchings, {})
    late = sent(SensorModel(), switchings, own(c2=ContactSensor(latency=0.01)))
    shown = [(each.event.sequence, each.event.stamp, each.event.switches) for each in late]
    stamp = EPOCH + NS_PER_S
    assert shown == [
        (1, stamp, (Switch("c1", Kind.IMPACT), Switch("c3", Kind.IMPACT))),
        (2, stamp + 10_000_000, (Switch("c2", Kind.CLOSE),)),
    ]


def test_messages_are_numbered_as_they_are_sent() -> None:
    """The hit of a slow sensor is overtaken by a later hit of a quick one, and streams alike."""
    switchings = [switching(1.0, [(0, Kind.IMPACT)]), switching(1.01, [(1, Kind.IMPACT)])]
    sensors = own(c1=ContactSensor(latency=0.05), c2=ContactSensor(latency=-0.002))
    found = sent(SensorModel(), switchings, sensors)
    rows = [(each.event.switches[0].contact, each.event.sequence) for each in found]
    assert rows == [("c2", 1), ("c1", 2)]
    stamps = [(each.event.stamp - EPOCH, each.arrival - EPOCH) for each in found]
    seconds = [(1.008, 1.01), (1.05, 1.05)]
    assert stamps == [tuple(from_seconds(s) for s in pair) for pair in seconds]
    simulation = SensorSimulation(SensorModel(), THREE, sensors=sensors, epoch=EPOCH, seed=1)
    streamed = list[SensorMessage]()
    for one in switchings:
        streamed += simulation.due(one.instant.stamp - 1)
        simulation.detect(one)
    while (stamp := simulation.next_stamp) is not None:
        streamed += simulation.due(stamp)
    assert streamed == found


def test_simulated_bag_has_the_errors_of_its_model(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The bag carries the sensors, and a contact without one is silent."""
    model, bag = tmp_path / "rig.yaml", tmp_path / "bag"
    keys = "sensors: {left: none, right: {latency: 0.01}}\n"
    model.write_text(sample("three_mass").text() + keys)
    assert main(["simulate", str(model), "--duration", "30", "-o", str(bag)]) == 0
    assert "events of a sensor with own errors of contacts" in capsys.readouterr().out
    with BagReader(bag) as reader:
        read, events = model_of(reader), events_in(reader)
    assert read.sensors == own(right=ContactSensor(latency=0.01), left=None)
    plain = tmp_path / "plain"
    assert main(["simulate", "three_mass", "--duration", "30", "-o", str(plain)]) == 0
    with BagReader(plain) as reader:
        ideal = [each for each in events_in(reader) if each.switches[0].contact == "right"]
    assert len(events) == len(ideal) > 3
    assert [each.stamp for each in events] == [each.stamp + 10_000_000 for each in ideal]
