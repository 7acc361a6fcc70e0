# SPDX-License-Identifier: Apache-2.0
"""Parameters of systems whose restitution yields, and whose forces are known by samples only."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from live_rig import RIG, bag
from systems import run

from impact_observer.cli.main import main
from impact_observer.errors import UsageError
from impact_observer.identify.identification import identify
from impact_observer.identify.shooting import shoot
from impact_observer.model import Model, parse_model, read_model
from impact_observer.model.free_parameters import parametric_family
from impact_observer.trajectory.linearised_system import FlightEnd

YIELDING = """\
name: yielding
bodies: [{name: x, mass: 1}]
springs: [{between: [ground, x], stiffness: 20, damping: 0.1}]
forces: [{body: x, amplitude: 6, frequency: 5.3}, {body: x, amplitude: 5, frequency: 3.1}]
stops:
  - name: stop
    body: x
    limit: 0.3
    side: above
    restitution: {value: 0.7, speed: 1, exponent: -0.1, limit: 0.95}
"""


def test_derivatives_are_those_of_differences() -> None:
    """By state, parameters and instants, where a contact yields and closes."""
    model = parse_model(YIELDING, "yielding").system
    family = parametric_family(model, ("restitution", "gap", "stiffness-scale"))
    moments = [
        FlightEnd(0.31, (0,), (0,)),
        FlightEnd(0.83, (0,), (0,), (0,)),
        FlightEnd(1.2, (), ()),
        FlightEnd(1.9, (0,), (0,)),
    ]
    t = np.array([each.t for each in moments])
    start = np.concatenate([[0.1, 0.5], family.nominal])
    shot = shoot(family, start, moments, t, 0.0)
    for j, size in enumerate([1.0, 1.0, *family.sizes]):
        step = np.zeros(start.size)
        step[j] = 1e-6 * size
        ends = [shoot(family, start + d, moments, t, 0.0).gaps for d in (step, -step)]
        slopes = (ends[0] - ends[1]) / (2 * step[j])
        np.testing.assert_allclose(slopes, shot.by_start[:, j], rtol=1e-4, atol=1e-4 / size)
    for k in range(t.size):
        step = np.zeros(t.size)
        step[k] = 1e-6
        ends = [shoot(family, start, moments, t + d, 0.0).gaps for d in (step, -step)]
        np.testing.assert_allclose(
            (ends[0] - ends[1]) / 2e-6, shot.by_instant[:, k], rtol=1e-4, atol=2e-3
        )


def sampled() -> Model:
    """two_mass under a table of forces."""
    t = np.arange(0.0, 31.0, 0.05)
    rows = "".join(
        f"    {a!r},{b!r}\n"
        for a, b in zip(t.tolist(), (4 * np.cos(2.5 * t)).tolist(), strict=True)
    )
    text = read_model("two_mass").text()
    document = text[: text.index("forcing:")] + text[text.index("contacts:") :]
    return parse_model(
        f"{document}forcing:\n  hold: linear\n  sampled: |\n    time,x2\n{rows}", "table"
    )


@pytest.mark.slow
def test_parameters_under_a_sampled_force_come_from_exact_times() -> None:
    """Restitution and gap, to a part in ten millions; an offset of the clock is refused."""
    true = sampled()
    made = run(true.system, *true.initial_state(), seconds=30.0, rate=1.0)
    (stop,) = true.system.contacts
    wrong = replace(true.system, contacts=(replace(stop, restitution=0.75, gap=0.51),))
    found = identify(parametric_family(wrong, ("restitution", "gap")), list(made.events))
    assert found.converged
    np.testing.assert_allclose(found.values, [0.7, 0.5], rtol=1e-7)
    line = "its forcing is sampled, so clock-offset cannot be identified"
    with pytest.raises(UsageError, match=line):
        identify(parametric_family(wrong, ("clock-offset",)), list(made.events))


@pytest.mark.slow
def test_identify_takes_live_forces_and_grounds_from_a_bag(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As samples, which are known then."""
    recorded, output = bag(tmp_path / "rig"), tmp_path / "found.yaml"
    wrong = RIG.replace("gap: 0.2, restitution: 0.7", "gap: 0.2, restitution: 0.6")
    (tmp_path / "rig.yaml").write_text(wrong)
    command = ["identify", str(recorded), "--model", str(tmp_path / "rig.yaml"), "-o", str(output)]
    assert main([*command, "--free", "restitution.foot"]) == 0
    assert "restitution.foot" in capsys.readouterr().out
    foot = read_model(output).system.contacts[0]
    assert foot.restitution == pytest.approx(0.7, rel=1e-5)
