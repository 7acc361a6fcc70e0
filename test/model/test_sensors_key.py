# SPDX-License-Identifier: Apache-2.0
"""The key ``sensors`` of a model file: what is read and written."""

import numpy as np
from systems import sample

from impact_observer.model import parse_model, read_model
from impact_observer.model.contact_sensors import ContactSensor
from impact_observer.model.rebounds.power_law import PowerLaw

RIG = """
name: rig
bodies: [{name: x, mass: 1}]
stops:
  - {name: anvil, body: x, limit: 0.1, side: above, restitution: 0.5}
  - {name: back, body: x, limit: -0.1, side: below, restitution: 0.5}
sensors: SENSORS
"""
VALUES = "{anvil: {clock_error: 1.0e-4, missed: 0.02, latency: -0.001}, back: none}"


def rig(sensors: str) -> str:
    """A model file with two contacts and these sensors."""
    return RIG.replace("SENSORS", sensors)


def test_sensors_are_read_and_written() -> None:
    """A key that is left out has no value; a written model reads back the same."""
    model = parse_model(rig(VALUES), "rig")
    anvil = ContactSensor(clock_error=1e-4, missed=0.02, latency=-0.001)
    assert model.sensors == {"anvil": anvil, "back": None}
    assert parse_model(model.text({"seed": 1}), "written").sensors == model.sensors
    some = parse_model(rig("{back: {missed: 0.5}}"), "rig").sensors
    assert some == {"back": ContactSensor(missed=0.5)}
    assert parse_model(rig("{}"), "rig").sensors == sample("two_mass").sensors == {}


def test_matrices_and_robots_have_sensors() -> None:
    """Both are written into what bags carry."""
    matrices = sample("two_mass").text() + "sensors: {stop: {latency: 0.002}}\n"
    robot = read_model("hammer_arm").text() + "sensors: {wall: none}\n"
    for text, expected in ((matrices, ContactSensor(latency=0.002)), (robot, None)):
        read = parse_model(text, "model")
        (found,) = read.sensors.values()
        assert found == expected
        assert parse_model(read.text(), "written").sensors == read.sensors


def test_a_number_of_an_array_is_a_number() -> None:
    """As where rebound laws are computed."""
    law = PowerLaw(np.float64(0.5), 1.0, np.float64(-0.1))
    assert law.checked("contacts[0]") == PowerLaw(0.5, 1.0, -0.1)
