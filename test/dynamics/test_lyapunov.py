# SPDX-License-Identifier: Apache-2.0
"""The Lyapunov distance."""

import numpy as np
import pytest
from systems import chain, sample, system

from impact_observer.dynamics import lyapunov


def test_distance_is_half_the_energy_of_the_difference() -> None:
    """Written out for two masses, with a coupled mass matrix."""
    model = system([[2, 0.5], [0.5, 1]], np.eye(2), [[3, -1], [-1, 4]])
    q, u = np.array([0.5, -2.0]), np.array([1.0, 3.0])
    kinetic = 2 * 1 + 2 * 0.5 * 1 * 3 + 1 * 9
    potential = 3 * 0.25 + 2 * -1 * 0.5 * -2 + 4 * 4
    assert lyapunov.distance(model, q, u) == pytest.approx((kinetic + potential) / 2, rel=1e-15)


def test_distance_is_zero_only_for_equal_states_where_stiffness_is_definite() -> None:
    """A norm squared: zero at zero, positive elsewhere, the same for both signs."""
    model = chain(3)
    rng = np.random.default_rng(1)
    q, u = rng.normal(size=(2, 50, 3))
    assert np.all(lyapunov.distance(model, q, u) > 0)
    np.testing.assert_array_equal(lyapunov.distance(model, q, u), lyapunov.distance(model, -q, -u))
    assert lyapunov.distance(model, np.zeros(3), np.zeros(3)) == 0.0


def test_distance_does_not_see_rigid_displacements() -> None:
    """A seminorm where stiffness is singular: the ball's height does not count."""
    ball = sample("bouncing_ball").system
    assert lyapunov.distance(ball, np.array([7.0]), np.array([0.0])) == 0.0
    assert lyapunov.distance(ball, np.array([7.0]), np.array([2.0])) == 2.0


def test_distance_keeps_the_shape_of_what_it_is_given() -> None:
    """One number a state, whatever the leading dimensions."""
    model = chain(2)
    rng = np.random.default_rng(2)
    q, u = rng.normal(size=(2, 3, 5, 2))
    found = lyapunov.distance(model, q, u)
    assert found.shape == (3, 5)
    assert found[1, 2] == pytest.approx(
        float(lyapunov.distance(model, q[1, 2], u[1, 2])), rel=1e-14
    )
    assert lyapunov.distance(model, q[0, 0], u[0, 0]).shape == ()
