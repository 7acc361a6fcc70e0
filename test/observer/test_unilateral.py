# SPDX-License-Identifier: Apache-2.0
"""The unilateral law: gaps that are never negative, and what this improves."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from systems import (
    EPOCH,
    chain,
    estimates,
    event,
    examples,
    forcing,
    observer,
    run,
    sample,
    switchings,
    system,
    systems,
    vectors,
)

from impact_observer.dynamics import Phases, lyapunov
from impact_observer.dynamics.contact.unilateral_projection import UnilateralProjection
from impact_observer.errors import ImpactLawError
from impact_observer.model import System
from impact_observer.observer.belief import Belief
from impact_observer.observer.contact_change import ContactChange
from impact_observer.observer.laws.geometric import Geometric
from impact_observer.observer.laws.unilateral import Unilateral
from impact_observer.stamps import NS_PER_S, grid

Array = NDArray[np.float64]


def hammer() -> System:
    """Two masses and one spring, free between two stops, driven: K is singular."""
    return system(
        np.diag([1.0, 2.0]),
        [[0.1, -0.1], [-0.1, 0.1]],
        [[8.0, -8.0], [-8.0, 8.0]],
        contacts=[([1, 0], 0.5, 0.7), ([0, -1], 0.5, 0.7)],
        force=forcing(2, [-3.0, 0.5]),
    )


def distance(model: System, one: Array, two: Array) -> Array:
    """``V`` of states, shape (..., 2n)."""
    q, u = np.split(one - two, 2, axis=-1)
    return lyapunov.distance(model, q, u)


@pytest.mark.slow
@examples(25)
@given(st.data())
def test_no_gap_is_ever_negative_under_any_switching(data: st.DataObject) -> None:
    """Random contacts at random instants, K singular or not, where some position is possible."""
    model = data.draw(systems(contacts=(1, 4), common_restitution=True))
    law, t = Unilateral(model), 0.0
    possible = UnilateralProjection(Phases(model)).is_possible
    closed: tuple[int, ...] = ()
    assume(possible(()))
    x = law.admissible(data.draw(vectors(2 * model.n)))
    for wait, hit, stay in data.draw(switchings(model.m)):
        motion = law.motion(t, x, closed)
        states = motion.states(np.linspace(0.0, wait, 33))
        q = states[:, : model.n]
        size = np.abs(model.q_r) + np.abs(q) @ np.abs(model.W) + np.max(np.abs(states))
        assert np.all(q @ model.W + model.q_r >= -1e-12 * size)
        x, t = motion.state(wait), t + wait
        active = tuple(sorted({*closed, *hit}))
        stays = tuple(i for i in active if i in stay)
        assume(possible(active))
        try:
            x = law.correct(ContactChange(t, closed, hit, stays), Belief.of(x[None])).x
        except ImpactLawError:
            assume(False)
        closed = stays


@examples(25)
@given(st.data())
def test_impact_leaves_no_contact_separating_before_newtons_law(data: st.DataObject) -> None:
    """``u-`` goes to the nearest with ``gamma_A <= 0``: optimality conditions of that."""
    model = data.draw(systems(contacts=(1, 3)))
    u = data.draw(vectors(model.n))
    active = tuple(sorted(data.draw(st.sets(st.integers(0, model.m - 1), min_size=1))))
    W = model.W[:, list(active)]
    found = Unilateral(model).nearest_approaching(u, active)
    size = 1 + float(np.max(np.abs(u)))
    assert np.max(W.T @ found) <= 1e-8 * size
    push = model.M @ (u - found)  # = W P with P >= 0, and P gamma = 0
    assert abs(push @ found) <= 1e-7 * size**2
    for _ in range(5):
        other = data.draw(vectors(model.n))
        if np.all(W.T @ other <= 0):  # the angle with all that is allowed is obtuse
            assert push @ (other - found) <= 1e-7 * size**2


def test_separating_contact_stops_and_closing_contact_bounces() -> None:
    """By hand for two_mass: gamma = -u2, restitution 0.7."""
    law = Unilateral(sample("two_mass").system)
    hit = ContactChange(0.0, (), (0,), ())
    opening = law.correct(hit, Belief.of(np.array([[0.1, 0.2, 1.0, -2.0]]))).x
    np.testing.assert_allclose(opening, [0.25, 0.5, 1.0, 0.0], atol=1e-12)
    closing = law.correct(hit, Belief.of(np.array([[0.1, 0.2, 1.0, 2.0]]))).x
    np.testing.assert_allclose(closing, [0.25, 0.5, 1.0, -1.4], rtol=1e-12)


def test_of_contacts_that_hit_together_one_may_separate() -> None:
    """The jump is then that of geometric."""
    corner = [([1, 0], 0.0, 0.5), ([1, 3], 0.0, 0.5)]
    model = system(np.eye(2), np.zeros((2, 2)), np.eye(2), contacts=corner)
    x = np.array([0.0, 0.0, -1.0, 0.5])  # c1 closes, c2 was hit just before
    both = ContactChange(1.0, (), (0, 1), ())
    expected = Geometric(model).correct(both, Belief.of(x[None])).x
    found = Unilateral(model).correct(both, Belief.of(x[None])).x
    np.testing.assert_array_equal(found, expected)


def test_replica_away_from_other_stops_equals_the_geometric_one() -> None:
    """From the true state, and from one that stays away from the other stop."""
    model = chain(2, contacts=[([0, -1], 0.2, 0.6), ([1, 0], 50.0, 0.5)])
    x, t = np.array([0.1, 0.0, 0.3, 0.2]), 0.0
    closed: tuple[int, ...] = ()
    geometric, unilateral = Geometric(model), Unilateral(model)
    np.testing.assert_array_equal(unilateral.admissible(x), x)
    for hit, stays in (((0,), (0,)), ((), ())):
        one = geometric.motion(t, x, closed).state(0.05)
        other = unilateral.motion(t, x, closed).state(0.05)
        np.testing.assert_allclose(other, one, rtol=0, atol=1e-12)
        change = ContactChange(t, closed, hit, stays)
        belief = Belief.of(one[None])
        x = geometric.correct(change, belief).x
        np.testing.assert_array_equal(unilateral.correct(change, belief).x, x)
        t, closed = t + 0.05, stays


@pytest.mark.slow
@pytest.mark.parametrize(
    "model", [sample("bouncing_ball").system, hammer()], ids=["ball", "hammer"]
)
def test_v_falls_for_free_bodies(model: System) -> None:
    """K singular: V is a seminorm; the replica's gaps stay nonnegative, V falls, far down."""
    n = model.n
    start = np.concatenate([np.full(n, 0.3), np.full(n, 0.2)])
    plant = run(model, start[:n], start[n:], seconds=3.0 if n == 1 else 8.0, rate=20.0)
    assert len(plant.events) >= 4
    for seed in range(2):
        x = start + np.random.default_rng(seed).normal(size=2 * n) / 2
        watcher = observer(model, "unilateral", x, epoch=EPOCH, ensemble=1)
        for each in plant.events:
            watcher.receive(each)
        found = estimates(watcher, plant.stamps)
        assert np.min(found[:, :n] @ model.W + model.q_r) >= -1e-12
        V = distance(model, found, plant.states)
        assert np.max(np.diff(V)) <= 1e-6 * (1e-3 + V[0])  # stamps are rounded to 1 ns
        assert V[-1] <= 0.5 * V[0]


def test_certified_bound_is_never_below_the_true_distance() -> None:
    """Both projections lower it, so it falls faster than that of geometric."""
    model = sample("three_mass")
    plant = run(model.system, *model.initial_state(), seconds=8.0, rate=10.0)
    truth = dict(zip(plant.stamps.tolist(), plant.states, strict=True))
    for seed in range(2):
        x = np.concatenate(model.initial_state()) + np.random.default_rng(seed).normal(size=6)
        bounds = {}
        for law in ("geometric", "unilateral"):
            watcher = observer(model.system, law, x, epoch=EPOCH, ensemble=1)
            for each in plant.events:
                watcher.receive(each)
            found = [watcher.estimate(stamp) for stamp in truth]
            V = distance(
                model.system,
                np.array([np.concatenate([each.q, each.u]) for each in found]),
                np.array(list(truth.values())),
            )
            bounds[law] = np.array([each.bound for each in found])
            assert np.all(bounds[law] >= V)
            assert np.all(np.diff(bounds[law]) <= 0)
        assert bounds["unilateral"][-1] < bounds["unilateral"][0]


def test_initial_state_inside_a_stop_is_projected_out_of_it() -> None:
    """As little as K allows: two_mass's masses move as 1 to 2."""
    x = np.array([0.0, 1.5, 0.0, 0.0])
    model = sample("two_mass").system
    placed = observer(model, "unilateral", x, epoch=EPOCH, ensemble=1).estimate(EPOCH)
    np.testing.assert_allclose(placed.q, [-0.5, 0.5], atol=1e-12)


def test_events_that_no_plant_could_report_are_no_failure() -> None:
    """Floor and ceiling close together and open again: afterwards no gap is negative."""
    model = chain(2, contacts=[([1, 0], 0.5, 0.5), ([-1, 0], 0.5, 0.5)])
    watcher = observer(model, "unilateral", [0.1, 0.3, 2.0, 1.0], epoch=EPOCH, ensemble=3)
    watcher.receive(event(0.5, "c1", "c2", sequence=1))
    watcher.receive(event(0.7, "c1", sequence=2))
    stamps = grid(EPOCH, EPOCH + 3 * NS_PER_S, 20.0)
    gaps = estimates(watcher, stamps)[:, :2] @ model.W + model.q_r
    assert np.min(gaps) >= -1e-12
    assert watcher.estimate(int(stamps[-1])).bound == -1.0


@pytest.mark.slow
def test_true_gaps_make_the_estimate_better_than_geometric_on_three_masses() -> None:
    """Median of V/V0 after 15 s over five seeds; bodies with one stop gain nothing."""
    model = sample("three_mass")
    plant = run(model.system, *model.initial_state(), seconds=15.0, rate=1.0)
    medians = []
    for law in ("geometric", "unilateral"):
        ratios = []
        for seed in range(5):
            x = np.concatenate(model.initial_state())
            y = x + np.random.default_rng(seed).normal(size=6)
            watcher = observer(model.system, law, y, epoch=EPOCH, ensemble=1)
            for each in plant.events:
                watcher.receive(each)
            last = estimates(watcher, plant.stamps[-1:])[0]
            ratios.append(
                distance(model.system, last, plant.states[-1]) / distance(model.system, y, x)
            )
        medians.append(float(np.median(ratios)))
    assert medians[1] <= medians[0] / 2
