# SPDX-License-Identifier: Apache-2.0
"""What is measured beside the impacts: the file, its defaults, and one line for each mistake."""

import pickle
from pathlib import Path

import numpy as np
import pytest
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
ENCODER = "{name: a, topic: /a, joint: x1, quantity: position, deviation: 0.1%s}"


def declared(member: str) -> tuple[Measurement, ...]:
    """The sensors in a file ``rig.yaml`` of one member."""
    return parse_measurements(f"measurements: [{member}]", "rig.yaml")


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


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("", "rig.yaml: nothing found; expected keys: measurements"),
        ("measurements: []", "measurements: [] found; expected a list"),
        ("measurements: {a: 1}", "measurements: {'a': 1} found; expected a list"),
        ("sensors: []", "rig.yaml: sensors: is not known here; expected one of measurements"),
        ("measurements: [{name: a", "rig.yaml: is not YAML at line 1"),
    ],
)
def test_what_is_no_file_of_measurements_is_one_line(text: str, line: str) -> None:
    """It names the file and what is expected."""
    with pytest.raises(UsageError) as raised:
        parse_measurements(text, "rig.yaml")
    assert line in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("member", "line"),
    [
        ("{name: a, topic: /a, field: data, position: {x1: 1}}", "deviation: is missing"),
        ("{name: a, topic: /a, field: data, deviation: 1}", "position: no position, velocity,"),
        ("{topic: /a, field: data, deviation: 1}", "name: is missing"),
        ("{name: a, topic: /a, deviation: 1}", "field: neither joint nor field found"),
        ("{name: a, topic: /a, joint: x1, deviation: 1}", "quantity: nothing found; expected pos"),
        (ENCODER % ", field: data", "field: both joint and field found; expected one of them"),
        (ENCODER % ", gap: stop, position: {x1: 1}", "position: position and gap found"),
        (ENCODER % ", position: {x1: 0}", "position.x1: 0 found; expected"),
        (ENCODER % ", position: {x1: .nan}", "position.x1: nan found"),
        (ENCODER % ", position: x1", "position: 'x1' found"),
        (
            ENCODER % ", gain: 1",
            "gain: went in 0.4.0",
        ),
        (ENCODER % ", delay: -1", "delay: -1 found; expected a number from 0 to 10"),
        (ENCODER % ", blanking: 11", "blanking: 11 found; expected a number from 0 to 10"),
        (ENCODER % ", gate: 0", "gate: 0 found; expected a number above 0"),
        (ENCODER % ", timeout: -1", "timeout: -1 found; expected a number above 0"),
        (ENCODER % ", stamp: now", "stamp: 'now' found; expected header or receive"),
        (ENCODER % ", colour: red", "colour: is not known here; expected one of name, topic"),
        (
            ENCODER.replace("0.1", "-0.1") % "",
            "deviation: -0.1 found; expected a number of at least 0",
        ),
        (ENCODER.replace("0.1", "small") % "", "deviation: 'small' found; expected a number"),
        (ENCODER.replace("0.1", "learn") % "", "deviation: learn went in 0.4.0"),
        (ENCODER.replace("0.1", ".inf") % "", "deviation: inf found"),
        (ENCODER.replace("/a", "a b") % "", "topic: 'a b' found; expected a name such as"),
        (
            ENCODER.replace("joint: x1, quantity: position", "field: a..b, gap: g") % "",
            "field: 'a",
        ),
    ],
)
def test_a_mistake_in_a_sensor_is_one_line(member: str, line: str) -> None:
    """It names the file, the member and the key, what was found and what is expected."""
    with pytest.raises(UsageError) as raised:
        declared(member)
    assert f"rig.yaml: measurements[0].{line}" in str(raised.value)
    assert "\n" not in str(raised.value)


def test_names_differ() -> None:
    """Verdicts and diagnostics go by name."""
    with pytest.raises(UsageError, match=r"rig.yaml: measurements\[1\].name: 'a' is taken"):
        parse_measurements(f"measurements: [{ENCODER % ''}, {ENCODER % ''}]", "rig.yaml")


@pytest.mark.parametrize(
    ("member", "line"),
    [
        (
            ENCODER.replace("x1", "x9") % "",
            "joint: 'x9' is no coordinate of two_mass; expected one of x1, x2, or beside the",
        ),
        (ENCODER % ", velocity: {x7: 1}", "velocity: 'x7' is no coordinate of two_mass"),
        (ENCODER % ", gap: anvil", "gap: 'anvil' is no contact of two_mass; expected one of stop"),
    ],
)
def test_a_name_that_the_model_does_not_have_is_one_line(member: str, line: str) -> None:
    """It names the file and the key, and the names that there are."""
    (found,) = declared(member)
    with pytest.raises(UsageError) as raised:
        found.check(read_model("two_mass").system)
    assert f"rig.yaml: measurements[0].{line}" in str(raised.value)


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
