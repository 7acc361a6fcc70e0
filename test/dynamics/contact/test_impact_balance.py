# SPDX-License-Identifier: Apache-2.0
"""The balance of an impact: speeds, impulses and energies, against the jump of the velocities."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from systems import examples, system, systems, vectors

from impact_observer.dynamics import ImpactLaw
from impact_observer.dynamics.contact.impact_balance import impact_balance, uncertain_balance
from impact_observer.model import System
from impact_observer.model.free_parameters import parametric_family


def test_one_contact_is_the_closed_form() -> None:
    """``Lambda = -(1 + eps) gamma- / G``, and ``1/2 (1 - eps^2) gamma-^2 / G`` is lost."""
    model = system([[2, 0.5], [0.5, 1]], np.eye(2), np.eye(2), contacts=[([1, -3], 0.0, 0.6)])
    w = np.array([1.0, -3.0])
    G = float(w @ np.linalg.solve(model.M, w))
    found = impact_balance(model, (0,), (0,), np.array([-2.5]))
    wanted = np.array([[2.5, 0.6 * 2.5, 1.6 * 2.5 / G, (1 - 0.6**2) * 2.5**2 / G / 2]])
    np.testing.assert_allclose(found, wanted, rtol=1e-14)


@examples(200)
@given(st.data())
def test_balance_is_that_of_the_jump(data: st.DataObject) -> None:
    """Speeds are those of ``u+``; the energies add up to what the kinetic energy loses."""
    model: System = data.draw(systems(contacts=(1, 3), common_restitution=True))
    u, law, active = data.draw(vectors(model.n)), ImpactLaw(model), tuple(range(model.m))
    impulses, after = law.impulses(u, active), law.velocity_after(u, active)
    pressed = tuple(np.flatnonzero(impulses > 0).tolist())
    found = impact_balance(model, active, pressed, model.contact_speed(u))
    scale = 1e-9 * float(1 + u @ model.M @ u)
    np.testing.assert_allclose(found[:, 0], -model.contact_speed(u), atol=scale)
    np.testing.assert_allclose(found[:, 1], model.contact_speed(after), atol=scale)
    np.testing.assert_allclose(model.W @ found[:, 2], model.M @ (after - u), atol=1e3 * scale)
    lost = float(u @ model.M @ u - after @ model.M @ after) / 2
    assert found[:, 3].sum() == pytest.approx(lost, abs=1e3 * scale)


def test_speeds_beside_those_of_the_law_change_impulse_and_energy() -> None:
    """A mass of 2 kg that leaves 0.1 m/s faster: the impulse is larger by 0.2 N s."""
    model = system([[2]], [[0]], [[1]], contacts=[([1], 0, 0.5)])
    found = impact_balance(model, (0,), (0,), np.array([-2.0]), np.array([0.1]))
    np.testing.assert_allclose(found, [[2, 1.1, 6.2, 4 - 1.1**2]])


def test_contacts_that_depend_on_each_other_share_the_impulse() -> None:
    """The same stop twice: half of the impulse each."""
    model = system([[1]], [[0]], [[1]], contacts=[([1], 0, 0.5), ([1], 0, 0.5)])
    found = impact_balance(model, (0, 1), (0, 1), np.array([-2.0, -2.0]))
    np.testing.assert_allclose(found, [[2, 1, 1.5, 0.75]] * 2)


def test_deviations_of_a_balance_are_those_of_its_derivatives() -> None:
    """A mass of 2 kg; speed, restitution and rebound have independent errors."""
    m, e, s = 2.0, 0.6, 2.5
    model = system([[m]], [[0]], [[1]], contacts=[([1], 0, e)])
    family = parametric_family(model, ("restitution",))
    errors = speed, restitution, rebound = 0.01, 0.02, 0.03
    values, deviations = uncertain_balance(
        family.near,
        (0,),
        (0,),
        gamma=np.array([-s]),
        theta=family.nominal,
        root=np.diag([speed, restitution]),
        scatter=np.array([rebound]),
    )
    np.testing.assert_allclose(values, [[s, e * s, m * (1 + e) * s, m * (1 - e**2) * s**2 / 2]])
    slopes = np.array(
        [
            [1, 0, 0],
            [e, s, 1],
            [m * (1 + e), m * s, m],
            [m * (1 - e**2) * s, -m * e * s**2, -m * e * s],
        ]
    )
    np.testing.assert_allclose(deviations[0], np.linalg.norm(slopes * errors, axis=1), rtol=1e-5)
