# SPDX-License-Identifier: Apache-2.0
"""What is measured beside the impacts: the file, its defaults, and one line for each mistake."""

import pickle
from pathlib import Path

import numpy as np
import pytest
from mistakes import mistakes
from msgspec.structs import fields, replace

from impact_observer.errors import UsageError
from impact_observer.model import read_model
from impact_observer.model.measurement import Measurement, parse_measurements, read_measurements

CONTRACT = """
measurements:
  - {name: encoder, topic: /encoder, joint: x1, quantity: position, deviation: 0.001}
  - {name: laser, topic: /range, field: range, position: {x2: -1}, offset: 0.5, deviation: 0.002,
     delay: 0.01}
  - {name: imu, topic: /imu, field: linear_acceleration.x, acceleration: {x2: 1}, deviation: 0.3,
     blanking: 0.004}
  - {name: gap, topic: /probe, field: data, gap: stop, deviation: 1.0e-4, gate: 4.0, timeout: 0.5}
  - {name: speed, topic: /motor, joint: wheel, quantity: velocity, velocity: {x1: 2, x2: -2},
     deviation: 0, stamp: receive}
"""


def test_each_key_of_the_contract_is_read() -> None:
    """Values as they stand in the file; a joint without coefficients measures its coordinate."""
    encoder, laser, imu, gap, speed = parse_measurements(CONTRACT, "rig.yaml")
    assert replace(encoder, origin="") == Measurement(
        "encoder", "/encoder", "x1", "position", position={"x1": 1.0}, deviation=0.001
    )
    assert (laser.field, dict(laser.position), laser.offset) == ("range", {"x2": -1.0}, 0.5)
    assert (laser.delay, laser.deviation) == (0.01, 0.002)
    assert (dict(imu.acceleration), imu.blanking) == ({"x2": 1.0}, 0.004)
    assert (gap.gap, gap.deviation, gap.gate, gap.timeout) == ("stop", 1e-4, 4.0, 0.5)
    assert (speed.joint, dict(speed.velocity)) == ("wheel", {"x1": 2.0, "x2": -2.0})
    assert (speed.deviation, speed.stamp) == (0.0, "receive")
    for each in (encoder, laser, imu, gap):
        each.check(read_model("two_mass").system)


def test_defaults_are_those_of_the_documentation() -> None:
    """No delay, no blanking, a gate of 5 deviations, a warning after 1 s."""
    (found,) = read_measurements("encoder")
    numbers = (found.offset, found.delay, found.blanking, found.gate, found.timeout)
    assert numbers == (0.0, 0.0, 0.0, 5.0, 1.0)
    assert found.stamp is None
    documented = Path(__file__).parents[2].joinpath("docs", "nodes.md").read_text("utf-8")
    assert all(f"`{each.name}" in documented for each in fields(Measurement)[:-1])


def test_a_sensor_does_not_change() -> None:
    """It travels to other processes as it is."""
    (found,) = read_measurements("encoder")
    with pytest.raises(AttributeError):
        found.gate = 1.0  # type: ignore[misc]
    assert pickle.loads(pickle.dumps(found)) == found


ENCODER = "{name: a, topic: /a, joint: x1, quantity: position, deviation: 0.1}"
MISTAKES = """
measurements: [ | sensors: [ | sensors
measurements: [ | measurements: {a: |
measurements: [{name: a, topic: /a, joint: x1, quantity: position, deviation: 0.1}] | |
[{name: a, topic: /a, joint: x1, quantity: position, deviation: 0.1}] | [] | measurements
[{name: a, topic: /a, joint: x1, quantity: position, deviation: 0.1}] | {a: 1} | measurements
name: a, | | measurements[0].name
, deviation: 0.1 | | measurements[0].deviation
deviation: 0.1 | deviation: -0.1 | measurements[0].deviation
deviation: 0.1 | deviation: small | measurements[0].deviation
deviation: 0.1 | deviation: learn | measurements[0].deviation
deviation: 0.1 | deviation: .inf | measurements[0].deviation
deviation: 0.1 | deviation: 0.1, gain: 1 | measurements[0].gain
deviation: 0.1 | deviation: 0.1, colour: red | measurements[0].colour
deviation: 0.1 | deviation: 0.1, delay: -1 | measurements[0].delay
deviation: 0.1 | deviation: 0.1, blanking: 11 | measurements[0].blanking
deviation: 0.1 | deviation: 0.1, gate: 0 | measurements[0].gate
deviation: 0.1 | deviation: 0.1, timeout: -1 | measurements[0].timeout
deviation: 0.1 | deviation: 0.1, stamp: now | measurements[0].stamp
deviation: 0.1 | deviation: 0.1, field: data | measurements[0].field
deviation: 0.1 | deviation: 0.1, gap: stop, position: {x1: 1} | measurements[0].position
deviation: 0.1 | deviation: 0.1, position: {x1: 0} | measurements[0].position.x1
deviation: 0.1 | deviation: 0.1, position: {x1: .nan} | measurements[0].position.x1
deviation: 0.1 | deviation: 0.1, position: x1 | measurements[0].position
topic: /a | topic: a b | measurements[0].topic
quantity: position, | | measurements[0].quantity
joint: x1, quantity: position | field: data | measurements[0].position
joint: x1, quantity: position | field: data, quantity: position, gap: g | measurements[0].quantity
joint: x1, quantity: position | field: a..b, gap: g | measurements[0].field
joint: x1, quantity: position | gap: g | measurements[0].field
"""


def test_a_mistake_in_a_sensor_is_one_line() -> None:
    """It begins with the file, the member and the key."""
    for text, key in mistakes(f"measurements: [{ENCODER}]", MISTAKES):
        with pytest.raises(UsageError) as raised:
            parse_measurements(text, "rig.yaml")
        assert str(raised.value).startswith(f"rig.yaml: {key}: " if key else "rig.yaml: ")
        assert "\n" not in str(raised.value)


def test_names_differ() -> None:
    """Verdicts and diagnostics go by name."""
    with pytest.raises(UsageError, match=r"rig.yaml: measurements\[1\].name: 'a' is taken"):
        parse_measurements(f"measurements: [{ENCODER}, {ENCODER}]", "rig.yaml")


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("x1", "x9", "joint: 'x9'"),
        ("0.1", "0.1, velocity: {x7: 1}", "velocity: 'x7'"),
        ("0.1", "0.1, gap: anvil", "gap: 'anvil'"),
    ],
)
def test_a_name_that_the_model_does_not_have_is_one_line(old: str, new: str, line: str) -> None:
    """It names the file and the key, and the names that there are."""
    text = f"measurements: [{ENCODER.replace(old, new)}]"
    (found,) = parse_measurements(text, "rig.yaml")
    with pytest.raises(UsageError, match=rf"^rig.yaml: measurements\[0\].{line}.*expected"):
        found.check(read_model("two_mass").system)


def test_a_damaged_file_ends_in_one_line_or_is_read() -> None:
    """Of damaged files of the contract, with a fixed seed."""
    draw, outcomes = np.random.default_rng(5), set()
    for _ in range(200):
        damaged = list(CONTRACT)
        for at in draw.integers(0, len(damaged), 1):
            damaged[at] = chr(int(draw.integers(32, 127)))
        outcomes.add(outcome("".join(damaged)))
    assert outcomes == {0, 1}


def outcome(text: str) -> int:
    """How many lines the error of a file has; 0 where it is read."""
    try:
        return 0 * len(parse_measurements(text, "rig.yaml"))
    except UsageError as error:
        return len(str(error).splitlines())
