# SPDX-License-Identifier: Apache-2.0
"""What check-model says of a robot: torques nobody sees, unused limits."""

from pathlib import Path

import pytest
from arms import DOUBLE, PENDULUM, SLIDER, joint, link, model_of, urdf, wall

pytest.importorskip("pinocchio", reason="not installed: extra robots")

from impact_observer.cli.main import main
from impact_observer.model import Model
from impact_observer.model.multibody import report_on

LIMIT = '<limit lower="-1" upper="2" effort="5" velocity="5"/>'
CHAIN = urdf(
    link("thigh", 2.0, "0 0 -0.2") + '<link name="knee_cap"/>' + link("foot", 0.5, "0 0 -0.1"),
    joint("hip", "base", "thigh", kind="revolute", more=LIMIT)
    + joint("screw", "thigh", "knee_cap", kind="fixed")
    + joint("ankle", "thigh", "foot", xyz="0 0 -0.4"),
)
"""A thigh with a frame on it, and a foot; the hip has limits."""


def findings(model: Model) -> list[str]:
    """The remarks on a model, each after its kind."""
    found = report_on(model)["findings"]
    assert isinstance(found, list)
    return [f"{each['kind']} {each['text']}" for each in found]


def test_forcing_that_no_observer_sees_is_a_warning() -> None:
    """The plant's drives without the topic of their efforts."""
    forcing = "{harmonics: [{frequency: 5, sine: [1]}]}"
    unseen = findings(model_of(PENDULUM, "hinge", forcing=forcing))
    assert [each for each in unseen if each.startswith("warning The model has no forces")]
    seen = model_of(
        PENDULUM, "hinge", forcing=forcing, forces="{topic: /joint_states, field: effort}"
    )
    still = model_of(PENDULUM, "hinge")
    assert not [each for model in (seen, still) for each in findings(model) if "forcing" in each]


def test_limits_of_joints_that_the_model_does_not_use_are_named() -> None:
    """Nothing stops a joint at its limit; a joint without limits is not named."""
    found = findings(model_of(CHAIN, "hip, ankle"))
    assert (
        "note The URDF has limits of hip, which the model does not use: give a contact where the"
        " robot hits one." in found
    )


def test_a_start_beyond_a_limit_and_an_endless_joint_are_named() -> None:
    """With the value, and the limits that do not act; a slider has neither."""
    start = "{position: [2.5, 7], velocity: [0, 0]}"
    found = findings(model_of(CHAIN, "hip, ankle", initial_state=start))
    passed = "The start of hip is 2.5, outside its limits -1 to 2 rad, which are no contacts."
    endless = "Angles count on beyond a turn; encoders of ankle need not."
    assert [each for each in found if "start" in each] == [f"warning {passed}"]
    assert f"note {endless}" in found
    assert not [each for each in findings(model_of(SLIDER, "rail")) if "Angles" in each]


def test_planes_that_rebound_differently_are_a_warning() -> None:
    """Of two pads on one mass, G - E G E has the determinant -(a - b)^2: V could rise."""
    for second, count in ((0.9, 1), (0.2, 0)):
        pads = ", ".join(
            wall(name=name, normal="[0, 0, 1]", restitution=each)[1:-1]
            for name, each in (("soft", 0.2), ("hard", second))
        )
        found = findings(model_of(SLIDER, "rail", contacts=f"[{pads}]"))
        assert sum(each.startswith("warning") and "raise V" in each for each in found) == count


def test_joints_that_the_model_leaves_out_are_named_with_what_is_expected() -> None:
    """Beside those that are held on purpose."""
    found = findings(model_of(DOUBLE, "shoulder"))
    wanted = (
        "note Held at 0, as joints lacks them: elbow of the URDF in the model; expected in joints"
        " what moves, in held what rests elsewhere."
    )
    assert wanted in found
    held = findings(model_of(DOUBLE, "shoulder", held="{elbow: 0.1}"))
    assert "note Held, as no joint of the state: elbow at 0.1." in held


@pytest.mark.parametrize("command", ["check-model {}", "simulate {} --duration 1 -o {}.bag"])
def test_a_start_inside_a_plane_names_file_key_contact_gap_and_remedy(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A tip 0.48 m behind the plane."""
    model = model_of(
        PENDULUM, "hinge", contacts=wall(), initial_state="{position: [-0.5], velocity: [0]}"
    )
    file = tmp_path / "arm.yaml"
    file.write_text(model.text())
    assert main(command.replace("{}", str(file)).split()) == 2
    assert capsys.readouterr().err == (
        f"impact-observer: {file}: initial_state.position: is inside the plane of 'wall' (gap"
        " -0.479426 m); expected gap >= 0: start on its free side, or see normal and offset of"
        " contacts[0]\n"
    )


EFFORTS = "{topic: /joint_states, field: effort}"


@pytest.mark.parametrize(
    ("given", "found"),
    [
        ({}, "note The model has no forces, so its torques count as zero"),
        (
            {"forces": EFFORTS},
            "note The model has no torque_deviation: that of changes of efforts",
        ),
        ({"forces": EFFORTS, "torque_deviation": "0"}, "note The model has a torque_deviation of"),
        ({"forces": EFFORTS, "torque_deviation": "0.02"}, ""),
    ],
)
def test_torques_that_are_not_known_are_named(given: dict[str, str], found: str) -> None:
    """What an observer takes for zero or exact, and what it finds by itself."""
    lines = [each for each in findings(model_of(PENDULUM, "hinge", **given)) if "torque" in each]
    assert len(lines) == bool(found)
    assert all(each.startswith(found) for each in lines)
