# SPDX-License-Identifier: Apache-2.0
"""Properties of a model: modes, what contacts see of them, impacts that raise V."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from numpy.typing import NDArray
from scipy import optimize
from systems import Harmonic, chain, examples, forcing, sample, state_matrix, system, systems

from impact_observer.check.model_check import ModelCheck, check_model
from impact_observer.model import System

Array = NDArray[np.float64]


def eigenvalues(checked: ModelCheck) -> Array:
    """All 2n eigenvalues of a result."""
    modes = checked.modes
    return np.array([*modes, *modes.conj(), *checked.rates, *np.zeros(len(checked.rigid))])


def test_eigenfrequencies_of_a_chain_are_the_closed_form() -> None:
    """``2 sqrt(k) sin(j pi / (2 (n + 1)))``; damping in proportion gives every ratio."""
    n, k, c = 7, 10.0, 0.1
    checked = check_model(chain(n, k, c))
    expected = 2 * np.sqrt(k) * np.sin(np.arange(1, n + 1) * np.pi / (2 * (n + 1)))
    np.testing.assert_allclose(checked.undamped, expected, rtol=1e-12)
    ratios = c / k * expected / 2
    np.testing.assert_allclose(np.abs(checked.modes), expected, rtol=1e-11)
    np.testing.assert_allclose(-checked.modes.real / expected, ratios, rtol=1e-9)
    damped = expected * np.sqrt(1 - ratios**2)
    np.testing.assert_allclose(checked.modes.imag, damped, rtol=1e-11)
    assert checked.damped
    assert checked.rigid.shape == (0, n)


@pytest.mark.slow
@examples(40)
@given(systems(forced=False))
def test_eigenvalues_are_those_of_the_state_matrix(model: System) -> None:
    """Coupled damping, gyroscopic forces and rigid bodies included: 2n of them, same polynomial.

    Double eigenvalues have only half the digits, so coefficients are compared.
    """
    found = eigenvalues(check_model(model))
    assert found.size == 2 * model.n
    matrix = state_matrix(model)
    scale = max(1.0, float(np.max(np.abs(found))))
    expected = np.poly(matrix / scale)
    np.testing.assert_allclose(np.poly(found / scale), expected, atol=1e-8 * 2**model.n)


def test_overdamped_pairs_are_real() -> None:
    """``s^2 + 5 s + 4`` beside an oscillation."""
    checked = check_model(system(np.eye(2), np.diag([5, 0.2]), np.diag([4, 9])))
    np.testing.assert_allclose(checked.rates, [-4, -1], rtol=1e-13)
    (mode,) = checked.modes
    assert abs(mode) == pytest.approx(3, rel=1e-13)
    assert -mode.real / abs(mode) == pytest.approx(0.1 / 3, rel=1e-12)


def test_a_free_chain_has_one_rigid_mode_with_equal_displacements() -> None:
    """Without a damper on the ground the chain's rigid motion does not decay."""
    laplacian = np.diag([1.0, 2, 1]) - np.eye(3, k=1) - np.eye(3, k=-1)
    model = system(np.diag([1.0, 2, 3]), laplacian, laplacian, contacts=[([1, -1, 0], 0.1, 0.5)])
    checked = check_model(model)
    np.testing.assert_allclose(checked.rigid, [[1, 1, 1]], rtol=1e-12)
    assert checked.undamped[0] == 0
    assert checked.rates.tolist() == [0]
    assert not checked.damped
    (unseen,) = checked.unseen  # the contact is between bodies
    assert unseen.eigenvalue == 0
    np.testing.assert_allclose(unseen.shape, [1, 1, 1], rtol=1e-12)


def test_a_damper_on_the_ground_damps_a_rigid_body() -> None:
    """The body's velocity decays at c/m; no V contains its displacement."""
    checked = check_model(system(2, 3, 0, contacts=[([1], 0.0, 0.5)]))
    assert checked.rates == pytest.approx([-1.5], rel=1e-14)
    assert len(checked.rigid) == 1
    assert checked.damped
    assert checked.unseen == ()


def test_the_ball_is_one_free_rigid_body() -> None:
    """The smallest system: one zero eigenvalue for its height, one for its speed."""
    checked = check_model(sample("bouncing_ball").system)
    assert checked.rigid.tolist() == [[1.0]]
    assert (checked.modes.tolist(), checked.rates.tolist()) == ([], [0.0])


def test_undamped_modes_are_exactly_that() -> None:
    """The middle of a chain does not move in its second mode: a damper there misses it."""
    laplacian = 2 * np.eye(3) - np.eye(3, k=1) - np.eye(3, k=-1)
    checked = check_model(system(np.eye(3), np.diag([0, 0.3, 0]), 10 * laplacian))
    decays = checked.modes.real
    assert decays[1] == 0
    assert decays[0] < 0
    assert decays[2] < 0
    assert checked.modes[1].imag == pytest.approx(np.sqrt(20), rel=1e-12)


def test_a_contact_at_a_node_does_not_see_the_mode() -> None:
    """The second mode of three masses, from the middle one."""
    (unseen,) = check_model(chain(3, contacts=[([0, 1, 0], 0.1, 0.5)])).unseen
    assert unseen.eigenvalue.imag == pytest.approx(np.sqrt(20 - 0.1**2), rel=1e-12)
    assert unseen.eigenvalue.real == pytest.approx(-0.1, rel=1e-10)
    np.testing.assert_allclose(np.abs(unseen.shape), [1, 0, 1], atol=1e-12)
    assert unseen.shape[0] * unseen.shape[2] < 0
    assert check_model(chain(3, contacts=[([1, 0, 0], 0.1, 0.5)])).unseen == ()


def test_equal_oscillators_need_a_contact_each() -> None:
    """A contact at the sum of the positions does not see their difference."""
    one = check_model(system(np.eye(2), np.eye(2) / 9, np.eye(2), contacts=[([1, 1], 0, 1)]))
    assert len(one.unseen) == 1
    assert one.unseen[0].shape.sum() == pytest.approx(0, abs=1e-12)
    both = [([1, 1], 0, 1), ([1, 0], 0, 1)]
    assert not check_model(system(np.eye(2), np.eye(2) / 9, np.eye(2), contacts=both)).unseen


@pytest.mark.slow
@examples(40)
@given(systems(forced=False, contacts=(1, 2)))
def test_unobservable_motions_are_those_of_the_observability_matrix(model: System) -> None:
    """Rank of the rows ``W^T A^k``, for gaps and speeds; a pair counts two, a rigid one too."""
    A = state_matrix(model)
    A /= max(1.0, float(np.linalg.norm(A, 2)))
    rows = [np.kron(np.eye(2), (model.W / np.linalg.norm(model.W, axis=0)).T)]
    for _ in range(2 * model.n - 1):
        rows.append(rows[-1] @ A)
    singular = np.linalg.svd(np.vstack(rows), compute_uv=False)
    hidden = check_model(model).unseen
    if not np.any((singular > 1e-13) & (singular < 1e-7)):  # the oracle is unambiguous
        assert bool(hidden) == bool(np.any(singular <= 1e-13))
    for each in hidden:
        assert np.linalg.norm(model.W.T @ each.shape) <= 1e-7 * np.linalg.norm(model.W)


def test_effective_mass_is_that_of_the_contact_direction() -> None:
    """``1 / (w^T M^-1 w)``: a body's own mass, and the reduced mass of two."""
    contacts = [([1, 0], 0.0, 0.5), ([-1, 1], 0.0, 0.5), ([0, 2], 0.0, 0.5)]
    model = system(np.diag([2, 3]), np.eye(2), np.eye(2), contacts=contacts)
    found = check_model(model).effective_mass
    np.testing.assert_allclose(found, [2, 6 / 5, 3 / 4], rtol=1e-14)


def test_a_system_without_contacts_hides_every_mode() -> None:
    """No impact can raise V of a system without contacts."""
    checked = check_model(chain(3))
    assert len(checked.unseen) == 3
    assert checked.nonexpansive is True
    assert checked.effective_mass.size == 0


def corner(*eps: float, gap: float = 0.0) -> System:
    """The documented counterexample: two contacts that are not orthogonal."""
    contacts = [([1.0, 0.0], gap, eps[0]), ([0.9, 0.436], gap, eps[1])]
    return system(np.eye(2), np.eye(2), np.eye(2), contacts=contacts)


def test_a_corner_with_unequal_restitution_raises_v_by_its_factor() -> None:
    """For restitutions 1 and 0 the factor is ``|w_2|^2 / det(w_1, w_2)^2``."""
    checked = check_model(corner(1.0, 0.0))
    (growth,) = checked.growths
    assert growth.contacts == (0, 1)
    assert growth.factor == pytest.approx(1.000096 / 0.436**2, rel=1e-9)
    assert checked.nonexpansive is False
    assert check_model(corner(0.5, 0.5)).nonexpansive is True


def test_stops_that_cannot_close_together_raise_no_v() -> None:
    """Two walls on both sides of a body, and a corner whose second wall is behind the first."""
    two_sided = [([1.0, 0.0], 0.1, 1.0), ([-1.0, 0.3], 0.1, 0.0), ([1.0, 0.0], 0.2, 0.0)]
    walls = system(np.eye(2), np.eye(2), np.eye(2), contacts=[*two_sided, ([0, -1.0], 0.1, 0.3)])
    assert check_model(walls).nonexpansive is False  # two of them meet far away
    room = [([1.0, 0.0], 0.1, 1.0), ([-1.0, 0.0], 0.1, 0.0), ([1.0, 0.0], 0.2, 0.3)]
    checked = check_model(system(np.eye(2), np.eye(2), np.eye(2), contacts=room))
    assert (checked.nonexpansive, checked.growths) == (True, ())


@pytest.mark.slow
@examples(100)
@given(systems(forced=False, contacts=(2, 4)))
def test_impacts_of_models_that_pass_never_raise_v(model: System) -> None:
    """``G - E G E`` of every pair that a linear programme of equations lets close."""
    W = model.W / np.sqrt(np.sum(model.W * np.linalg.solve(model.M, model.W), axis=0))
    G = W.T @ np.linalg.solve(model.M, W)
    H = (1 - np.outer(model.eps, model.eps)) * G
    failing = []
    for i, j in combinations(range(model.m), 2):
        if abs(G[i, j]) > 1 - 1e-6:  # of parallel contacts an impact has one only
            continue
        found = optimize.linprog(
            np.zeros(model.n),
            A_ub=-model.W.T,
            b_ub=model.q_r,
            A_eq=model.W[:, [i, j]].T,
            b_eq=-model.q_r[[i, j]],
            bounds=(None, None),
        )
        if found.status == 0 and np.linalg.eigvalsh(H[np.ix_((i, j), (i, j))])[0] < -1e-7:
            failing.append((i, j))
    checked = check_model(model)
    assert {*failing} <= {each.contacts for each in checked.growths}
    assert checked.nonexpansive is not True or not failing


def test_amplitudes_are_those_of_the_forced_motion() -> None:
    """4 N at 2.5 rad/s move 1 kg on 10 N/m by 4/|10 - 6.25 + 0.25i|; 5 N by half a metre."""
    force = forcing(1, 5.0, [Harmonic(2.5, [4], [0])])
    model = system(1, 0.1, 10, contacts=[([-1], 1.0, 0.5)], force=force)
    checked = check_model(model)
    assert checked.rest == pytest.approx([0.5])
    assert checked.swing == pytest.approx([4 / abs(3.75 + 0.25j)])
    still = system(1, 0.0, 6.25, contacts=[([-1], 1.0, 0.5)], force=force)
    assert check_model(still).swing.tolist() == [np.inf]
