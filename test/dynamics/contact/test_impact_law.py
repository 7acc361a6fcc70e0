# SPDX-License-Identifier: Apache-2.0
"""Newton's impact law on one contact and on many at once."""

from itertools import chain as joined
from itertools import combinations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import linalg
from systems import chain, delassus, examples, system, systems, vectors

from impact_observer.dynamics import ImpactLaw
from impact_observer.errors import ImpactLawError
from impact_observer.model import System

Array = NDArray[np.float64]


def enumerated(model: System, u: Array) -> list[Array]:
    """``u+`` of every set of contacts that solves the complementarity problem."""
    G, gamma = delassus(model), model.contact_speed(u)
    b = (1 + model.eps) * gamma
    scale = 1e-9 * (1 + np.max(np.abs(b)))
    found = []
    subsets = joined.from_iterable(combinations(range(model.m), k) for k in range(model.m + 1))
    for subset in map(list, subsets):
        impulses = np.zeros(model.m)
        impulses[subset] = np.linalg.lstsq(G[np.ix_(subset, subset)], -b[subset], rcond=1e-12)[0]
        separation = G @ impulses + b
        solves = np.all(np.abs(separation[subset]) <= scale)
        if solves and np.all(impulses >= -scale) and np.all(separation >= -scale):
            found.append(u + np.linalg.solve(model.M, model.W @ impulses))
    return found


def assert_law_holds(model: System, u: Array, active: tuple[int, ...]) -> None:
    """Complementarity, the equation of impact, and the change of energy of our derivation."""
    law, index = ImpactLaw(model), list(active)
    impulses = law.impulses(u, active)
    after = law.velocity_after(u, active)
    W, eps = model.W[:, index], model.eps[index]
    before, speed = W.T @ u, W.T @ after
    xi = speed + eps * before
    scale = float(np.max(np.abs(before), initial=0.0))
    assert np.all(impulses >= 0)
    assert np.all(xi >= -1e-9 * scale)
    stiffness = np.diag(delassus(model))[index]
    assert np.all(np.abs(impulses * xi) * stiffness <= 1e-8 * scale**2 * (1 + stiffness))
    np.testing.assert_allclose(model.M @ (after - u), W @ impulses, atol=1e-9 * (1 + scale))
    gained = (after @ model.M @ after - u @ model.M @ u) / 2
    expected = np.sum((1 - eps) * before * impulses) / 2
    assert gained == pytest.approx(expected, abs=1e-8 * float(1 + u @ model.M @ u))


def test_single_contact_is_the_closed_form() -> None:
    """``Lambda = -(1 + eps) gamma- / G`` when the gap closes."""
    model = system([[2, 0.5], [0.5, 1]], np.eye(2), np.eye(2), contacts=[([1, -3], 0.0, 0.6)])
    u = np.array([-1.0, 0.5])
    gamma, G = float(model.contact_speed(u)[0]), delassus(model)[0, 0]
    assert ImpactLaw(model).impulses(u, (0,)) == pytest.approx(-1.6 * gamma / G, rel=1e-14)
    after = ImpactLaw(model).velocity_after(u, (0,))
    assert model.contact_speed(after)[0] == pytest.approx(-0.6 * gamma, rel=1e-14)


@pytest.mark.slow
@examples(30)
@given(st.data())
def test_law_agrees_with_trying_every_set_of_contacts(data: st.DataObject) -> None:
    """``u+`` is unique; where no set solves the problem there is an error."""
    model = data.draw(systems(contacts=(1, 5), common_restitution=False))
    u = data.draw(vectors(model.n))
    expected = enumerated(model, u)
    try:
        found = ImpactLaw(model).velocity_after(u, tuple(range(model.m)))
    except ImpactLawError:
        assert not expected
        return
    assert expected
    np.testing.assert_allclose(found, expected[0], atol=1e-7)


def test_doubled_contact_with_unequal_restitution_obeys_the_larger_one() -> None:
    """Two contacts at one stop: the complementarity problem has a solution."""
    model = system(1, 1, 1, contacts=[([1], 0.0, 0.5), ([1], 0.0, 0.8), ([2], 0.0, 0.5)])
    after = ImpactLaw(model).velocity_after(np.array([-1.0]), (0, 1, 2))
    assert after == pytest.approx(0.8, rel=1e-12)


def test_floor_and_ceiling_with_unequal_restitution_have_no_solution() -> None:
    """A floor that throws faster than the ceiling takes: a named error with the remedy."""
    model = system(1, 1, 1, contacts=[([1], 0.0, 0.8), ([-1], 0.0, 0.5)])
    with pytest.raises(ImpactLawError) as caught:
        ImpactLaw(model).velocity_after(np.array([-1.0]), (0, 1))
    line = str(caught.value)
    for fragment in ("'c1', 'c2'", "-1, 1 m/s", "0.8, 0.5", "common restitution"):
        assert fragment in line
    assert len(line.splitlines()) == 1
    upwards = ImpactLaw(model).velocity_after(np.array([1.0]), (0, 1))
    assert upwards == pytest.approx(-0.5, rel=1e-12)  # the other way round there is one


@pytest.mark.slow
@examples(60)
@given(st.data())
def test_common_restitution_always_has_a_solution_that_loses_energy(data: st.DataObject) -> None:
    """Dependent contacts included: ``dT = -(1 - eps)/(2 (1 + eps)) Lambda^T G Lambda``."""
    model = data.draw(systems(max_n=2, contacts=(2, 6), common_restitution=True))
    u = data.draw(vectors(model.n))
    impulses = ImpactLaw(model).impulses(u, tuple(range(model.m)))
    after = u + np.linalg.solve(model.M, model.W @ impulses)
    eps = model.eps[0]
    lost = (u @ model.M @ u - after @ model.M @ after) / 2
    expected = (1 - eps) / (1 + eps) / 2 * (impulses @ delassus(model) @ impulses)
    assert lost == pytest.approx(expected, abs=1e-9 * float(1 + u @ model.M @ u))


@pytest.mark.slow
@examples(30)
@given(st.data())
def test_velocity_jump_does_not_raise_the_distance_of_two_solutions(data: st.DataObject) -> None:
    """``du^T M du`` cannot grow when ``G - E G E >= 0``, whichever contacts are closed."""
    model = data.draw(systems(contacts=(1, 4), common_restitution=None))
    G, E = delassus(model), np.diag(model.eps)
    assume(np.linalg.eigvalsh(G - E @ G @ E)[0] >= 0 or np.ptp(model.eps) == 0)
    one, two = data.draw(vectors(model.n)), data.draw(vectors(model.n))
    active = tuple(range(model.m))
    law = ImpactLaw(model)
    try:
        gap = law.velocity_after(one, active) - law.velocity_after(two, active)
    except ImpactLawError:
        assume(False)
        return
    before = (one - two) @ model.M @ (one - two)
    assert gap @ model.M @ gap <= before + 1e-9 * (1 + before)


def test_unequal_restitution_can_raise_the_distance_of_two_solutions() -> None:
    """The eigenvalue test is needed: where it fails, ``du^T M du`` grows for some pair."""
    model = system(
        [[1, 0.9], [0.9, 1]], np.eye(2), np.eye(2), contacts=[([1, 0], 0, 0.0), ([0, 1], 0, 1.0)]
    )
    G, E = delassus(model), np.diag(model.eps)
    assert np.linalg.eigvalsh(G - E @ G @ E)[0] < 0
    flexibility = np.linalg.inv(G)
    growths, directions = linalg.eigh(E @ flexibility @ E, flexibility)
    one = np.array([-3.0, -3.0])  # both contacts are hit, by either solution
    two = one + 1e-3 * directions[:, -1]
    law = ImpactLaw(model)
    before, after = one - two, law.velocity_after(one, (0, 1)) - law.velocity_after(two, (0, 1))
    growth = (after @ model.M @ after) / (before @ model.M @ before)
    assert growth == pytest.approx(growths[-1], rel=1e-6)
    assert growth > 1


def test_newtons_cradle_moves_all_bodies_at_once() -> None:
    """Newton's law holds at all contacts of the row, so the other bodies move together."""
    contacts = [([-1, 1, 0], 0.0, 1.0), ([0, -1, 1], 0.0, 1.0)]
    model = chain(3, contacts=contacts)
    after = ImpactLaw(model).velocity_after(np.array([1.0, 0.0, 0.0]), (0, 1))
    # Newton's law on all three at once: gamma+ = (1, 0), momentum kept.
    np.testing.assert_allclose(after, [-1 / 3, 2 / 3, 2 / 3], atol=1e-14)


def test_masses_of_very_different_size_are_solved() -> None:
    """One contact moves a gram, the other a ton."""
    model = system(
        np.diag([1e-3, 1e3]),
        np.zeros((2, 2)),
        np.zeros((2, 2)),
        contacts=[([1, 0], 0, 0.5), ([-1, 1], 0, 0.5), ([0, 1], 0, 0.5)],
    )
    assert_law_holds(model, np.array([-1.0, -2.0]), (0, 1, 2))


def test_contacts_that_depend_on_each_other_take_no_more_than_they_need() -> None:
    """Three in a plane with unequal restitution: the jump is the least one that separates."""
    contacts = [([0, 1], 0, 0.0), ([1, 1], 0, 0.25), ([-1, -2], 0, 0.0)]
    model = system(np.eye(2), np.eye(2), np.eye(2), contacts=contacts)
    u = np.array([0.0, 1.0])
    assert_law_holds(model, u, (0, 1, 2))
    after = ImpactLaw(model).velocity_after(u, (0, 1, 2))
    np.testing.assert_allclose(after, [-0.4, 0.2], atol=1e-12)  # onto u1 + 2 u2 = 0


def test_three_contacts_that_are_tight_in_a_plane_are_solved() -> None:
    """More tight contacts than coordinates, two of them nearly opposite: the body stops."""
    model = system(
        np.eye(2) / 2,
        np.eye(2),
        np.eye(2),
        contacts=[([1, 0], 0, 0), ([-0.265625, 0.359375], 0, 0), ([1.203125, -1.640625], 0, 0)],
    )
    u = np.array([1 / 64, 0.0])
    assert_law_holds(model, u, (0, 1, 2))
    np.testing.assert_allclose(ImpactLaw(model).velocity_after(u, (0, 1, 2)), 0.0, atol=1e-9)
