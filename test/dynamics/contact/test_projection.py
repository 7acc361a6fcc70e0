# SPDX-License-Identifier: Apache-2.0
"""The position jump of the geometric law, for every kind of stiffness."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import linalg
from systems import LAPLACIAN, chain, examples, system, systems, vectors

from impact_observer.dynamics import PositionProjection
from impact_observer.model import System

Array = NDArray[np.float64]


def column(model: System, active: tuple[int, ...], i: int) -> Array:
    """The minimiser of ``z^T K z`` with ``W_A^T z = e_i``, ties broken by ``z^T M z``.

    By null spaces: all solutions, among them those of least energy, among them the lightest.
    """
    W = model.W[:, list(active)]
    z = np.linalg.lstsq(W.T, np.eye(len(active))[i], rcond=1e-10)[0]
    free = linalg.null_space(W.T, rcond=1e-10)
    for form in (model.K, model.M):
        if free.shape[1]:
            reduced = free.T @ form @ free
            scale = max(float(np.trace(form)), 1e-300)
            inverse = linalg.pinv(reduced, atol=1e-10 * scale)
            z = z - free @ inverse @ (free.T @ form @ z)
            values, shapes = linalg.eigh(reduced)
            free = free @ shapes[:, values <= 1e-10 * scale]
    return np.asarray(z)


def potential(model: System, difference: Array) -> float:
    """``1/2 dq^T K dq``."""
    return float(difference @ model.K @ difference) / 2


@examples(30)
@given(st.data())
def test_strain_is_the_energy_of_the_jump(data: st.DataObject) -> None:
    """At one contact, and at several."""
    model = data.draw(systems(contacts=(1, 3)))
    active = tuple(sorted(data.draw(st.sets(st.integers(0, model.m - 1), min_size=1))))
    q = np.array(data.draw(vectors(model.n)))
    projection = PositionProjection(model)
    jump = projection.position_after(q, active) - q
    size = float(np.max(np.abs(model.K)) * (1 + np.max(np.abs(q)) + np.max(np.abs(jump))) ** 2)
    assert projection.strain(q, active) == pytest.approx(potential(model, jump), abs=1e-9 * size)


@pytest.mark.slow
@examples(50)
@given(st.data())
def test_jump_is_the_least_one_of_the_theory(data: st.DataObject) -> None:
    """Every column against null spaces, K singular or not, contacts redundant or not."""
    model = data.draw(systems(contacts=(1, 3)))
    active = tuple(sorted(data.draw(st.sets(st.integers(0, model.m - 1), min_size=1))))
    W = model.W[:, list(active)]
    found = PositionProjection(model).jump(active)
    if np.linalg.matrix_rank(W, tol=1e-6) < len(active):
        # Redundant: the jump is that of all gaps that can be closed, here of W's range.
        reach = W.T @ np.linalg.pinv(W.T)
        expected = np.column_stack([column(model, active, i) for i in range(len(active))]) @ reach
        np.testing.assert_allclose(W.T @ found @ reach, reach, atol=1e-7)
        assert expected.shape == found.shape
        return
    expected = np.column_stack([column(model, active, i) for i in range(len(active))])
    np.testing.assert_allclose(found, expected, atol=1e-6 * (1 + np.max(np.abs(expected))))


@pytest.mark.slow
@examples(50)
@given(st.data())
def test_jump_is_the_papers_where_stiffness_is_definite(data: st.DataObject) -> None:
    """``q+ = q- - K^-1 W_A L^-1 g_A``, equation (5)."""
    model = data.draw(systems(contacts=(1, 2), rigid=False))
    q = data.draw(vectors(model.n))
    W = model.W
    flexibility = W.T @ np.linalg.solve(model.K, W)
    after = PositionProjection(model).position_after(q, tuple(range(model.m)))
    if np.linalg.cond(flexibility) < 1e8:
        Sigma = -np.linalg.solve(flexibility, model.gap(q))
        np.testing.assert_allclose(after, q + np.linalg.solve(model.K, W @ Sigma), atol=1e-7)
        np.testing.assert_allclose(model.gap(after), 0.0, atol=1e-9)
    pushes = model.K @ (after - q)
    beyond = pushes - W @ np.linalg.lstsq(W, pushes, rcond=1e-10)[0]
    np.testing.assert_allclose(beyond, 0.0, atol=1e-7 * (1 + np.max(np.abs(pushes))))


@pytest.mark.slow
@examples(50)
@given(st.data())
def test_jump_lowers_the_distance_by_what_the_theory_says(data: st.DataObject) -> None:
    """``dV = -1/2 dg_A^T L^-1 dg_A`` for two replicas, with ``L^-1 = Z^T K Z``."""
    model = data.draw(systems(contacts=(1, 3)))
    active = tuple(sorted(data.draw(st.sets(st.integers(0, model.m - 1), min_size=1))))
    one, two = data.draw(vectors(model.n)), data.draw(vectors(model.n))
    projection = PositionProjection(model)
    difference = one - two
    jumped = projection.position_after(one, active) - projection.position_after(two, active)
    dg = model.W[:, list(active)].T @ difference
    elastic = projection.jump(active) @ dg
    lost = potential(model, elastic)
    scale = 1 + potential(model, difference) + lost
    assert potential(model, jumped) == pytest.approx(
        potential(model, difference) - lost, abs=1e-8 * scale
    )
    np.testing.assert_allclose(
        model.W[:, list(active)].T @ jumped, 0.0, atol=1e-7 * (1 + np.max(np.abs(dg)))
    )


@pytest.mark.slow
@examples(30)
@given(st.data())
def test_second_jump_changes_nothing(data: st.DataObject) -> None:
    """A projection is idempotent, on contacts that can be closed together."""
    model = data.draw(systems(contacts=(1, 3)))
    active = tuple(range(model.m))
    projection = PositionProjection(model)
    q = projection.position_after(data.draw(vectors(model.n)), active)
    again = projection.position_after(q, active)
    np.testing.assert_allclose(again, q, atol=1e-7 * (1 + np.max(np.abs(q))))


def test_contact_between_free_bodies_does_not_see_their_common_motion() -> None:
    """What rounding leaves of the rigid mode in ``W`` is not taken for a way to close the gap."""
    model = system(
        np.diag([1.0, 1.7, 2.1]),
        np.zeros((3, 3)),
        [[3, -3, 0], [-3, 5, -2], [0, -2, 2]],
        contacts=[([-1, 1, 0], 0.1, 0.5), ([0, -1, 1], 0.2, 0.8)],
    )
    projection = PositionProjection(model)
    for active in ((0,), (1,), (0, 1)):
        jump = projection.jump(active)
        assert np.max(np.abs(jump)) < 2
        np.testing.assert_allclose(np.ones(3) @ model.M @ jump, 0.0, atol=1e-13)  # mass centre
        np.testing.assert_allclose(model.W[:, active].T @ jump, np.eye(len(active)), atol=1e-13)


def test_free_body_gives_way_before_a_spring_does() -> None:
    """A rigid displacement costs no energy: springs stay as they are."""
    model = system(np.eye(3), np.zeros((3, 3)), LAPLACIAN, contacts=[([1, 0, 0], 0.0, 0.5)])
    after = PositionProjection(model).position_after(np.array([0.5, 1.0, 3.0]), (0,))
    np.testing.assert_allclose(after, [0.0, 0.5, 2.5], atol=1e-14)


def test_ties_go_to_the_lightest_motion() -> None:
    """Two free bodies and one gap between them: they share the displacement by their masses."""
    model = system(
        np.diag([1.0, 3.0]), np.zeros((2, 2)), np.zeros((2, 2)), contacts=[([-1, 1], 0.0, 0.5)]
    )
    after = PositionProjection(model).position_after(np.array([0.0, 1.0]), (0,))
    np.testing.assert_allclose(after, [0.75, 0.75], atol=1e-14)  # the mass centre stays


def test_redundant_contacts_are_one() -> None:
    """Three sensors on one stop, one of them in other units, close the gap once."""
    stop = ([0, -1], 0.5, 0.7)
    single = chain(2, contacts=[stop])
    many = chain(2, contacts=[stop, stop, ([0, -2], 1.0, 0.7)])
    q = np.array([0.3, 0.9])
    once = PositionProjection(single).position_after(q, (0,))
    np.testing.assert_allclose(
        PositionProjection(many).position_after(q, (0, 1, 2)), once, atol=1e-14
    )
