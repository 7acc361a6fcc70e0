# SPDX-License-Identifier: Apache-2.0
"""Grounds that move: their keys, their text, and the frame in which no stop moves."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from systems import examples, numbers, vectors

from impact_observer.errors import ModelError, UsageError
from impact_observer.model import Model, System, parse_model, read_model
from impact_observer.model.free_parameters import parametric_family
from impact_observer.resources import shared

ELEMENTS = """\
name: rig
bodies:  [{name: x1, mass: 1}, {name: x2, mass: 2}]
grounds:
  - {name: table, motion: {harmonics: [{amplitude: 0.1, frequency: 3, phase: 0.4}]}}
  - name: wall
    motion: {sampled: "time,displacement\\n-1,0\\n0.5,0.2\\n2,0.1\\n"}
springs:
  - {between: [table, x1], stiffness: 10, damping: 0.3}
  - {between: [x1, x2], stiffness: 20}
  - {between: [x2, wall], stiffness: 5}
forces:  [{body: x2, amplitude: 4, frequency: 2.5}]
stops:
  - {name: foot, between: [table, x1], gap: 0.5, restitution: 0.5}
  - {name: head, body: x2, limit: 0.7, side: above, ground: wall, restitution: 0.7}
"""
MATRICES = """\
name: rig
coordinates: [x1, x2]
mass:      [[1, 0], [0, 2]]
damping:   [[0.3, 0], [0, 0]]
stiffness: [[30, -20], [-20, 25]]
grounds:
  - {name: table, motion: {harmonics: [{amplitude: 0.1, frequency: 3, phase: 0.4}]}}
  - name: wall
    motion: {sampled: "time,displacement\\n-1,0\\n0.5,0.2\\n2,0.1\\n"}
forcing:
  harmonics: [{frequency: 2.5, cosine: [0, 4]}]
  grounds:
    - {name: table, stiffness: [10, 0], damping: [0.3, 0]}
    - {name: wall, stiffness: [0, 5]}
contacts:
  - name: foot
    direction: [1, 0]
    gap: 0.5
    restitution: 0.5
    motion: [{ground: table, factor: -1}]
  - name: head
    direction: [0, -1]
    gap: 0.7
    restitution: 0.7
    motion: [{ground: wall, factor: 1}]
"""


def ns(*seconds: float) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Instants since the epoch."""
    return np.round(np.array(seconds) * 1e9).astype(np.int64)


def displacements(system: System, *seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Of the grounds, and their speeds."""
    assert system.frame is not None
    return system.frame.displacements(ns(*seconds))


@pytest.mark.parametrize("text", [ELEMENTS, MATRICES], ids=["elements", "matrices"])
def test_motion_of_grounds_is_read(text: str) -> None:
    """A harmonic one, and a spline that is at rest at both ends and held after the last."""
    found = parse_model(text, "m").system
    s, speed = displacements(found, 0.0, 0.5, 2.0, 9.0)
    t = np.array([0.0, 0.5, 2.0, 9.0])
    np.testing.assert_allclose(s[:, 0], 0.1 * np.cos(3 * t + 0.4), rtol=1e-13)
    np.testing.assert_allclose(speed[:, 0], -0.3 * np.sin(3 * t + 0.4), rtol=1e-13)
    np.testing.assert_allclose(s[1:, 1], [0.2, 0.1, 0.1], rtol=1e-14)
    np.testing.assert_allclose(speed[2:, 1], 0.0, atol=1e-15)
    near, _ = displacements(found, -1.0, -0.999)
    assert abs(near[1, 1] - near[0, 1]) < 1e-6


def test_elements_and_matrices_make_the_same_system() -> None:
    """Gaps, speeds and forces of both agree, in the frame and outside."""
    one, two = (parse_model(text, "m").system for text in (ELEMENTS, MATRICES))
    for name in ("M", "C", "K", "W", "q_r"):
        np.testing.assert_allclose(getattr(one, name), getattr(two, name), atol=1e-15)
    t = np.linspace(0.0, 4.0, 9)
    np.testing.assert_allclose(
        one.forcing.derivatives(t, 1), two.forcing.derivatives(t, 1), atol=1e-13
    )


@examples(30)
@given(st.data())
def test_equations_in_the_frame_are_those_outside(data: st.DataObject) -> None:
    """Accelerations, gaps and contact speeds, each from its definition in the coordinates."""
    system = parse_model(ELEMENTS, "m").system
    assert system.frame is not None
    q, u, t = data.draw(vectors(2)), data.draw(vectors(2)), data.draw(numbers(0.0, 2.0))
    (s,), (rate,) = displacements(system, t)
    x = system.to_frame(ns(t), np.append(q, u)[None])[0]
    p, du = x[:2], x[2:]
    np.testing.assert_allclose(system.from_frame(ns(t), x[None])[0], [*q, *u], atol=1e-14)
    gaps = [q[0] - s[0] + 0.5, 0.7 + s[1] - q[1]]
    np.testing.assert_allclose(system.gap(p), gaps, atol=1e-14)
    speeds = [u[0] - rate[0], rate[1] - u[1]]
    np.testing.assert_allclose(system.contact_speed(du), speeds, atol=1e-14)
    spring = 20 * (q[1] - q[0])
    loads = [
        10 * (s[0] - q[0]) + 0.3 * (rate[0] - u[0]) + spring,
        5 * (s[1] - q[1]) - spring + 4 * np.cos(2.5 * t),
    ]
    second = system.frame.grounds.motion.derivatives(np.array([t]), 2)[2, 0]
    inside = system.forcing(t) - system.C @ du - system.K @ p
    found = np.linalg.solve(system.M, inside) + system.frame.shift @ second
    np.testing.assert_allclose(found, np.array(loads) / [1, 2], atol=1e-11)


@pytest.mark.parametrize("text", [ELEMENTS, MATRICES], ids=["elements", "matrices"])
def test_text_of_a_model_reads_back_to_equal_numbers(text: str, tmp_path: Path) -> None:
    """A table that was in a file of its own is in it."""
    table = '"time,displacement\\n-1,0\\n0.5,0.2\\n2,0.1\\n"'
    assert table in text
    (tmp_path / "wall.csv").write_text("time,displacement\n-1,0\n0.5,0.2\n2,0.1\n")
    (tmp_path / "rig.yaml").write_text(text.replace(table, "wall.csv"))
    model = read_model(tmp_path / "rig.yaml")
    again = parse_model(model.text(), "again")
    assert again.text() == model.text()
    t = np.linspace(0.0, 4.0, 7)
    one, two = (each.system.forcing.derivatives(t, 3) for each in (model, again))
    np.testing.assert_array_equal(one, two)


def test_start_inside_a_moving_stop_is_one_line() -> None:
    """The gap is that at the epoch, where the table is at 0.1 cos 0.4."""
    start = "initial_state: {position: [-0.41, 0], velocity: [0, 0]}\n"
    parse_model(ELEMENTS + start.replace("-0.41", "-0.40"), "m")
    with pytest.raises(ModelError, match=r"initial_state.position"):
        parse_model(ELEMENTS + start, "m")


def test_a_start_inside_a_stop_names_what_is_usually_wrong() -> None:
    """An amplitude in mm, bodies the wrong way round, or a direction of the wrong sign."""
    start = "initial_state: {position: [-0.40, 0], velocity: [0, 0]}\n"
    in_mm = ELEMENTS.replace("amplitude: 0.1", "amplitude: 100")
    assert in_mm != ELEMENTS
    with pytest.raises(ModelError, match=r"initial_state.position: .* side, .* units"):
        parse_model(in_mm + start, "m")
    turned = (shared("config") / "two_mass.yaml").read_text()
    turned = turned.replace("[0, -1], gap: 0.5", "[0, 1], gap: 0")
    with pytest.raises(
        ModelError, match=r"initial_state.position: .* sign of direction, .* units"
    ):
        parse_model(turned, "m")


def test_amplitude_and_phase_of_a_ground_are_parameters() -> None:
    """Forces of the family are those of the model with them; those of its frame are refused."""
    model = parse_model(ELEMENTS, "m")
    family = parametric_family(model.system, ["ground-amplitude", "ground-phase.table"])
    assert family.names == ("ground-amplitude.table.1", "ground-phase.table.1")
    found = family.system_at(np.array([1.5, 0.2]))
    text = ELEMENTS.replace("amplitude: 0.1", "amplitude: 0.15").replace(
        "phase: 0.4", "phase: 0.6"
    )
    expected, t = parse_model(text, "m").system, np.linspace(0.0, 3.0, 7)
    np.testing.assert_allclose(
        found.forcing.derivatives(t, 0), expected.forcing.derivatives(t, 0), atol=1e-13
    )
    x = np.zeros((2, 4))
    np.testing.assert_allclose(
        found.from_frame(ns(0.3, 1.0), x), expected.from_frame(ns(0.3, 1.0), x), atol=1e-15
    )
    for name in ("mass", "stiffness-scale", "damping.table-x1"):
        with pytest.raises(UsageError, match="changes what moving grounds do"):
            parametric_family(model.system, [name], model.elements)
    with pytest.raises(UsageError, match="an observer takes clocks"):
        parametric_family(model.system, ["clock-offset"], observed=True)


def test_model_without_a_file_has_a_text() -> None:
    """A system has all that is needed, whatever form it was read from."""
    text = Model(parse_model(ELEMENTS, "m").system).text()
    assert parse_model(text, "again").text() == text
