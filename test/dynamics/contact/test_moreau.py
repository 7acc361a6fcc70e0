# SPDX-License-Identifier: Apache-2.0
"""The time-stepping scheme against 90 digits, its balance of energy and brute force."""

from itertools import chain as concatenated
from itertools import combinations

import numpy as np
import precise
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from systems import Harmonic, chain, examples, forcing, system, systems, vectors

from impact_observer.dynamics.contact.moreau import MoreauScheme, TimeStep
from impact_observer.errors import ImpactLawError
from impact_observer.model import System

Array = NDArray[np.float64]


def walk(
    scheme: MoreauScheme, q: Array, u: Array, count: int
) -> list[tuple[Array, Array, TimeStep]]:
    """``count`` steps: coordinates and velocities at the start of each, and what it did."""
    found = []
    for k in range(count):
        step = scheme.step(k, q, u)
        found.append((q, u, step))
        q, u = step.q, step.u
    return found


def energy(model: System, q: Array, u: Array) -> float:
    """Kinetic and elastic."""
    return float(u @ model.M @ u + q @ model.K @ q) / 2


def started(data: st.DataObject, model: System) -> tuple[Array, Array]:
    """A state that is inside no stop."""
    q, u = data.draw(vectors(model.n, -0.5, 0.5)), data.draw(vectors(model.n))
    assume(not model.penetrated(q))
    return q, u


def steps() -> st.SearchStrategy[float]:
    """Lengths of steps from fine to far too long, s."""
    return st.sampled_from([1 / 1024, 1 / 64, 1 / 8, 1.0])


def test_motion_without_contact_is_of_second_order() -> None:
    """Damped, gyroscopic and forced: the error falls with the square of the step."""
    harmonics = [Harmonic(2.0, [1, 0, 0], [0, 0, 2]), Harmonic(5.0, [0, 3, 0], [0, 0, 0])]
    gyroscopic = np.array([[0, 1, 0], [-1, 0, 2], [0, -2, 0]])
    plain = chain(3, damping=0.3, force=forcing(3, [1, -2, 0.5], harmonics))
    model = system(plain.M, plain.C + gyroscopic, plain.K, force=plain.forcing)
    x, seconds = np.array([0.1, -0.2, 0.3, 1.0, 0.5, -1.0]), 2.0
    exact = precise.flow(model, 0.0, x, [seconds])[0]
    counts = np.array([100, 200, 400, 800])
    errors = []
    for count in counts:
        _, _, last = walk(MoreauScheme(model, seconds / count), x[:3], x[3:], count)[-1]
        errors.append(np.linalg.norm(np.concatenate([last.q, last.u]) - exact))
    order = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert order == pytest.approx(2.0, abs=0.1)
    assert errors[-1] < 1e-3


@pytest.mark.slow
@examples(20)
@given(st.data())
def test_every_step_balances_energy(data: st.DataObject) -> None:
    """Damping, forcing and impulses do their work with the mean speeds, whatever the step."""
    model = data.draw(systems(common_restitution=True))
    scheme = MoreauScheme(model, data.draw(steps()))
    h = scheme.h
    for k, (q, u, step) in enumerate(walk(scheme, *started(data, model), 20)):
        mean, force = (u + step.u) / 2, (model.forcing(k * h) + model.forcing((k + 1) * h)) / 2
        work = h * mean @ (force - model.C @ mean) + model.contact_speed(mean) @ step.impulses
        sizes = energy(model, q, u) + energy(model, step.q, step.u) + h * abs(mean) @ abs(force)
        change = energy(model, step.q, step.u) - energy(model, q, u)
        assert change == pytest.approx(work, abs=1e-9 * (1 + float(sizes)))


@examples(20)
@given(st.data())
def test_energy_grows_only_where_a_load_brings_a_contact_back_within_a_step(
    data: st.DataObject,
) -> None:
    """Unforced, equal restitution: elsewhere it never grows; where eps is 1, nowhere."""
    model = data.draw(systems(common_restitution=True, forced=False))
    scheme, eps = MoreauScheme(model, data.draw(steps())), model.eps[0]
    for q, u, step in walk(scheme, *started(data, model), 30):
        back = np.maximum(model.contact_speed(u), 0.0) @ step.impulses
        before, after = energy(model, q, u), energy(model, step.q, step.u)
        assert after <= before + (1 - eps) / 2 * back + 1e-9 * (1 + before)


def test_energy_is_conserved_without_damping_and_with_full_restitution() -> None:
    """Thousands of steps of a chain between two walls, to the last digits but three."""
    contacts = [([1, 0, 0], 0.2, 1.0), ([0, 0, -1], 0.3, 1.0), ([0, -1, 1], 0.1, 1.0)]
    model = chain(3, damping=0.0, contacts=contacts)
    found = walk(
        MoreauScheme(model, 0.01), np.array([0.0, 0.1, 0.05]), np.array([2.0, -3.0, 1.0]), 2000
    )
    assert sum(bool(step.closed) for _, _, step in found) > 50
    total = [energy(model, q, u) for q, u, _ in found]
    np.testing.assert_allclose(total, total[0], rtol=1e-12)


@pytest.mark.slow
@examples(30)
@given(st.data())
def test_every_step_is_complementary(data: st.DataObject) -> None:
    """The impulses push, only on active contacts, and only those with the least speed allowed."""
    model = data.draw(systems(common_restitution=True, contacts=(1, 4)))
    scheme = MoreauScheme(model, data.draw(steps()))
    h = scheme.h
    for k, (q, u, step) in enumerate(walk(scheme, *started(data, model), 20)):
        gamma = model.contact_speed(u)
        predicted, spare = (
            model.gap(q) + h / 2 * gamma,
            model.contact_speed(step.u) + model.eps * gamma,
        )
        speed = abs(model.W).T @ (1 + abs(u) + abs(step.free))
        distance = abs(model.q_r) + abs(model.W).T @ abs(q) + h * speed
        assert np.all(step.impulses >= 0)
        assert np.all(step.impulses[predicted > 1e-5 * distance] == 0)
        assert np.all(spare[predicted <= 0] >= -1e-8 * speed[predicted <= 0])
        assert np.all(np.abs(spare[step.impulses > 0]) <= 1e-8 * speed[step.impulses > 0])
        assert set(np.flatnonzero(step.impulses)) <= set(step.closed)
        mean, force = (u + step.u) / 2, (model.forcing(k * h) + model.forcing((k + 1) * h)) / 2
        middle = q + h / 2 * mean
        left = model.M @ (step.u - u) + h * (model.C @ mean + model.K @ middle - force)
        size = np.linalg.norm(left) + np.linalg.norm(model.W) * np.linalg.norm(step.impulses)
        loads = [h * abs(matrix).sum() * 10 for matrix in (model.C, model.K)]
        scale = 1 + size + sum(loads) * (np.linalg.norm(mean) + np.linalg.norm(middle))
        np.testing.assert_allclose(left, model.W @ step.impulses, atol=1e-9 * scale)


def by_brute_force(A: Array, b: Array) -> Array:
    """The solution of ``0 <= A P + b _|_ P >= 0`` from all sets of contacts, ``A`` definite."""
    m = b.size
    for pressed in map(
        list, concatenated.from_iterable(combinations(range(m), r) for r in range(m + 1))
    ):
        P = np.zeros(m)
        P[pressed] = np.linalg.solve(A[np.ix_(pressed, pressed)], -b[pressed])
        if np.all(P >= -1e-12) and np.all(A @ P + b >= -1e-9):
            return P
    raise AssertionError("a positive definite problem has a solution")


@pytest.mark.parametrize("turning", [0.0, 0.1, 1.0, 5.0])
def test_gyroscopic_impulses_are_those_of_brute_force(turning: float) -> None:
    """However far the body turns in a step: ``A`` is then anything but symmetric."""
    random, several = np.random.default_rng(7), 0
    for _ in range(15):
        root, skew = random.normal(size=(2, 4, 4))
        M, h = root @ root.T + np.eye(4), 0.5
        skew = 2 * turning / h * (skew - skew.T)
        W = random.normal(size=(4, 3))
        model = system(M, skew, np.eye(4), contacts=[(w, 0.0, 0.5) for w in W.T])
        u = random.normal(size=4)
        u -= W @ np.linalg.solve(W.T @ W, W.T @ u + abs(random.normal(size=3)))  # all close
        step = MoreauScheme(model, h).step(0, np.zeros(4), u)
        iteration = M + h / 2 * skew + h**2 / 4 * np.eye(4)
        A = W.T @ np.linalg.solve(iteration, W)
        free = u - h * np.linalg.solve(iteration, skew @ u + h / 2 * u)
        expected = by_brute_force(A, W.T @ free + 0.5 * W.T @ u)
        np.testing.assert_allclose(step.impulses, expected, atol=1e-8 * (1 + max(expected)))
        several += int(np.count_nonzero(expected) > 1)
    assert several > 5


def test_contacts_that_depend_on_each_other_share_the_impulse() -> None:
    """A stop that is there twice is one stop."""
    once = chain(2, contacts=[([1, 0], 0.0, 0.5), ([0, 1], 0.0, 0.5)])
    twice = chain(
        2, contacts=[([1, 0], 0, 0.5), ([0, 1], 0, 0.5), ([3, 0], 0, 0.5), ([1, 1], 0, 0.5)]
    )
    q, u = np.zeros(2), np.array([-1.0, -3.0])
    one, two = (MoreauScheme(model, 0.01).step(0, q, u) for model in (once, twice))
    np.testing.assert_allclose(two.u, one.u, atol=1e-12)
    np.testing.assert_allclose(twice.W @ two.impulses, once.W @ one.impulses, rtol=1e-11)
    assert one.closed == (0, 1)
    assert two.closed == (0, 1, 2, 3)


def test_body_that_is_pressed_stays_where_it_is() -> None:
    """The impulse of each step carries the weight, and nothing moves."""
    model = system(2, 0, 0, contacts=[([1], 0.0, 0.9)], force=forcing(1, -9.81))
    found = walk(MoreauScheme(model, 1e-3), np.zeros(1), np.zeros(1), 500)
    for q, u, step in found:
        assert abs(q[0]) < 1e-15
        assert abs(u[0]) < 1e-15
        assert step.impulses[0] == pytest.approx(9.81e-3, rel=1e-12)
        assert step.closed == (0,)


def test_body_beside_its_stop_is_not_pressed() -> None:
    """It moves along the stop without a load: closed, with no impulse of rounding."""
    model = system(
        [[1, 0.3], [0.3, 1.7]], np.zeros((2, 2)), np.zeros((2, 2)), contacts=[([0.1, 0.7], 0, 0.5)]
    )
    for _, _, step in walk(MoreauScheme(model, 1e-3), np.zeros(2), np.array([-0.7, 0.1]), 100):
        assert step.closed == (0,)
        assert step.impulses[0] == 0


def test_step_without_solution_is_one_line_with_contacts_and_time() -> None:
    """A slot that the body overlaps, with unequal restitution."""
    model = system(1, 0, 0, contacts=[([1], -0.01, 0.9), ([-1], -0.01, 0.1)])
    with pytest.raises(ImpactLawError, match=r"'c1', 'c2': .* t = 0\.030000000 s .* 0\.9, 0\.1;"):
        MoreauScheme(model, 0.01).step(3, np.zeros(1), np.array([-1.0]))
