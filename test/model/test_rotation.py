# SPDX-License-Identifier: Apache-2.0
"""Models of what turns: units of tables and lines, and angles in degrees."""

import math
from pathlib import Path

import numpy as np
import pytest

from impact_observer.cli.main import main
from impact_observer.errors import ModelError
from impact_observer.model import parse_model, read_model
from impact_observer.model.free_parameters import parametric_family, with_unit
from impact_observer.model.system import unit_of

PENDULUM = """\
# a pendulum between two stops
name: pendulum
unit: deg   # of all angles
bodies: [{name: arm, mass: 0.02}]          # kg m^2
grounds: [{name: table, motion: {harmonics: [{amplitude: 2, frequency: 6, phase: 0.5}]}}]
springs: [{between: [ground, arm], stiffness: 0.5, damping: 0.002}]
forces: [{body: arm, amplitude: 0.4, frequency: 6}]
stops:
  - {name: left, body: arm, limit: -20, side: below, restitution: 0.6, ground: table}
  - name: right
    body: arm
    limit: {value: 25, deviation: 0.5}
    side: above
    restitution: 0.7
    ground: table
  - name: far
    between: [table, arm]
    gap: 90
    restitution: {value: 0.7, speed: 90, exponent: -0.1}
  - name: last
    body: arm
    limit: 99
    side: above
    restitution: 0.7
    ground: table
initial_state: {position: [10], velocity: [-30]}
"""
TABLES = """\
name: drum
unit: rad
bodies: [{name: arm, mass: 0.02}]
springs: [{between: [ground, arm], stiffness: 0.5, damping: 0.002}]
forces: [{body: arm, constant: 0.3}, {body: arm, amplitude: 0.4, frequency: 4}]
stops:
  - {name: left, body: arm, limit: -0.3, side: below, restitution: 0.6}
  - {name: right, body: arm, limit: 3, side: above, restitution: 0.6}
initial_state: {position: [0.1], velocity: [0]}
"""


def radians(degrees: float) -> float:
    """An angle, as a fraction of a circle."""
    return degrees / 360 * math.tau


def test_angles_in_degrees_become_radians() -> None:
    """Limits, gaps, amplitudes of grounds and states turn; forces, phases and stiffness stay."""
    model = parse_model(PENDULUM, "pendulum")
    system = model.system
    assert (system.unit, system.speed_unit) == ("rad", "rad/s")
    np.testing.assert_allclose(system.q_r, [radians(each) for each in (20, 25, 90, 99)])
    assert model.initial_state()[0] == pytest.approx(radians(10))
    assert model.initial_state()[1] == pytest.approx(radians(-30))
    assert system.frame is not None
    motion = system.frame.grounds.motion
    amplitude = np.hypot(motion.cosine, motion.sine)
    assert amplitude[0, 0] == pytest.approx(radians(2))
    assert np.arctan2(-motion.sine[0, 0], motion.cosine[0, 0]) == pytest.approx(0.5)
    assert system.own_forcing.cosine[0, 0] == pytest.approx(0.4)
    assert system.K[0, 0] == pytest.approx(0.5)
    assert model.uncertainty is not None
    assert np.sqrt(model.uncertainty.covariance[0, 0]) == pytest.approx(radians(0.5))
    speed = np.array([radians(90)])
    at_speed = [float(system.rebounds[i].restitution_at(speed)[0]) for i in (2, 3)]
    np.testing.assert_allclose(at_speed, [0.7, 0.7])


def test_a_model_in_degrees_reads_back_from_its_text() -> None:
    """The text that a bag carries has radians."""
    model = parse_model(PENDULUM, "pendulum")
    again = parse_model(model.text(), "bag")
    assert again.system.unit == "rad"
    np.testing.assert_array_equal(again.system.q_r, model.system.q_r)
    np.testing.assert_array_equal(again.system.K, model.system.K)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("unit: degrees", "unit: 'degrees' found; expected m, rad or deg, of the coordinates"),
        ("unit: deg\nuncertainty: {names: [gap.right], covariance: [[1]]}", "uncertainty: does"),
    ],
)
def test_what_cannot_be_converted_is_named(text: str, expected: str) -> None:
    """With file and key."""
    with pytest.raises(ModelError, match=f"^pendulum: {expected}"):
        parse_model(PENDULUM.replace("unit: deg   # of all angles", text), "pendulum")


def test_tables_of_displacements_are_not_converted(tmp_path: Path) -> None:
    """The table of a ground is in rad: the unit of its numbers is not in the model."""
    file = tmp_path / "pendulum.yaml"
    text = PENDULUM.replace("{harmonics: [{amplitude: 2, frequency: 6, phase: 0.5}]}", "{}")
    file.write_text(text.replace("motion: {}", "motion: {sampled: table.csv}"), encoding="utf-8")
    with pytest.raises(ModelError, match=r"motion\.sampled: a table does not go with unit: deg"):
        read_model(file)


def test_parameters_of_what_turns_have_its_units() -> None:
    """As tables of identify and lines of observe show them."""
    model = parse_model(TABLES, "drum")
    names = ["gap.left", "stiffness.ground-arm", "damping.ground-arm", "mass.arm"]
    family = parametric_family(model.system, names, model.elements)
    assert [each.unit for each in family.parameters] == ["rad", "N m/rad", "N m s/rad", "kg m^2"]
    assert with_unit("constant-force.arm", "rad") == "constant-force.arm [N m]"
    assert with_unit("gap.left", "m") == "gap.left [m]"
    assert with_unit("model error", "rad") == "model error [rad/s^1.5]"
    assert unit_of("s", "rad") == "s"
    assert unit_of("N/m", "m or rad") == "N/m"


@pytest.mark.long
def test_lines_of_an_observer_have_units_of_rotation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What is considered and learned; identify converts the file that it writes."""
    monkeypatch.chdir(tmp_path)
    Path("arm.yaml").write_text(
        TABLES.replace("unit: rad", "unit: deg")
        .replace("limit: -0.3", "limit: {value: -3, deviation: 0.1}")
        .replace("limit: 3", "limit: 25"),
        encoding="utf-8",
    )
    made, fit = "--duration 8 --rate 20 -o bag", "--model arm.yaml --free gap,stiffness"
    assert main(["simulate", "arm.yaml", *made.split()]) == 0
    law = "--law minimum-variance --estimate-parameters gap.right=0.01"
    assert main(f"observe bag {law} -o out".split()) == 0
    printed = capsys.readouterr().out
    assert "considered: gap.left [rad] 0.0524 +- 0.0017" in printed
    assert "learned: gap.right [rad] 0.4363" in printed
    assert main(["identify", "bag", *fit.split(), "-o", "fit.yaml"]) == 0
    printed = capsys.readouterr().out
    assert "N m/rad" in printed
    fitted = read_model("fit.yaml").system
    np.testing.assert_allclose(fitted.q_r, [radians(3), radians(25)], rtol=1e-6)
