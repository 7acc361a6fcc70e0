# SPDX-License-Identifier: Apache-2.0
"""Models of what turns: units of tables and lines."""

from pathlib import Path

import numpy as np
import pytest

from impact_observer.cli.main import main
from impact_observer.model import parse_model, read_model
from impact_observer.model.free_parameters import parametric_family, with_unit
from impact_observer.model.system import unit_of

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
    """What is considered and learned."""
    monkeypatch.chdir(tmp_path)
    Path("arm.yaml").write_text(
        TABLES.replace("limit: -0.3", "limit: {value: -0.052, deviation: 0.0017}").replace(
            "limit: 3", "limit: 0.436"
        ),
        encoding="utf-8",
    )
    made, fit = "--duration 8 --rate 20 -o bag", "--model arm.yaml --free gap,stiffness"
    assert main(["simulate", "arm.yaml", *made.split()]) == 0
    law = "--law minimum-variance --estimate-parameters gap.right=0.01"
    assert main(f"observe bag {law} -o out".split()) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "gap.left [rad] 0.0520 +- 0.0017" in printed
    assert "gap.right [rad] 0.43" in printed
    assert main(["identify", "bag", *fit.split(), "-o", "fit.yaml"]) == 0
    printed = capsys.readouterr().out
    assert "N m/rad" in printed
    fitted = read_model("fit.yaml").system
    np.testing.assert_allclose(fitted.q_r, [0.052, 0.436], rtol=1e-6)
