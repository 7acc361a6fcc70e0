# SPDX-License-Identifier: Apache-2.0
"""Expansions of guards and jumps as functions of the state and of the instant."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import linalg
from systems import Harmonic, chain, examples, forcing, system, systems, vectors

from impact_observer.dynamics import ImpactLaw, Phase, Phases
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.impact_filter import ImpactFilter
from impact_observer.filter.joint import Joint
from impact_observer.filter.saltation import Measured, Mirror, StateRates
from impact_observer.model import System, parse_model
from impact_observer.model.free_parameters import impulses_aside
from impact_observer.model.parametric_family import Coefficients, ParametricFamily

Array = NDArray[np.float64]
FORCED = chain(
    3,
    damping=0.4,
    contacts=[([1, 0, 0], 0.2, 0.6), ([0, 1, -1], 0.3, 0.8), ([0, 0, -1], 0.1, 0.5)],
    force=forcing(3, [0.5, 0, -1], [Harmonic(2.3, [1.0, 0, 2], [0, 1.5, 0])]),
)
T = 0.7


Jumped = Callable[[float, Array], Array]


def forces(model: System, t: float) -> Array:
    """The force and two derivatives of it."""
    return np.asarray(model.forcing.derivatives(np.array([t]), 2)[:, 0])


def differences(f: Callable[[float], Array], h: float = 1e-3) -> tuple[Array, Array]:
    """First and second derivative at 0, of sixth order."""
    first = sum(c * (f(k * h) - f(-k * h)) for k, c in ((1, 3 / 4), (2, -3 / 20), (3, 1 / 60)))
    second = sum(
        c * (f(k * h) - 2 * f(0.0) + f(-k * h)) for k, c in ((1, 3 / 2), (2, -3 / 20), (3, 1 / 90))
    )
    return np.asarray(first / h), np.asarray(second / h**2)


def jump(
    before: tuple[int, ...], after: tuple[int, ...], pressed: tuple[int, ...]
) -> tuple[Phase, Mirror, StateRates, Jumped]:
    """The phase before a jump, the jump, the rates after it, and its map: back, jump, and on.

    Contacts that stay closed have no restitution here, so that they are held at once.
    """
    phases = Phases(FORCED)
    one, two = phases.phase(before), phases.phase(after)
    eps = np.where(np.isin(range(FORCED.m), after), 0.0, FORCED.eps)
    mirror = Mirror.of(FORCED, ImpactLaw(FORCED, eps).jump(pressed), pressed)

    def jumped(e: float, y: Array) -> Array:
        x = mirror.J @ one.moved(T, y, -e)[0] + mirror.offset
        return two.moved(T - e, x, e)[0] if e else x

    return one, mirror, StateRates(two), jumped


@pytest.mark.parametrize(
    ("before", "after", "pressed"),
    [((), (), (0,)), ((), (0,), (0,)), ((1,), (1,), (1, 2)), ((0,), (), ()), ((), (), (0, 1, 2))],
)
def test_jump_is_expanded_as_its_exact_map(
    before: tuple[int, ...], after: tuple[int, ...], pressed: tuple[int, ...]
) -> None:
    """Back by the phase before, jump, on by the phase after: against finite differences."""
    one, mirror, after_jump, jumped = jump(before, after, pressed)
    n = FORCED.n
    y = np.random.default_rng(6).normal(size=2 * n)
    y[n:] = one.inverse @ FORCED.M @ y[n:]
    found = mirror.expanded(StateRates(one), after_jump, y, forces(FORCED, T))
    np.testing.assert_allclose(found.value, jumped(0.0, y), atol=1e-14)
    first, second = differences(lambda e: jumped(e, y))
    np.testing.assert_allclose(found.H[:, 0], first, atol=1e-8)
    np.testing.assert_allclose(found.E, second, atol=1e-5)
    for dy in np.eye(2 * n):
        dy[n:] = one.inverse @ FORCED.M @ dy[n:]
        mixed = differences(lambda e, dy=dy: jumped(e, y + dy) - jumped(e, y))[0]  # type: ignore[misc]
        np.testing.assert_allclose(found.D @ dy, mixed, atol=1e-8)
    np.testing.assert_allclose(found.H[:, 1:], mirror.J, atol=0)
    np.testing.assert_allclose(found.H[:n, 0], 0, atol=1e-14)  # positions do not notice


@pytest.mark.slow
@examples(8)
@given(st.data())
def test_jump_at_the_own_root_is_the_saltation_matrix(data: st.DataObject) -> None:
    """With ``e = g / gamma`` in it, ``Xi = J + (f+ - J f-) grad g^T / gamma``, and exactly so.

    The oracle finds the root of the gap and jumps there, positions unchanged.
    """
    model = data.draw(systems(max_n=3, contacts=(1, 1)))
    phases, n, law = Phases(model), model.n, ImpactLaw(model)
    w = model.W[:, 0]
    x = data.draw(vectors(2 * n))
    x[:n] -= w * (w @ x[:n] + model.q_r[0]) / (w @ w)
    x[n:] -= w * (w @ x[n:] + 2.0) / (w @ w)  # it closes with 2 m/s
    phase = phases.phase()
    rates = StateRates(phase)

    def own_root(y: Array) -> Array:
        e, at = 0.0, y
        for _ in range(6):
            at = phase.moved(T, y, -e)[0]
            e += (w @ at[:n] + model.q_r[0]) / (w @ at[n:])
        at[n:] = law.velocity_after(at[n:], (0,))
        return phase.moved(T - e, at, e)[0]

    mirror = Mirror.of(model, law.jump((0,)), (0,))
    expansion = mirror.expanded(rates, rates, x, forces(model, T))
    grad = np.concatenate([w, np.zeros(n)])
    Xi = expansion.H[:, 1:] + np.outer(expansion.H[:, 0], grad) / (w @ x[n:])
    ending = rates.along(x, forces(model, T))[0]
    J = linalg.block_diag(np.eye(n), law.jump((0,)))
    beginning = rates.along(np.asarray(J @ x), forces(model, T))[0]
    textbook = J + np.outer(beginning - J @ ending, grad) / (w @ x[n:])
    size = 1 + np.max(np.abs(textbook))
    np.testing.assert_allclose(Xi, textbook, atol=1e-12 * size)
    assume(size < 50)
    for dx in np.eye(2 * n):
        found = differences(lambda h, dx=dx: own_root(x + h * dx), h=1e-4)[0]  # type: ignore[misc]
        np.testing.assert_allclose(Xi @ dx, found, atol=1e-7 * size)


def test_gaps_and_loads_are_expanded_as_they_are() -> None:
    """Values, slopes and curvatures in the instant, and their change with the state."""
    phases, n = Phases(FORCED), FORCED.n
    for held, contacts in (((), (0, 2)), ((0,), (0,)), ((0, 1), (1,))):
        phase = phases.phase(held)
        y = np.random.default_rng(7).normal(size=2 * n)
        y[n:] = phase.inverse @ FORCED.M @ y[n:]

        def watched(e: float, y: Array, phase: Phase = phase, which: tuple[int, ...] = contacts):  # type: ignore[no-untyped-def]  # noqa: ANN202
            x = phase.moved(T, y, -e)[0]
            if not phase.held:
                return FORCED.gap(x[:n])[list(which)]
            load = FORCED.forcing(T - e) - FORCED.C @ x[n:] - FORCED.K @ x[:n]
            W = FORCED.W[:, list(phase.held)]
            push = np.linalg.solve(FORCED.M, np.column_stack([W, load]))
            found = -np.linalg.solve(W.T @ push[:, :-1], W.T @ push[:, -1])
            return found[[phase.held.index(i) for i in which]]

        measured = Measured.loads(phase, contacts) if held else Measured.gaps(FORCED, contacts)
        found = measured.expanded(StateRates(phase), y, forces(FORCED, T))
        first, second = differences(lambda e: watched(e, y))  # noqa: B023
        np.testing.assert_allclose(found.value, watched(0.0, y), atol=1e-13)
        np.testing.assert_allclose(found.H[:, 0], first, atol=1e-8)
        np.testing.assert_allclose(found.E, second, atol=1e-5)
        for dy in np.eye(2 * n):
            dy[n:] = phase.inverse @ FORCED.M @ dy[n:]
            mixed = differences(lambda e, dy=dy: watched(e, y + dy) - watched(e, y))[0]  # type: ignore[misc]  # noqa: B023
            np.testing.assert_allclose(found.D @ dy, mixed, atol=1e-8)
            moved = watched(0.0, y + dy) - watched(0.0, y)
            np.testing.assert_allclose(found.H[:, 1:] @ dy, moved, atol=1e-12)


def test_fastest_fading_is_the_spectrum_s() -> None:
    """By hand: ``x'' + 5 x' + 4 x`` fades with 1 and 4, an undamped one not at all."""
    assert StateRates(Phases(system(1, 5, 4)).phase()).decay == pytest.approx(4.0)
    assert StateRates(Phases(system(1, 0, 4)).phase()).decay == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("held", [(), (0,)])
def test_way_back_over_a_nanosecond_loses_no_digits(held: tuple[int, ...]) -> None:
    """``x - s dx/dt`` to rounding; and there and back again is the same state."""
    phase = Phases(FORCED).phase(held)
    x = np.random.default_rng(8).normal(size=6)
    x[3:] = phase.inverse @ FORCED.M @ x[3:]
    back = phase.moved(T, x, -1e-9)[0]
    rate = StateRates(phase).along(x, FORCED.forcing.derivatives(np.array([T]), 1)[:, 0])[0]
    np.testing.assert_allclose(back, x - 1e-9 * rate, rtol=0, atol=2e-15)
    for s in (1e-9, 1e-3, 0.5):
        there = phase.moved(T, x, -s)[0]
        np.testing.assert_allclose(phase.moved(T - s, there, s)[0], x, rtol=0, atol=1e-13)


def test_velocities_jump_in_the_middle_of_an_impact_that_lasts() -> None:
    """Two free bodies, which move with the speeds before until then."""
    n, w = 2, np.array([-1.0, 1.0])
    for eps, lasts in ((1.0, 0.01), (0.5, 0.02)):
        model = replace(chain(n, contacts=[(w, 0.2, eps)]), K=np.zeros((n, n)), C=np.zeros((n, n)))
        k = np.linalg.solve(model.M, w) / (w @ np.linalg.solve(model.M, w))
        numbers = replace(Coefficients.of_system(model), contact_time=np.array([lasts]))
        mirror = Mirror.of(model, ImpactLaw(model).jump((0,)), (0,), numbers)
        q, u = np.array([0.5, 0.3]), np.array([0.9, -0.4])  # the gap is zero
        assert w @ q + model.q_r[0] == pytest.approx(0.0, abs=1e-15)
        after = mirror.J @ np.concatenate([q, u]) + mirror.offset
        later = after[:n] + lasts * after[n:]
        speed = w @ u
        rebound = u - (1 + eps) * k * speed
        np.testing.assert_allclose(later, q + lasts / 2 * (u + rebound), atol=1e-15)
        np.testing.assert_allclose(after[n:], rebound, atol=1e-15)


def test_an_impulse_beside_that_of_a_stop_is_friction_of_a_body_in_a_plane() -> None:
    """The stop sees y; x loses a share of the impulse that stops y, over the mass."""
    model = parse_model(
        """
        name: plane
        coordinates: [x, y]
        mass: [[0.7, 0], [0, 2]]
        damping: [[0, 0], [0, 0]]
        stiffness: [[0, 0], [0, 0]]
        contacts: [{name: stop, direction: [0, -1], gap: 0.25, restitution: 0.8}]
        """,
        "plane",
    ).system
    (friction,) = impulses_aside(model)
    numbers = ParametricFamily(model, (friction,)).coefficients_at(np.array([0.2]))
    found = Mirror.of(model, ImpactLaw(model).jump((0,)), (0,), numbers)
    impulse = 2 * 1.5
    after = found.landed(np.array([0.1, 0.25, 3.0, 1.5]))
    slowed = float(friction.effect.aside[0, 0]) * 0.2 * impulse / 0.7
    assert abs(float(friction.effect.aside[0, 0])) == pytest.approx(1.0)
    np.testing.assert_allclose(after, [0.1, 0.25, 3.0 + slowed, -0.8 * 1.5], atol=1e-14)


@pytest.mark.parametrize("eps", [0.0, 0.6])
def test_what_is_not_linear_in_a_jump_has_the_moments_of_drawn_jumps(eps: float) -> None:
    """Against 4000 exact maps with drawn instants and states, less their linear part."""
    model = replace(FORCED, contacts=(replace(FORCED.contacts[0], restitution=eps),))
    phase, rng = Phases(model).phase(()), np.random.default_rng(5)
    mirror = Mirror.of(model, ImpactLaw(model).jump((0,)), (0,))

    def jumped(e: float, y: Array) -> Array:
        x = mirror.J @ phase.moved(T, y, -e)[0] + mirror.offset
        return phase.moved(T - e, x, e)[0]

    y, root = rng.normal(size=6), np.tril(rng.normal(size=(7, 7))) * 1e-2
    drawn = rng.normal(size=(4000, 7)) @ root.T
    ends = np.array([jumped(each[0], y + each[1:]) for each in drawn])
    slope = (jumped(1e-5, y) - jumped(-1e-5, y)) / 2e-5
    left = ends - jumped(0.0, y) - drawn @ np.column_stack([slope, mirror.J]).T
    filter_ = ImpactFilter(model, 0.0)
    joint = Joint(T, np.append(0.0, y), root, np.zeros((7, 0)), 6)
    found = filter_.conditioning.jump_remainder(ContactChange(T, (), (0,), ()), joint)
    moment = left.T @ left / len(left)
    np.testing.assert_allclose(found @ found.T, moment, atol=0.1 * np.max(moment), rtol=0.1)
