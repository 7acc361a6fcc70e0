# SPDX-License-Identifier: Apache-2.0
"""Linear phases with held and fixed contacts, against an integration of the original equations."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import integrate, linalg
from systems import (
    LAPLACIAN,
    Harmonic,
    chain,
    examples,
    forcing,
    numbers,
    system,
    systems,
    vectors,
)

from impact_observer.dynamics import Phases, PositionProjection
from impact_observer.model import System

Array = NDArray[np.float64]
Contacts = tuple[int, ...]
SECONDS = 1.5


def moving(
    model: System, held: Contacts, fixed: Contacts, t: float, x: Array
) -> tuple[Array, Array]:
    """``(dq/dt, du/dt)`` and the loads, from M, C, K, W and f alone.

    ``M du/dt = -C u - K q + f + W_H lambda`` with ``W_H^T du/dt = 0``, and ``dq/dt = u - z`` with
    the ``z`` of least ``z^T K z``, then least ``z^T M z``, that has the fixed contacts' speeds.
    """
    n, W = model.n, model.W[:, list(held)]
    q, u = x[:n], x[n:]
    force = model.forcing(t) - model.C @ u - model.K @ q
    G = W.T @ np.linalg.solve(model.M, W)
    loads = -np.linalg.solve(G, W.T @ np.linalg.solve(model.M, force))
    slip = np.zeros(n)
    if fixed:
        seen = model.W[:, list(fixed)].T
        slip = np.linalg.lstsq(seen, seen @ u, rcond=1e-10)[0]
        free = linalg.null_space(seen, rcond=1e-10)
        for form in (model.K, model.M):
            if free.shape[1]:
                scale = 1e-10 * np.trace(form) + 1e-300
                values, shapes = linalg.eigh(free.T @ form @ free)
                stiff = values > scale
                along = free @ shapes[:, stiff] / np.sqrt(values[stiff])
                slip = slip - along @ (along.T @ (form @ slip))
                free = free @ shapes[:, ~stiff]
    return np.concatenate([u - slip, np.linalg.solve(model.M, force + W @ loads)]), loads


def integrated(model: System, phase: tuple[Contacts, Contacts], t: float, x: Array) -> Array:
    """The state after ``SECONDS`` by an explicit Runge-Kutta method of order 8."""
    found = integrate.solve_ivp(
        lambda s, y: moving(model, *phase, t + s, y)[0],
        (0.0, SECONDS),
        x,
        method="DOP853",
        rtol=1e-11,
        atol=1e-12,
    )
    assert found.success
    return np.asarray(found.y[:, -1])


def on(model: System, held: Contacts, fixed: Contacts, x: Array) -> Array:
    """The state with ``gamma = 0`` on the held and ``g = 0`` on the fixed contacts."""
    W, n = model.W[:, list(held)], model.n
    push = np.linalg.solve(model.M, W)
    velocity = x[n:] - push @ np.linalg.solve(W.T @ push, W.T @ x[n:])
    return np.concatenate([PositionProjection(model).position_after(x[:n], fixed), velocity])


def assert_is_the_integrated_one(
    model: System, held: Contacts, fixed: Contacts, t: float, x: Array
) -> None:
    """States at the end, speeds, gaps and loads."""
    n, x = model.n, on(model, held, fixed, x)
    phase = Phases(model).phase(held, fixed)
    motion = phase.start(t, x)
    states = motion.states(np.linspace(0.0, SECONDS, 7))
    size = 1 + np.max(np.abs(states))
    np.testing.assert_allclose(states[0], x, atol=1e-12 * size)
    expected = integrated(model, (held, fixed), t, x)
    np.testing.assert_allclose(states[-1], expected, atol=3e-9 * size)
    q, u = states[:, :n], states[:, n:]
    assert np.max(np.abs(u @ model.W[:, list(held)]), initial=0.0) <= 1e-12 * size
    kept = list({*held, *fixed})
    gaps = (q @ model.W + model.q_r)[:, kept]
    assert np.max(np.abs(gaps - gaps[0]), initial=0.0) <= 1e-11 * size
    for s, at in ((0.0, x), (SECONDS, states[-1])):
        pull = model.forcing(t + s) - model.C @ at[n:] - model.K @ at[:n]
        stated = moving(model, held, fixed, t + s, at)[1]
        most = size + np.max(np.abs(stated), initial=0)
        np.testing.assert_allclose(-phase.loads @ pull, stated, atol=1e-8 * most)


def independent(model: System, contacts: list[int]) -> Contacts:
    """Those of ``contacts`` clearly outside the span of others before them."""
    chosen: list[int] = []
    for i in contacts:
        W = model.W[:, [*chosen, i]]
        if (
            np.linalg.svd(W / np.linalg.norm(W, axis=0), compute_uv=False)[-1] > 0.05
            and len(chosen) < model.n
        ):
            chosen.append(i)
    return tuple(chosen)


def drawn(data: st.DataObject, model: System, *, fix: bool) -> tuple[Contacts, Contacts]:
    """Independent held contacts, and fixed ones with them, redundant or clearly independent."""
    chosen = sorted(data.draw(st.sets(st.integers(0, model.m - 1), min_size=1)))
    some = [i for i in chosen if data.draw(st.booleans())]
    held = independent(model, some) if some else ()
    if not fix:
        return held, ()
    fixed = tuple(chosen)
    W = model.W[:, chosen]
    values = np.linalg.svd(W / np.linalg.norm(W, axis=0), compute_uv=False)
    assume(not np.any((values > 1e-9) & (values < 0.05)))  # the integrator wants plain cases
    return held, fixed


@pytest.mark.slow
@pytest.mark.parametrize("fix", [False, True], ids=["held", "fixed"])
@pytest.mark.parametrize("rigid", [False, True], ids=["elastic", "rigid"])
@examples(6)
@given(st.data())
def test_phase_is_the_integrated_one(fix: bool, rigid: bool, data: st.DataObject) -> None:
    """Any contacts held, others slipping, K singular or not, damped, gyroscopic and forced."""
    model = data.draw(systems(contacts=(1, 4), rigid=rigid))
    held, fixed = drawn(data, model, fix=fix)
    x = np.concatenate([data.draw(vectors(model.n)), data.draw(vectors(model.n))])
    assert_is_the_integrated_one(model, held, fixed, data.draw(numbers(0, 4)), x)


PUSHED = forcing(3, [1, -2, 0.5], [Harmonic(2.3, [3, 0, 1], [0, 1, 2])])
SKEW = np.array([[0.2, 2.0, 0], [-2, 0.1, 1], [0, -1, 0.3]])
CONTACTS = [([1, 0, 0], 0.25, 0.5), ([-1, 1, 0], 0.5, 0.5), ([0, 0, -1], 0.75, 0.5)]


@pytest.mark.parametrize(
    "K",
    [
        np.zeros((3, 3)),
        pytest.param(5 * LAPLACIAN, marks=pytest.mark.slow),
        5 * LAPLACIAN + np.eye(3),
    ],
)
@pytest.mark.parametrize(
    "held", [(), (0,), (1, 2), pytest.param((2, 1), marks=pytest.mark.slow), (0, 1, 2)]
)
@pytest.mark.parametrize("fixed", [(), (0, 1, 2)])
def test_every_number_of_held_contacts_is_integrated(
    K: Array, held: Contacts, fixed: Contacts
) -> None:
    """None, some in any order, and all, where nothing is free; no stiffness at all as well."""
    model = system(np.diag([1.0, 2, 3]), SKEW, K, contacts=CONTACTS, force=PUSHED)
    x = np.array([0.3, -0.2, 0.6, 1.0, -1.5, 0.5])
    assert_is_the_integrated_one(model, held, fixed, 0.7, x)


@pytest.mark.parametrize(
    "held", [*(pytest.param(each, marks=pytest.mark.slow) for each in ((), (0,))), (1,)]
)
def test_fixed_contacts_may_be_redundant(held: Contacts) -> None:
    """Floor, ceiling and the floor in other units: all their gaps stay."""
    floor = ([1, 0, 0], 0.25, 0.5)
    contacts = [floor, ([-1, 0, 0], -0.25, 0.5), ([2, 0, 0], 0.5, 0.5)]
    for K in (np.zeros((3, 3)), 5 * LAPLACIAN, 5 * LAPLACIAN + np.eye(3)):
        model = system(np.eye(3), SKEW, K, contacts=contacts, force=PUSHED)
        x = np.array([0.3, -0.2, 0.6, 1.0, -1.5, 0.5])
        assert_is_the_integrated_one(model, held, (0, 1, 2), 0.0, x)


def test_held_contact_away_from_its_stop_stays_where_it_is() -> None:
    """A mass held 2 m above its floor in mid-air, its spring stretched: nothing moves."""
    model = system(1, 0.3, 4, contacts=[([1], 0.5, 0.5)], force=forcing(1, -9.81))
    phase = Phases(model).phase((0,))
    motion = phase.start(0.0, np.array([2.0, 0.0]))
    states = motion.states(np.array([0.0, 1.0, 1e4]))
    np.testing.assert_allclose(states, [[2.0, 0.0]] * 3, rtol=1e-15)


def test_contact_that_sees_no_rigid_mode_is_held_where_it_is() -> None:
    """Modes that are zero up to rounding in what a contact sees move nothing."""
    M = [[5.5, -2, 2, 1, 1], [-2, 4.5, 0, 2, -3], [2, 0, 2.5, 0, -1], [1, 2, 0, 5.5, -1]]
    model = system(
        [*M, [1, -3, -1, -1, 3.5]],
        np.zeros((5, 5)),
        np.diag([0.0, 3, 3, 3, 0]),
        contacts=[([0, 1, 0, -1, 0], 0.0, 0.5)],
    )
    x = np.arange(10.0) / 8
    for fixed in ((), (0,)):
        assert_is_the_integrated_one(model, (0,), fixed, 0.0, x)
        assert_is_the_integrated_one(model, (), fixed, 0.0, x)


@pytest.mark.slow
@examples(24)
@given(st.data())
def test_distance_of_two_motions_of_one_phase_never_grows(data: st.DataObject) -> None:
    """``1/2 du^T M du + 1/2 dq^T K dq`` falls while the same contacts are held and fixed."""
    model = data.draw(systems(contacts=(1, 4)))
    held, fixed = drawn(data, model, fix=data.draw(st.booleans()))
    phase = Phases(model).phase(held, fixed)
    s = np.linspace(0.0, 4.0, 33)
    runs = []
    for _ in range(2):
        x = np.concatenate([data.draw(vectors(model.n)), data.draw(vectors(model.n))])
        runs.append(phase.start(0.5, on(model, held, fixed, x)).states(s))
    q, u = np.split(runs[0] - runs[1], 2, axis=1)
    V = (np.einsum("si,si->s", u @ model.M, u) + np.einsum("si,si->s", q @ model.K, q)) / 2
    size = max(float(np.max(np.abs(run))) for run in runs)
    assert np.max(np.diff(V)) <= 1e-10 * (1 + V[0]) + 1e-12 * size**2


def test_contacts_with_the_direction_of_others_are_not_independent() -> None:
    """The first of a kind stays; a bar on three supports needs two."""
    bar = chain(
        2, contacts=[([1, -1], 0, 0.5), ([1, 0], 0, 0.5), ([1, 1], 0, 0.5), ([-3, 3], 0, 0)]
    )
    independent_of = Phases(bar).independent
    assert independent_of((0, 1, 2, 3)) == (0, 1)
    assert independent_of((2, 3, 0)) == (2, 3)
    assert independent_of((0, 3)) == (0,)
    assert independent_of(()) == ()


def test_stopped_state_is_the_nearest_in_energy() -> None:
    """``u^T M u`` of the change is least: it is a push of the contacts alone, once for all."""
    contacts = [([1, -1], 0.25, 0.5), ([1, 0], 0.25, 0.5), ([1, 1], 0.25, 0.5)]
    model = chain(2, contacts=contacts[:1])
    x = np.array([0.3, -0.4, 1.0, 0.5])
    after = Phases(model).stopped(x, (0,))
    np.testing.assert_allclose(after[2:], [0.75, 0.75], atol=1e-15)
    np.testing.assert_allclose(model.gap(after[:2]), 0.0, atol=1e-15)
    redundant = Phases(chain(2, contacts=[contacts[1], contacts[1], contacts[1]]))
    np.testing.assert_allclose(redundant.stopped(x, (0, 1, 2))[2:], [0.0, 0.5], atol=1e-15)
