# SPDX-License-Identifier: Apache-2.0
"""Contacts that close, stay closed, share their loads, and open again."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
from contact_cases import free, kinds_in_order, seconds
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import optimize
from systems import (
    EPOCH,
    Harmonic,
    chain,
    examples,
    forcing,
    observer,
    run,
    started,
    system,
    systems,
    vectors,
)

from impact_observer.dynamics import DEPTH, ImpactLaw
from impact_observer.errors import ImpactLawError
from impact_observer.events import Kind, Switch
from impact_observer.model import Forcing, System
from impact_observer.model.force_samples import Samples
from impact_observer.plant import Run, Switching, simulate
from impact_observer.stamps import NS_PER_S, grid

Array = NDArray[np.float64]

GRAVITY = 9.81


def test_ball_at_rest_on_the_floor_is_closed_at_the_epoch() -> None:
    """CLOSE is reported at the epoch, and nothing else happens."""
    model = free(1, contacts=[([1], 1.0, 0.9)], force=forcing(1, -GRAVITY))
    found = run(model, [-1.0], [0.0], seconds=100.0, rate=1.0)
    assert [event.stamp for event in found.events] == [EPOCH]
    assert found.events[0].switches == (Switch("c1", Kind.CLOSE),)
    assert np.all(found.states == [-1.0, 0.0])


def test_pressed_mass_opens_where_its_load_vanishes() -> None:
    """``lambda = 2 - 3 sin(1.7 t)`` on a mass that starts on its stop."""
    model = system(
        1, 0.1, 1, contacts=[([1], 0.0, 0.5)], force=forcing(1, -2, [Harmonic(1.7, [0], [3.0])])
    )
    opened = run(model, [0.0], [0.0], seconds=0.5).switchings[-1]
    assert kinds_in_order(opened) == [Kind.OPEN]
    assert seconds(opened) == pytest.approx(np.arcsin(2 / 3) / 1.7, abs=1e-11)
    assert opened.contacts == opened.closed == ()
    np.testing.assert_array_equal(opened.before, opened.after)


@pytest.mark.parametrize("press", [0.5, 2.0, 2.9])
def test_contact_opens_where_a_second_mass_pulls_the_first_off(press: float) -> None:
    """The second swings as ``0.1 sin(w t)`` on its spring: ``lambda = press - 3 sin(w t)``."""
    k, mass = 30.0, 0.7
    omega = np.sqrt(k / mass)
    model = system(
        np.diag([1.3, mass]),
        np.zeros((2, 2)),
        [[k, -k], [-k, k]],
        contacts=[([1, 0], 0.0, 0.8)],
        force=forcing(2, [-press, 0.0]),
    )
    closed, opened = run(model, [0.0, 0.0], [0.0, 0.1 * omega], seconds=0.3).switchings[:2]
    assert (kinds_in_order(closed), kinds_in_order(opened)) == ([Kind.CLOSE], [Kind.OPEN])
    assert seconds(opened) == pytest.approx(np.arcsin(press / 3) / omega, abs=1e-11)


def alternates(switchings: Sequence[Switching], contact: str) -> bool:
    """Whether a contact's switches are IMPACT or CLOSE while open, and OPEN while closed."""
    kind = [s.kind for one in switchings for s in one.switches if s.contact == contact]
    return all((before is Kind.CLOSE) == (after is Kind.OPEN) for before, after in pairwise(kind))


@pytest.mark.slow
@pytest.mark.parametrize("eps", [0.0, 0.5])
def test_vibrating_table_throws_and_catches_its_body_for_many_cycles(eps: float) -> None:
    """``f = -g + A cos wt`` in the table's frame: take-off where ``A cos wt = g``, rest, again."""
    amplitude, omega = 1.3 * GRAVITY, 4 * np.pi
    model = free(
        1,
        contacts=[([1], 0.0, eps)],
        force=forcing(1, -GRAVITY, [Harmonic(omega, [amplitude], [0])]),
    )
    found = run(model, [0.0], [0.0], seconds=6.0, rate=500.0)
    opened = [one for one in found.switchings if Kind.OPEN in kinds_in_order(one)]
    assert len(opened) == 12
    assert alternates(found.switchings, "c1")
    for one in opened:
        phase = omega * seconds(one)
        assert amplitude * np.cos(phase) == pytest.approx(GRAVITY, abs=1e-10)
        assert np.sin(phase) < 0  # the load falls
    assert found.states[:, 0].min() >= -1e-10


BAR = [([1, -1], 0.0, 0.5), ([1, 0], 0.0, 0.5), ([1, 1], 0.0, 0.5)]
"""A bar on supports at -1, 0 and 1; its coordinates are height and angle."""


def test_bar_on_three_supports_transfers_its_load_without_an_event() -> None:
    """Two of them carry it; which two changes with the moment, without an event."""
    force = forcing(2, [-3.0, 0.0], [Harmonic(1.0, [0, 0], [0, 2.0])])
    found = run(free(2, contacts=BAR, force=force), [0.0, 0.0], [0.0, 0.0], seconds=20.0)
    assert len(found.events) == 1
    assert kinds_in_order(found.switchings[0]) == [Kind.CLOSE] * 3
    assert len(found.switchings) > 1
    assert len({one.held for one in found.switchings}) > 1
    for one in found.switchings[1:]:
        assert one.switches == ()
        assert (one.contacts, one.closed) == ((), (0, 1, 2))
    assert not np.any(found.states)


def test_bar_on_three_supports_tilts_about_the_last_one() -> None:
    """The moment ``4 sin t`` beats the weight 3 at arm 1: two supports open, together."""
    force = forcing(2, [-3.0, 0.0], [Harmonic(1.0, [0, 0], [0, 4.0])])
    found = run(free(2, contacts=BAR, force=force), [0.0, 0.0], [0.0, 0.0], seconds=1.0)
    # W'u >= 0 with u = (1, -1): about the support at 1, which sees nothing of it.
    opened = found.switchings[-1]
    assert opened.switches == (Switch("c2", Kind.OPEN), Switch("c3", Kind.OPEN))
    assert opened.closed == (0,)
    assert seconds(opened) == pytest.approx(np.arcsin(3 / 4), abs=1e-11)
    gaps = found.states[-1, :2] @ np.array([w for w, _, _ in BAR]).T
    assert gaps[0] == pytest.approx(0.0, abs=1e-15)
    assert 0 < gaps[1] < gaps[2]


def grazing(depth: float) -> Run:
    """``x = cos(t - 2)`` against a stop ``depth`` below its peak, until just after it."""
    model = system(1, 0, 1, contacts=[([-1], 1 - depth, 0.5)])
    return run(model, [np.cos(2.0)], [np.sin(2.0)], seconds=3.0)


@pytest.mark.parametrize("depth", [1e-2, 1e-6, 1e-10, 1e-12, 6 * DEPTH])
def test_graze_deeper_than_rounding_is_one_impact(depth: float) -> None:
    """Its instant is the closed form, and the contact, which is pulled away, does not close."""
    found = grazing(depth)
    assert [kinds_in_order(one) for one in found.switchings] == [[Kind.IMPACT]]
    change = found.switchings[0]
    error = 1e-15 / np.sqrt(depth)  # the gap is rounded to 1e-15 or so
    assert seconds(change) == pytest.approx(2 - np.arccos(1 - depth), abs=3 * error + 1e-14)
    assert change.before[1] == pytest.approx(np.sqrt(1 - (1 - depth) ** 2), abs=3 * error + 1e-14)


@pytest.mark.parametrize("depth", [DEPTH / 200, 0.0, -1e-12, -1e-6])
def test_graze_shallower_than_rounding_is_none(depth: float) -> None:
    """No switching, and no penetration either."""
    found = grazing(depth)
    assert found.switchings == ()
    assert np.min(1 - depth - found.states[:, 0]) >= -2 * DEPTH


@pytest.mark.parametrize("K", [0.0, 1.0])
def test_body_at_rest_on_its_stop_without_load_stays_closed(K: float) -> None:
    """The contact does not open within 1000 s."""
    model = system(1, 0.1, K, contacts=[([1], 0.0, 0.5)])
    plant = started(model, [0.0], [0.0])
    closed = plant.next_switching(EPOCH)
    assert closed is not None
    assert kinds_in_order(closed) == [Kind.CLOSE]
    plant.cross(closed)
    assert plant.next_switching(EPOCH + 1000 * NS_PER_S) is None


def test_closed_contacts_take_part_in_an_impact_on_their_body() -> None:
    """A body on the floor is hit from above, by hand: it stays, the other bounces by eps."""
    contacts = [([1, 0], 0.0, 0.5), ([-1, 1], 0.0, 0.5)]
    model = system(
        np.diag([2.0, 1.0]),
        np.zeros((2, 2)),
        np.zeros((2, 2)),
        contacts=contacts,
        force=forcing(2, [-2 * GRAVITY, -GRAVITY]),
    )
    found = run(model, [0.0, 1.0], [0.0, 0.0], seconds=0.8)
    hit = found.switchings[1]
    assert (hit.contacts, hit.closed) == ((0, 1), (0,))
    assert hit.switches == (Switch("c2", Kind.IMPACT),)
    speed = np.sqrt(2 * GRAVITY)
    np.testing.assert_allclose(hit.after, [0, 0, 0, speed / 2], rtol=0, atol=1e-14)
    assert seconds(hit) == pytest.approx(np.sqrt(2 / GRAVITY), abs=1e-14)


@pytest.mark.parametrize("n", [3, 4, 5])
def test_balls_that_touch_at_rest_are_thrown_off_together(n: int) -> None:
    """A cradle without gaps: by Newton's law the others move as one, and the first one returns.

    Their loads and gaps are zero all the time, but for rounding.
    """
    stops = [(-np.eye(n)[i] + np.eye(n)[i + 1], 0.0, 0.9) for i in range(n - 1)]
    model = system(np.eye(n), 0.05 * np.eye(n), 10 * np.eye(n), contacts=stops)
    whole = run(model, -0.5 * np.eye(n)[0], np.zeros(n), seconds=5.0)
    hits = [each for each in whole.impacts if 0 in each.contacts]
    assert len(hits) >= 4
    for hit in hits:
        before, after = hit.before[n:], hit.after[n:]
        together = before[1] + 1.9 * (before[0] - before[1]) / n
        np.testing.assert_allclose(after[1:], together, atol=1e-12)
        assert after[0] + (n - 1) * together == pytest.approx(before.sum(), abs=1e-12)
    gaps = np.array([model.gap(x[:n]) for x in whole.states])
    assert gaps.min() > -1e-12
    assert np.abs(gaps[:, 1:]).max() < 1e-12


def test_contact_opens_in_the_event_of_the_impact_that_throws_it_off() -> None:
    """A ball hits a hook of a body on the floor from below."""
    contacts = [([1, 0], 0.0, 0.5), ([1, -1], 1.0, 0.5)]
    model = free(2, contacts=contacts, force=forcing(2, [-GRAVITY, 0.0]))
    found = run(model, [0.0, 0.0], [0.0, 2.0], seconds=0.6)
    hit = found.switchings[1]
    assert seconds(hit) == pytest.approx(0.5, abs=1e-14)
    assert (hit.contacts, hit.closed) == ((0, 1), ())
    assert hit.switches == (Switch("c1", Kind.OPEN), Switch("c2", Kind.IMPACT))
    np.testing.assert_allclose(hit.after[2:], [1.5, 0.5], rtol=0, atol=1e-14)
    assert found.events[1].switches == hit.switches


@pytest.mark.parametrize(("hold", "expected"), [("previous", 2 / 3), ("linear", 0.5)])
@pytest.mark.parametrize("K", [0.0, 4.0])
def test_sampled_force_opens_a_contact_at_its_instant(
    hold: str, expected: float, K: float
) -> None:
    """By a step at its knot, by a ramp where it crosses zero."""
    times = np.array([0.0, 1 / 3, 2 / 3, 3.0])
    force = Forcing.of_samples(Samples(times, np.array([[-1.0], [-1.0], [1.0], [1.0]]), hold))
    model = system(1, 0.2, K, contacts=[([1], 0.0, 0.5)], force=force)
    switchings = run(model, [0.0], [0.0], seconds=1.0).switchings
    assert [kinds_in_order(one) for one in switchings] == [[Kind.CLOSE], [Kind.OPEN]]
    assert seconds(switchings[1]) == pytest.approx(expected, abs=2e-14)


def separation(model: System, t: float, x: Array, closed: Sequence[int]) -> tuple[Array, float]:
    """``dgamma/dt`` of closed contacts under their loads, by Gauss's principle, and its scale."""
    factor = np.linalg.cholesky(np.linalg.inv(model.M))
    load = model.forcing(t) - model.C @ x[model.n :] - model.K @ x[: model.n]
    W = model.W[:, list(closed)]
    pushed = optimize.nnls(factor.T @ W, -factor.T @ load)[0]
    acceleration = factor @ factor.T @ (load + W @ pushed)
    scale = np.abs(np.linalg.inv(model.M)) @ (np.abs(load) + np.abs(W) @ pushed)
    return W.T @ acceleration, 1 + float(np.max(scale))


def assert_lawful(model: System, found: Run) -> None:
    """Nothing is penetrated, contacts switch as they can, impacts and loads obey their laws."""
    n, closed = model.n, tuple[int, ...]()
    law = ImpactLaw(model)
    assert np.min(found.states[:, :n] @ model.W + model.q_r, initial=0.0) >= -1e-10
    for one in found.switchings:
        at_stop = {*closed, *one.contacts}
        assert set(one.held) <= set(one.closed) <= at_stop
        assert np.linalg.matrix_rank(model.W[:, list(one.held)]) == len(one.held)
        if one.contacts:
            assert set(closed) <= set(one.contacts)
        size = 1 + np.abs(one.before[n:]).max()
        assert np.max(np.abs(model.gap(one.before[:n])[list(at_stop)])) < 1e-10
        assert np.max(np.abs(model.contact_speed(one.after[n:])[list(one.closed)]), initial=0) < (
            1e-11 * size
        )
        if one.contacts and not one.closed:
            expected = law.velocity_after(one.before[n:], one.contacts)
            np.testing.assert_allclose(one.after[n:], expected, rtol=0, atol=1e-9 * size)
        closed = one.closed


def assert_loads(model: System, found: Run) -> None:
    """Closed contacts do not move, and their loads would rather hold them than let them go."""
    stamps = [one.instant.stamp for one in found.switchings]
    for stamp, x in zip(found.stamps[::5], found.states[::5], strict=True):
        past = int(np.searchsorted(stamps, stamp, side="right"))
        closed = found.switchings[past - 1].closed if past else ()
        if (
            closed
            and stamp - stamps[past - 1] > 10_000
            and stamp + 10_000 < min(stamps[past:], default=stamp + 20_000)
        ):
            away, scale = separation(model, (stamp - EPOCH) * 1e-9, x, closed)
            assert np.max(np.abs(away)) < 1e-9 * scale
            assert np.max(np.abs(model.gap(x[: model.n])[list(closed)])) < 1e-10


@pytest.mark.slow
@examples(200)
@given(st.data())
def test_random_systems_obey_all_laws(data: st.DataObject) -> None:
    """No penetration, complementary loads, no gain of energy, consistent switchings."""
    model = data.draw(systems(gaps=(0.0, 1.0), max_n=3, rigid=data.draw(st.booleans())))
    assume(np.all(model.eps < 1))  # with damping, full restitution takes for ever to rest
    x = np.concatenate([data.draw(vectors(model.n, -0.25, 0.25)), data.draw(vectors(model.n))])
    assume(np.all(model.gap(x[: model.n]) >= 0))
    stamps = grid(EPOCH, EPOCH + NS_PER_S, 100.0)
    try:
        found = simulate(started(model, *np.split(x, 2)), stamps)
    except ImpactLawError:
        assume(False)
        raise
    assert_lawful(model, found)
    assert_loads(model, found)
    if not model.forcing.frequency.size:
        q, u = np.split(found.states, 2, axis=1)
        total = ((u @ model.M * u).sum(axis=1) + (q @ model.K * q).sum(axis=1)) / 2
        total -= q @ model.forcing.constant
        assert np.max(np.diff(total)) < 1e-9 * (1 + np.max(np.abs(total)))


def test_heavy_body_does_not_hide_the_impacts_of_a_light_one() -> None:
    """A gap is rounded against the motions in it, not against the largest body."""
    model = system(
        np.diag([1e6, 1e-6]),
        np.zeros((2, 2)),
        np.diag([0, 1e-6]),
        contacts=[([0, 1], 1 - 1e-9, 1)],
    )
    found = run(model, [1.0, 0.0], [0.3, -1.0], seconds=10.0)
    assert len(found.impacts) == 2
    assert np.min(found.states[:, 1]) >= -(1 - 1e-9)


@pytest.mark.long
def test_chain_of_three_hundred_closes_and_opens_two_contacts_and_an_observer_follows() -> None:
    """No gap is ever negative; a replica that starts in the true state follows the plant."""
    n = 300
    left, middle = -np.eye(n)[0], np.eye(n)[n // 2 - 1]
    pushed = [Harmonic(1.3, np.eye(n)[0].tolist(), [0.0] * n)]
    model = chain(
        n,
        contacts=[(left, 0.05, 0.5), (middle, 0.05, 0.3)],
        force=forcing(n, 0.5 * np.eye(n)[0], pushed),
    )
    start = 0.5 * np.sin(np.arange(n) * np.pi / 7)
    plant = run(model, np.zeros(n), start, seconds=2.5)
    kinds = {switch.kind for each in plant.events for switch in each.switches}
    assert kinds == set(Kind)
    assert len(plant.events) > 12
    assert np.min(plant.states[:, :n] @ model.W + model.q_r) >= -1e-10
    watcher = observer(model, "geometric", plant.states[0], epoch=EPOCH, ensemble=1)
    for each in plant.events:
        watcher.receive(each)
    found = watcher.estimate(int(plant.stamps[-1]))
    # The error of impact times rounded to 1 ns.
    np.testing.assert_allclose(np.r_[found.q, found.u], plant.states[-1], atol=1e-8)
