# SPDX-License-Identifier: Apache-2.0
"""Gaps that never turn negative: one joint projection at once, stops that hold in between."""

from itertools import combinations
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from quadrature import NODES, integral
from scipy import linalg, optimize
from systems import (
    Harmonic,
    chain,
    examples,
    forcing,
    numbers,
    sample,
    system,
    systems,
    vectors,
    whole_numbers,
)

from impact_observer.dynamics import Clutches, ImpactLaw, Motion, PositionProjection
from impact_observer.dynamics.contact.sweeping import SweepingProcess
from impact_observer.dynamics.contact.unilateral_projection import UnilateralProjection
from impact_observer.model import System

Array = NDArray[np.float64]
PIECES = 24
"""Pieces in which a motion is checked."""
SPRING = np.array([[4.0, -4.0], [-4.0, 4.0]])


def sweeping_process(model: System) -> SweepingProcess:
    """The sweeping process of ``model``."""
    return SweepingProcess(Clutches(model))


def joint(model: System) -> UnilateralProjection:
    """The joint projection of ``model``."""
    return sweeping_process(model).projection


def nearest(model: System, q: Array, fixed: list[int]) -> Array:
    """The displacement from ``q`` to ``g = 0`` on ``fixed``: least in K, then in M.

    By null spaces: all that lead there, among them those of least energy, among them the lightest.
    """
    W = model.W[:, fixed]
    move = np.linalg.lstsq(W.T, -model.gap(q)[fixed], rcond=1e-10)[0]
    free = linalg.null_space(W.T, rcond=1e-10) if fixed else np.eye(model.n)
    for form in (model.K, model.M):
        if free.shape[1]:
            reduced = free.T @ form @ free
            scale = max(float(np.trace(form)), 1e-300)
            move = move - free @ linalg.pinv(reduced, atol=1e-10 * scale) @ (free.T @ form @ move)
            values, shapes = linalg.eigh(reduced)
            free = free @ shapes[:, values <= 1e-10 * scale]
    return np.asarray(move)


def enumerated(model: System, q: Array, active: tuple[int, ...]) -> Array | None:
    """The nearest possible position, by trying every set of gaps that may be zero."""
    others = [i for i in range(model.m) if i not in active]
    best: tuple[float, float] | None = None
    found = None
    for size in range(len(others) + 1):
        for some in combinations(others, size):
            move = nearest(model, q, [*active, *some])
            gap = model.gap(q + move)
            if np.any(gap < -1e-9) or np.any(np.abs(gap[list(active)]) > 1e-9):
                continue
            cost = float(move @ model.K @ move), float(move @ model.M @ move)
            if (
                best is None
                or cost[0] < best[0] - 1e-9
                or (cost[0] < best[0] + 1e-9 and cost[1] < best[1])
            ):
                best, found = cost, q + move
    return found


@pytest.mark.slow
@examples(50)
@given(st.data())
def test_unilateral_projection_is_the_nearest_position_of_all(data: st.DataObject) -> None:
    """Against every set of gaps that could be zero, K singular or not; none where none is."""
    model = data.draw(systems(contacts=(1, 4)))
    active = tuple(sorted(data.draw(st.sets(st.integers(0, model.m - 1), max_size=2))))
    q = data.draw(vectors(model.n))
    stops, expected = joint(model), enumerated(model, q, active)
    assert stops.is_possible(active) == (expected is not None)
    if expected is not None:
        found = stops.position_after(q, active)
        size = 1 + float(np.max(np.abs(expected)))
        np.testing.assert_allclose(found, expected, atol=1e-6 * size)
        assert np.min(model.gap(found)) >= -1e-12 * size * (1 + np.max(np.abs(model.W)))


@pytest.mark.parametrize("seed", range(8))
def test_unilateral_projection_is_what_a_general_optimiser_finds(seed: int) -> None:
    """Sequential quadratic programming, five coordinates and six stops, one of them closed."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(5, 5))
    model = system(
        np.eye(5),
        np.zeros((5, 5)),
        root @ root.T + np.eye(5) / 2,
        contacts=[
            (w, gap, 0.5) for w, gap in zip(rng.normal(size=(6, 5)), rng.random(6), strict=True)
        ],
    )
    q = rng.normal(size=5)
    best = optimize.minimize(
        lambda z: (z - q) @ model.K @ (z - q) / 2,
        q,
        jac=lambda z: model.K @ (z - q),
        constraints=[
            {"type": "eq", "fun": lambda z: model.gap(z)[:1], "jac": lambda _: model.W.T[:1]},
            {"type": "ineq", "fun": lambda z: model.gap(z)[1:], "jac": lambda _: model.W.T[1:]},
        ],
        method="SLSQP",
        options={"ftol": 1e-14},
    )
    found = joint(model).position_after(q, (0,))
    assert best.success
    np.testing.assert_allclose(found, best.x, atol=1e-6)


def test_position_that_is_possible_stays_where_geometric_puts_it() -> None:
    """In every bit, where no stop is in the way."""
    model = sample("three_mass").system
    q = np.array([0.05, -0.1, 0.2])
    for active in ((), (0,), (1,)):
        expected = PositionProjection(model).position_after(q, active)
        np.testing.assert_array_equal(joint(model).position_after(q, active), expected)


def test_correcting_one_contact_does_not_push_another_through_its_stop() -> None:
    """One spring between two masses, each with its stop: pulled to one, it rests on the other."""
    stops = [([1, 0], 0.0, 0.5), ([0, 1], 0.5, 0.5)]
    model = system(np.eye(2), np.zeros((2, 2)), SPRING + np.eye(2) / 4, contacts=stops)
    q = np.array([2.0, 0.0])
    alone = PositionProjection(model).position_after(q, (0,))
    assert model.gap(alone)[1] < -1
    np.testing.assert_allclose(joint(model).position_after(q, (0,)), [0, -0.5], atol=1e-15)


def test_reactions_are_the_inverse_flexibility() -> None:
    """``L^-1`` for definite stiffness; of the rigid tie-break where there is none."""
    model = chain(3, contacts=[([1, 0, 0], 0.0, 0.5), ([0, 0, -1], 0.0, 0.5)])
    L = model.W.T @ np.linalg.solve(model.K, model.W)
    found = PositionProjection(model).reactions((0, 1))
    np.testing.assert_allclose(found, np.linalg.inv(L), atol=1e-12)
    heavy = system(3.0, 0, 0, contacts=[([2], 0.0, 0.5)])
    np.testing.assert_allclose(PositionProjection(heavy).reactions((0,)), [[3 / 4]])


class Held(NamedTuple):
    """A system, its contacts with ``chi = 1``, and a motion from a possible state on."""

    system: System
    start: Array
    closed: tuple[int, ...]
    motion: Motion


def started(model: System, t: float, x: Array, closed: tuple[int, ...]) -> Held | None:
    """The motion from the nearest possible state on; None where there is none."""
    n, stops = model.n, sweeping_process(model)
    if not stops.projection.is_possible(closed):
        return None
    position = stops.projection.position_after(x[:n], closed)
    velocity = ImpactLaw(model).velocity_held(x[n:], closed, closed)
    start = np.concatenate([position, velocity])
    return Held(model, start, closed, stops.motion(t, start, closed))


def drawn(data: st.DataObject, model: System) -> Held | None:
    """Any contacts of ``model`` closed, or none, from any state on; often from rest."""
    some = data.draw(st.sets(st.integers(0, model.m - 1), max_size=1))
    x = np.concatenate([data.draw(vectors(model.n)), data.draw(vectors(model.n))])
    if data.draw(st.booleans()):
        x[model.n :] = 0.0
    return started(model, data.draw(numbers(0, 3)), x, tuple(sorted(some)))


def unexplained(push: Array, one_way: Array, both_ways: Array) -> float:
    """What is left of ``push`` by impulses on directions, those ``one_way`` not negative."""
    directions = np.hstack([one_way, both_ways, -both_ways])
    if not directions.shape[1]:
        return float(np.linalg.norm(push))
    return float(optimize.nnls(directions / np.linalg.norm(directions, axis=0), push)[1])


def assert_stops_only_push(held: Held, seconds: float) -> None:
    """``K dq = K u dt + W sigma dt`` integrated over short pieces, and no gap is ever negative.

    ``sigma_i >= 0`` where the gap is zero, of any sign where ``chi`` is 1, zero elsewhere;
    ``u`` is not changed by it. A piece has a switch where its halves have another sum.
    """
    model, n = held.system, held.system.n
    ends = np.linspace(0.0, seconds, 2 * PIECES + 1)
    half = seconds / PIECES / 4
    nodes = (ends[:-1, None] + half * (1 + NODES)).ravel()
    whole = (ends[:-2:2, None] + 2 * half * (1 + NODES)).ravel()
    edge, x, y = (held.motion.states(s) for s in (ends, nodes, whole))
    size = 1 + float(np.max(np.abs(x)))
    tolerance = 1e-10 * size * (1 + np.max(np.abs(model.K)) + np.max(np.abs(model.M)))

    def rates(s: Array, x: Array) -> Array:
        force = model.forcing.derivatives(held.motion.t + s, 0)[0]
        return np.hstack([x[:, n:], force - x[:, n:] @ model.C.T - x[:, :n] @ model.K.T])

    summed = integral(rates(nodes, x), ends).reshape(PIECES, 2, -1).sum(axis=1)
    smooth = np.max(np.abs(summed - integral(rates(whole, y), ends[::2])), axis=1) <= tolerance
    A, every = list(held.closed), np.concatenate([edge, x])
    gap = every[:, :n] @ model.W + model.q_r
    scale = np.abs(model.q_r) + np.abs(every[:, :n]) @ np.abs(model.W)
    assert np.min(gap + 1e-12 * (scale + size)) >= 0
    np.testing.assert_allclose(gap[:, A], 0.0, atol=1e-10 * size)
    away = np.where(np.isin(np.arange(model.m), A), every[:, n:] @ model.W, gap) > 1e-9 * size
    ended, inside = away[: edge.shape[0]], away[edge.shape[0] :].reshape(PIECES, -1, model.m)
    inside = np.concatenate([inside, np.stack([ended[:-2:2], ended[1::2], ended[2::2]], 1)], 1)
    # A switch close to an edge changes the sums by less than the tolerance.
    smooth &= np.all(np.all(inside, axis=1) | ~np.any(inside, axis=1), axis=1)
    assert np.sum(smooth) >= PIECES / 3
    change = edge[2::2] - edge[:-2:2]
    push = (change[:, :n] - summed[:, :n]) @ model.K
    force = change[:, n:] @ model.M - summed[:, n:]
    for k in np.flatnonzero(smooth):
        there = [i for i in range(model.m) if not inside[k, 0, i]]
        stops, pressed = sorted({*there} - {*A}), sorted({*there} & {*A})
        W = model.W
        assert unexplained(push[k], W[:, stops], W[:, A]) <= 5 * tolerance
        assert unexplained(force[k], W[:, pressed], W[:, :0]) <= 5 * tolerance


@pytest.mark.slow
@examples(150)
@given(st.data())
def test_every_motion_obeys_the_complementarity_of_gaps_and_reactions(
    data: st.DataObject,
) -> None:
    """Any system, one contact closed or none, from any state that the plant could have."""
    model = data.draw(systems(max_n=3, contacts=(1, 4), common_restitution=True))
    held = drawn(data, model)
    if held is not None:
        assert_stops_only_push(held, 3.0)


@pytest.mark.slow
@examples(150)
@given(st.data())
def test_motions_with_integer_data_obey_it(data: st.DataObject) -> None:
    """Gaps, rates and reactions that are zero together; equal and opposite stops."""
    model, x = data.draw(whole_numbers())
    some = data.draw(st.sets(st.integers(0, model.m - 1), max_size=1))
    held = started(model, 0.0, x, tuple(some))
    assert held is not None  # q = 0 is possible
    assert_stops_only_push(held, 5.0)


def test_stop_holds_an_oscillator_until_its_velocity_turns() -> None:
    """``x = -sin t`` is stopped at -1/2; held, u rises by 1/2 each second; released at u = 0."""
    model = system(1, 0, 1, contacts=[([1], 0.5, 0.5)])
    s = np.linspace(0.0, 6.0, 121)
    found = sweeping_process(model).motion(0.0, np.array([0.0, -1.0]), ()).states(s)
    struck, released = np.pi / 6, np.pi / 6 + np.sqrt(3)
    free = np.column_stack([-np.sin(s), -np.cos(s)])
    stopped = np.column_stack([np.full(s.size, -0.5), (s - released) / 2])
    later = np.column_stack([-np.cos(s - released) / 2, np.sin(s - released) / 2])
    expected = np.where((s < struck)[:, None], free, stopped)
    expected = np.where((s < released)[:, None], expected, later)
    np.testing.assert_allclose(found, expected, atol=1e-14)


def stepped(model: System, x: Array, seconds: float, steps: int) -> Array:
    """Moreau's catching-up algorithm: a step without stops, then the nearest possible position."""
    n, h = model.n, seconds / steps
    A = np.block([[np.eye(n), -h / 2 * np.eye(n)], [h / 2 * model.K, model.M + h / 2 * model.C]])
    B = np.block([[np.eye(n), h / 2 * np.eye(n)], [-h / 2 * model.K, model.M - h / 2 * model.C]])
    root = linalg.cholesky(model.K)
    D = linalg.solve_triangular(root.T, model.W, lower=True)
    for k in range(steps):
        force = model.forcing((k + 0.5) * h) * h
        x = np.linalg.solve(A, B @ x + np.concatenate([np.zeros(n), force]))
        gap = model.gap(x[:n])
        if np.any(gap < 0):  # the dual problem, by Lawson and Hanson
            y = optimize.nnls(np.vstack([D, -gap]), np.append(np.zeros(n), 1.0))[0]
            x[:n] += np.linalg.solve(model.K, model.W @ (y / (1.0 + gap @ y)))
    return x


CAUGHT = {
    "one stop": (
        chain(2, contacts=[([0, -1], 0.2, 0.5)], force=forcing(2, [0.0, 1.0])),
        [0.1, 0.1, 1.0, 2.0],
    ),
    "two of three stops at once": (
        chain(
            3,
            contacts=[([1, 0, 0], 0.1, 0.5), ([0, -1, 1], 0.1, 0.5), ([0, 0, -1], 0.2, 0.5)],
            force=forcing(3, 0, [Harmonic(2.0, [-4, 1, 6], [0, 0, 0])]),
        ),
        [0.0, 0.0, 0.0, -2.0, 0.5, 1.0],
    ),
}


@pytest.mark.parametrize(("model", "x"), CAUGHT.values(), ids=list(CAUGHT))
def test_motion_is_what_small_steps_converge_to(model: System, x: list[float]) -> None:
    """Moreau's catching-up algorithm, of first order: a quarter of the step, of the distance."""
    seconds = 2.0
    motion = sweeping_process(model).motion(0.0, np.array(x), ())
    found = motion.state(seconds)
    errors = [
        float(np.max(np.abs(stepped(model, np.array(x), seconds, steps) - found)))
        for steps in (500, 2000)
    ]
    assert errors[1] <= 0.02
    assert errors[1] == pytest.approx(errors[0] / 4, rel=0.1)
    gaps = motion.states(np.linspace(0, seconds, 401))[:, : model.n] @ model.W + model.q_r
    assert np.max(np.sum(np.abs(gaps) < 1e-12, axis=1)) == min(model.m, 2 if model.n == 3 else 1)


def test_ball_stays_on_the_floor_until_its_velocity_turns() -> None:
    """No stiffness: the whole body stops; pulled up it leaves as soon as it moves up."""
    pull = forcing(1, 0, [Harmonic(1.0, [0.0], [1.0])])
    ball = system(1, 0, 0, contacts=[([1], 0.0, 0.5)], force=pull)
    motion = sweeping_process(ball).motion(0.0, np.array([0.0, -1.0]), ())
    s = np.linspace(0.0, 3.0, 31)
    # u = -cos s
    flying = np.maximum(s, np.pi / 2)
    expected = np.column_stack([1 - np.sin(flying), -np.cos(s)])
    np.testing.assert_allclose(motion.states(s), expected, atol=1e-14)


def hammer(clearance: float) -> System:
    """Two masses and one spring, free between two stops: K is singular."""
    return system(
        np.eye(2),
        np.zeros((2, 2)),
        SPRING,
        contacts=[([1, 0], 0.0, 0.5), ([0, -1], clearance, 0.5)],
    )


def test_free_hammer_is_stopped_as_a_whole_before_its_spring_gives_way() -> None:
    """Rigid motions have no elastic energy: both masses stop together."""
    model = hammer(4.0)
    motion = sweeping_process(model).motion(0.0, np.array([1.0, 1.0, -1.0, -1.0]), ())
    found = motion.states(np.array([0.5, 1.0, 3.0]))
    np.testing.assert_allclose(found[:, :2], [[0.5, 0.5], [0.0, 0.0], [0.0, 0.0]], atol=1e-15)
    np.testing.assert_allclose(found[:, 2:], -1.0, atol=1e-15)


def test_hammer_that_fits_exactly_between_its_stops_is_held_by_both() -> None:
    """Growing it is pressed on both, and its spring takes the reaction; shrinking it is free."""
    model = hammer(0.0)
    motion = sweeping_process(model).motion(0.0, np.array([0.0, 0.0, -1.0, 1.0]), ())
    s = np.linspace(0.0, 2.0, 21)
    np.testing.assert_allclose(motion.states(s)[:, :2], 0.0, atol=1e-15)
    np.testing.assert_allclose(motion.states(s)[:, 2:], [[-1.0, 1.0]] * 21, atol=1e-15)
    inwards = sweeping_process(model).motion(0.0, np.array([0.0, 0.0, 1.0, -1.0]), ())
    w = np.sqrt(8.0)
    half = inwards.states(np.linspace(0, np.pi / w, 9))
    np.testing.assert_allclose(
        half[:, 0], np.sin(w * np.linspace(0, np.pi / w, 9)) / w, atol=1e-14
    )


def test_gap_that_is_zero_with_no_rate_is_decided_by_what_comes_next() -> None:
    """At rest on the stop: pressed or without a force it stays, pulled it leaves."""
    for force, height in ((-1.0, 0.0), (1.0, 2.0), (0.0, 0.0)):
        model = system(1, 0, 0, contacts=[([1], 0.0, 0.5)], force=forcing(1, force))
        motion = sweeping_process(model).motion(0.0, np.zeros(2), ())
        np.testing.assert_allclose(motion.state(2.0), [height, 2 * force], atol=1e-14)


def test_gap_of_a_two_sided_stop_without_play_never_moves() -> None:
    """Floor and ceiling at one place: they depend on each other and hold together."""
    model = system(
        np.eye(2),
        np.zeros((2, 2)),
        SPRING + np.eye(2),
        contacts=[([1, 0], 0.0, 0.5), ([-1, 0], 0.0, 0.5), ([2, 0], 0.0, 0.5)],
        force=forcing(2, 0, [Harmonic(3.0, [2.0, 1.0], [0.0, 1.0])]),
    )
    motion = sweeping_process(model).motion(0.0, np.array([0.0, 1.0, 1.0, -1.0]), ())
    states = motion.states(np.linspace(0.0, 5.0, 26))
    np.testing.assert_allclose(states[:, 0], 0.0, atol=1e-13)
    assert np.ptp(states[:, 1]) > 1


def test_gaps_that_no_position_can_open_do_not_stop_anything() -> None:
    """No plant can have this ``chi``: the motion goes on without stops."""
    model = chain(2, contacts=[([1, 0], 0.0, 0.5), ([-1, 0], -1.0, 0.5)])
    assert not joint(model).is_possible(())
    x = np.array([0.5, 0.0, 1.0, 0.0])
    found = sweeping_process(model).motion(0.0, x, ()).state(1.0)
    np.testing.assert_allclose(found, Clutches(model).motion(0.0, x, (), fix=True).state(1.0))


def test_closed_contact_slips_while_another_stop_holds() -> None:
    """One contact with ``chi = 1``, its gap fixed; the neighbour is pushed into its own stop."""
    model = chain(2, contacts=[([1, 0], 0.0, 0.5), ([0, 1], 0.1, 0.5)])
    held = started(model, 0.0, np.array([0.0, 0.0, 1.0, -2.0]), (0,))
    assert held is not None
    assert_stops_only_push(held, 4.0)
    gap = held.motion.states(np.linspace(0, 4, 401))[:, :2] @ model.W + model.q_r
    assert np.sum(np.abs(gap[:, 1]) < 1e-13) > 10
    assert np.max(gap[:, 1]) > 1e-2


@pytest.mark.slow
@examples(15)
@given(st.data())
def test_motion_does_not_depend_on_when_it_is_requested(data: st.DataObject) -> None:
    """One by one in any order, far ahead first: the same bits."""
    model = data.draw(systems(max_n=3, contacts=(1, 3), common_restitution=True))
    one = drawn(data, model)
    if one is None:
        return
    s = np.array(data.draw(st.lists(numbers(0, 4), min_size=1, max_size=12)))
    singly = np.array([one.motion.state(float(at)) for at in s])
    ahead = sweeping_process(model).motion(one.motion.t, one.start, one.closed)
    ahead.state(7.0)
    backwards = np.array([ahead.state(float(at)) for at in s[::-1]])
    np.testing.assert_array_equal(backwards[::-1], singly)
