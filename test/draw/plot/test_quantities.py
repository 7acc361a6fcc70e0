# SPDX-License-Identifier: Apache-2.0
"""Quantities of a state: names, values, deviations."""

import numpy as np
import pytest
from arms import PENDULUM, model_of, wall

from impact_observer.draw.plot.quantities import (
    deviations_of,
    quantities_of,
    selected,
    values_of,
)
from impact_observer.errors import UsageError
from impact_observer.model import parse_model, read_model
from impact_observer.robots import Robot

SYSTEM = read_model("three_mass").system
NAMES = ("a", "b")
PAIR = """
name: pair
bodies: [{name: a, mass: 1}, {name: b, mass: 1}]
stops: [{name: between, between: [a, b], gap: 0.1, restitution: 0.5}]
"""


def test_values_are_coordinates_velocities_and_gaps() -> None:
    """Gaps are the system's, the paper's equation (2)."""
    x = np.random.default_rng(2).normal(size=(5, 2 * SYSTEM.n))
    every = quantities_of(SYSTEM.coordinates, SYSTEM)
    states = selected(every, ("positions", "velocities"))
    np.testing.assert_array_equal(values_of(states, x), x)
    gaps = [SYSTEM.gap(each[: SYSTEM.n]) for each in x]
    np.testing.assert_allclose(values_of(selected(every, ("gaps",)), x), gaps, rtol=1e-14)
    motion = np.arange(np.size(gaps)).reshape(np.shape(gaps)) / 7
    moved = values_of(selected(every, ("gaps",)), x, motion)
    np.testing.assert_allclose(moved, np.array(gaps) + motion, rtol=1e-14)


def test_deviation_of_a_gap_between_bodies_contains_their_correlation() -> None:
    """The gap of two uncertain coordinates that move together is certain."""
    system = parse_model(PAIR, "pair.yaml").system
    root = np.random.default_rng(3).normal(size=(4, 4))
    common = root @ root.T
    moved = np.zeros((4, 4))
    moved[:2, :2] = 4.0
    every = quantities_of(NAMES, system)
    found = deviations_of(tuple(every.values()), np.array([common, moved]))
    w = np.array([-1.0, 1.0, 0.0, 0.0])
    order = [0, 2, 1, 3]
    np.testing.assert_allclose(found[0, :4], np.sqrt(np.diag(common))[order], rtol=1e-12)
    np.testing.assert_allclose(found[0, 4], np.sqrt(w @ common @ w), rtol=1e-12)
    np.testing.assert_allclose(found[1], [2.0, 0.0, 2.0, 0.0, 0.0], atol=1e-12)


def test_labels_have_the_unit_of_the_model() -> None:
    """Models of elements have m or their own unit; the unit of matrices is not known."""
    turning = parse_model(PAIR.replace("bodies", "unit: rad\nbodies"), "pair.yaml")
    again = parse_model(turning.text(), "again").system
    for system, units in (
        (parse_model(PAIR, "pair.yaml").system, ("m", "m/s", "m")),
        (turning.system, ("rad", "rad/s", "rad")),
        (again, ("rad", "rad/s", "rad")),
        (read_model("two_mass").system, ("m or rad", "m/s or rad/s", "m or rad")),
    ):
        every = [*quantities_of(system.coordinates, system).values()]
        found = [every[k].label.partition("[")[2].rstrip("]") for k in (0, 1, -1)]
        assert found == [*units]


def test_deviation_without_covariance_is_none() -> None:
    """The deviation is NaN; a variance that rounding made negative counts as zero."""
    every = tuple(quantities_of(("a",), None).values())
    found = deviations_of(every, np.array([np.full((2, 2), np.nan), np.diag([-1e-30, 1.0])]))
    assert np.isnan(found[0]).all()
    assert found[1].tolist() == [0.0, 1.0]


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (("positions",), ["q_x1", "q_x2", "q_x3"]),
        (("x2", "left"), ["q_x2", "u_x2", "g_left"]),
        (("u_x3", "velocities"), ["u_x3", "u_x1", "u_x2"]),
        (("gaps",), ["g_right", "g_left"]),
    ],
)
def test_words_select_quantities(words: tuple[str, ...], names: list[str]) -> None:
    """Quantities are selected in the order of the words, each once."""
    every = quantities_of(SYSTEM.coordinates, SYSTEM)
    assert [each.name for each in selected(every, words)] == names


def test_unknown_word_is_one_line_with_what_there_is() -> None:
    """Without a model the error names no gaps."""
    with pytest.raises(UsageError) as error:
        selected(quantities_of(NAMES, None), ("stop",))
    assert "--select stop" in str(error.value)
    assert "q_a, u_a, q_b, u_b" in str(error.value)


def test_gaps_of_a_robot_are_those_of_its_kinematics() -> None:
    """A pendulum of 1 m at a wall 0.2 m behind it: 0.2 + sin q, which moves by cos q."""
    pytest.importorskip("pinocchio")
    robot = Robot(model_of(PENDULUM, "hinge", contacts=wall(offset=-0.2)))
    q = np.linspace(-3, 3, 7)
    x = np.stack([q, np.ones(7)], axis=1)
    every = quantities_of(robot.coordinates, robot)
    shown = selected(every, ("wall", "hinge"))
    values = values_of(shown, x, robot.gaps_at(np.zeros(7, np.int64), x))
    np.testing.assert_allclose(values, np.stack([0.2 + np.sin(q), q, np.ones(7)], axis=1))
    W = np.array([robot.directions(each) for each in x[:, :1]])
    covariance = np.tile(np.diag([0.04, 0.09]), (7, 1, 1))
    found = deviations_of(shown, covariance, W)
    wanted = np.stack([0.2 * np.abs(np.cos(q)), np.full(7, 0.2), np.full(7, 0.3)], axis=1)
    np.testing.assert_allclose(found, wanted, atol=1e-12)
    labels = [each.label for each in shown]
    assert labels == ["gap of wall [m]", "hinge [rad]", "dhinge/dt [rad/s]"]
