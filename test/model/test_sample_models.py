# SPDX-License-Identifier: Apache-2.0
"""The sample models are those that the documents name."""

import math

import numpy as np
from systems import sample

from impact_observer.model import parse_model


def test_two_mass_has_the_documented_numbers() -> None:
    """Every number of the sample in the design."""
    model = sample("two_mass")
    s = model.system
    assert s.name == "two_mass"
    assert s.coordinates == ("x1", "x2")
    assert s.M.tolist() == [[1, 0], [0, 1]]
    assert s.C.tolist() == [[0.2, -0.1], [-0.1, 0.1]]
    assert s.K.tolist() == [[20, -10], [-10, 10]]
    assert s.forcing.constant.tolist() == [0, 0]
    assert s.forcing.frequency.tolist() == [2.5]
    assert s.forcing.cosine.tolist() == [[0, 4]]
    assert s.forcing.sine.tolist() == [[0, 0]]
    assert s.contact_names == ("stop",)
    assert s.W.tolist() == [[0], [-1]]
    assert (s.q_r.tolist(), s.eps.tolist()) == ([0.5], [0.7])
    position, velocity = model.initial_state()
    assert (position.tolist(), velocity.tolist()) == ([0.1, -0.2], [0.5, 0])


def test_three_mass_assembles_to_the_documented_numbers() -> None:
    """Element form against matrices written by hand."""
    model = sample("three_mass")
    s = model.system
    laplacian = np.array([[2, -1, 0], [-1, 2, -1], [0, -1, 2]])
    assert s.coordinates == ("x1", "x2", "x3")
    assert s.M.tolist() == np.diag([1, 1.5, 1]).tolist()
    assert s.K.tolist() == (25 * laplacian).tolist()
    np.testing.assert_allclose(s.C, 0.06 * laplacian, rtol=1e-15)
    for t in (0.0, 0.3, 7.7):
        expected = [3 * math.cos(2.7 * t), 0, 2 * math.sin(3.9 * t)]
        np.testing.assert_allclose(s.forcing(t), expected, atol=1e-14)
    assert s.contact_names == ("right", "left")
    np.testing.assert_array_equal(s.W, [[0, 1], [0, 0], [-1, 0]])
    assert (s.q_r.tolist(), s.eps.tolist()) == ([0.3, 0.25], [0.6, 0.8])
    position, velocity = model.initial_state()
    assert (position.tolist(), velocity.tolist()) == ([0.1, -0.1, 0.05], [0.5, 0, -0.5])


def test_bouncing_ball_is_one_body_under_gravity() -> None:
    """The smallest system with a rigid-body mode, with the published numbers."""
    model = sample("bouncing_ball")
    s = model.system
    assert (s.M.tolist(), s.C.tolist(), s.K.tolist()) == ([[1]], [[0]], [[0]])
    assert s.forcing(3.0).tolist() == [-9.81]
    assert not s.forcing.depends_on_time
    assert (s.W.tolist(), s.q_r.tolist(), s.eps.tolist()) == ([[1]], [0], [0.9])
    assert [part.tolist() for part in model.initial_state()] == [[1], [0]]


def test_element_form_assembles_to_the_matrix_form() -> None:
    """The elements of the design's example are its two_mass matrices."""
    elements = parse_model(
        """
name: two_mass
bodies:  [{name: x1, mass: 1}, {name: x2, mass: 1}]
springs:
  - {between: [ground, x1], stiffness: 10, damping: 0.1}
  - {between: [x1, x2], stiffness: 10, damping: 0.1}
forces:  [{body: x2, amplitude: 4, frequency: 2.5, phase: 0}]
stops:   [{name: stop, body: x2, limit: 0.5, side: above, restitution: 0.7}]
""",
        "elements",
    ).system
    matrices = sample("two_mass").system
    for name in ("M", "C", "K", "W", "q_r", "eps"):
        np.testing.assert_allclose(getattr(elements, name), getattr(matrices, name), rtol=1e-15)
    for t in (0.0, 0.4, 9.0):
        np.testing.assert_allclose(elements.forcing(t), matrices.forcing(t), atol=1e-15)


def test_stop_between_two_bodies_measures_their_distance() -> None:
    """``g = q_b - q_a + gap``, and a spring to the ground may name it second."""
    s = parse_model(
        """
name: pair
bodies: [{name: a, mass: 2}, {name: b, mass: 3}]
springs: [{between: [a, ground], stiffness: 7}]
forces: [{body: a, constant: 1}, {body: a, constant: 2}]
stops: [{name: s, between: [a, b], gap: 0.1, restitution: 0.7}]
""",
        "pair",
    ).system
    assert s.K.tolist() == [[7, 0], [0, 0]]
    assert s.M.tolist() == [[2, 0], [0, 3]]
    assert s.gap(np.array([0.5, 0.7])).tolist() == [0.7 - 0.5 + 0.1]
    assert s.forcing(1.0).tolist() == [3, 0]


def test_phase_of_a_force_leads() -> None:
    """``amplitude cos(w t + phase)``, two forces of one frequency add up."""
    s = parse_model(
        """
name: phased
bodies: [{name: a, mass: 1}]
forces:
  - {body: a, amplitude: 2, frequency: 3, phase: 0.4}
  - {body: a, amplitude: 1, frequency: 3}
""",
        "phased",
    ).system
    for t in (0.0, 0.7, 2.0):
        expected = 2 * math.cos(3 * t + 0.4) + math.cos(3 * t)
        np.testing.assert_allclose(s.forcing(t), [expected], rtol=1e-14)
    assert s.m == 0
