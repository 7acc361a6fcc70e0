# SPDX-License-Identifier: Apache-2.0
"""Zeno behaviour: impacts that accumulate end in persistent contact within their bounds."""

import numpy as np
import pytest
from contact_cases import free, kinds_in_order, seconds
from numpy.typing import NDArray
from systems import EPOCH, Harmonic, forcing, run, started, system

from impact_observer.events import Kind
from impact_observer.model import Forcing
from impact_observer.plant import Run, simulate
from impact_observer.plant.zeno import LOW, SHORT
from impact_observer.stamps import NS_PER_S, from_seconds, grid, seconds_between

Array = NDArray[np.float64]

GRAVITY = 9.81


class Ball:
    """Closed form of a ball dropped from 1 m on a floor: all bounces, and rest after them."""

    def __init__(self, eps: float) -> None:
        """Compute all bounces until they are shorter than rounding."""
        self.speeds = np.sqrt(2 * GRAVITY) * eps ** np.arange(1 if eps == 0 else 10_000)
        flights = 2 * eps * self.speeds / GRAVITY
        fall = np.sqrt(2 / GRAVITY)
        self.end = fall * (1 + eps) / (1 - eps)
        self.starts = fall + np.concatenate([[0], np.cumsum(flights)[:-1]])
        self.eps = eps

    def states(self, t: Array) -> tuple[Array, Array]:
        """Height and speed at ``t`` s."""
        bounce = np.searchsorted(self.starts, t, side="right") - 1
        s = t - np.where(bounce < 0, 0.0, self.starts[bounce])
        speed = np.where(bounce < 0, 0.0, self.eps * self.speeds[bounce])
        height = np.where(bounce < 0, 1.0, 0.0) + speed * s - GRAVITY * s**2 / 2
        resting = t >= self.end
        return np.where(resting, 0.0, height), np.where(resting, 0.0, speed - GRAVITY * s)


@pytest.mark.parametrize("floor", [0.0, 1.0, pytest.param(-3.0, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "eps", [0.0, 0.2, 0.5, *(pytest.param(each, marks=pytest.mark.slow) for each in (0.9, 0.99))]
)
def test_ball_comes_to_rest_within_its_bound(eps: float, floor: float) -> None:
    """Number of impacts, instant and errors are within the bounds of ``plant/zeno.py``."""
    ball = Ball(eps)
    model = free(1, contacts=[([1], -floor, eps)], force=forcing(1, -GRAVITY))
    plant = started(model, [floor + 1.0], [0.0])
    found = simulate(plant, grid(EPOCH, EPOCH + from_seconds(ball.end + 1), 20.0))
    last = found.switchings[-1]
    assert [kinds_in_order(one) for one in found.switchings[:-1]] == [[Kind.IMPACT]] * (
        len(found.switchings) - 1
    )
    assert kinds_in_order(last) == [Kind.CLOSE]
    # The speed after the last impact, if it were none without restitution.
    gamma = -eps * last.before[1]
    least = max(SHORT * GRAVITY / 2, np.sqrt(2 * GRAVITY * LOW * abs(2 * floor)))
    assert gamma <= 1.001 * least + 1e-12
    bounces = 1 if eps == 0 else 2 + np.log(least / ball.speeds[0]) / np.log(eps)
    assert len(found.switchings) <= bounces
    left = 2 * gamma / (GRAVITY * (1 - eps))
    # Elsewhere than at zero the height is rounded, and slow bounces are with it.
    assert seconds(last) == pytest.approx(ball.end - left, abs=1e-2 * left * abs(floor) + 1e-11)
    # After it, exact rest, however long.
    resting = found.states[found.stamps >= last.instant.stamp]
    assert len(resting) >= 20
    assert np.all(resting == [floor, 0.0])


@pytest.mark.slow
@pytest.mark.parametrize("floor", [0.0, -3.0])
@pytest.mark.parametrize("eps", [0.2, 0.5, 0.9])
def test_errors_of_a_ball_that_rests_are_below_their_bound(eps: float, floor: float) -> None:
    """``gamma`` in speed, ``gamma^2 / (2 a)`` in height, until the left-out impacts end."""
    ball = Ball(eps)
    model = free(1, contacts=[([1], -floor, eps)], force=forcing(1, -GRAVITY))
    end = np.array([EPOCH + from_seconds(ball.end + 0.1)])
    switchings = simulate(started(model, [floor + 1.0], [0.0]), end).switchings
    gamma = -eps * switchings[-1].before[1]
    close = switchings[-1].instant.stamp
    step = max(1, from_seconds(ball.end - seconds(switchings[-1])) // 900)
    around = close + np.arange(-3000, 3000) * step
    stamps = np.unique(np.concatenate([np.linspace(EPOCH, close, 5000).astype(int), around]))
    stamps = stamps[stamps >= EPOCH]
    impacts = np.array([one.instant.stamp for one in switchings])
    nearest = np.min(np.abs(stamps[:, None] - impacts), axis=1)
    stamps = stamps[(nearest > 1) | (stamps > close)]
    states = simulate(started(model, [floor + 1.0], [0.0]), stamps).states
    height, speed = ball.states((stamps - EPOCH) * 1e-9)
    left = (stamps >= close) & ((stamps - EPOCH) * 1e-9 <= ball.end + 1e-12)
    assert np.count_nonzero(left) > 3
    bounds = np.where(left, gamma**2 / (2 * GRAVITY), 0.0) + 1e-14 * (1 + abs(floor))
    assert np.all(np.abs(states[:, 0] - floor - height) <= bounds)
    late = 3e-15 * abs(floor) / gamma  # the last instants, from a height that is rounded
    bounds = np.where(left, gamma, 0.0) + np.where(stamps <= close, GRAVITY * late, 0.0) + 1e-11
    assert np.all(np.abs(states[:, 1] - speed) <= bounds)
    assert np.all(states[(stamps >= close)] == [floor, 0.0])


def test_contacts_close_at_once() -> None:
    """Equal balls on equal floors in one event, and beads that rest on each other."""
    contacts = [([1, 0], 0.0, 0.5), ([0, 1], 0.0, 0.5)]
    model = free(2, contacts=contacts, force=forcing(2, -GRAVITY))
    found = run(model, [1.0, 1.0], [0.0, 0.0], seconds=2.0)
    assert {one.contacts for one in found.impacts} == {(0, 1)}
    assert kinds_in_order(found.switchings[-1]) == [Kind.CLOSE, Kind.CLOSE]
    contacts = [([1, 0], 0.0, 0.5), ([-1, 1], 0.0, 0.5)]
    model = free(2, contacts=contacts, force=forcing(2, -GRAVITY))
    beads = run(model, [0.0, 0.0], [0.0, 0.0], seconds=2.0)
    assert [kinds_in_order(one) for one in beads.switchings] == [[Kind.CLOSE, Kind.CLOSE]]
    assert not np.any(beads.states)


@pytest.mark.parametrize("eps", [0.0, 0.03, 0.07])
def test_row_of_beads_without_load_collapses_in_few_impacts(eps: float) -> None:
    """Below ``7 - 4 sqrt 3`` three beads meet infinitely often: McNamara and Young, 1992."""
    assert eps < 7 - 4 * np.sqrt(3)
    contacts = [([-1, 1, 0], 0.5, eps), ([0, -1, 1], 0.7, eps)]
    model = free(3, contacts=contacts, force=Forcing.none(3))
    found = run(model, [0.0, 0.0, 0.0], [1.0, 0.0, -1.3], seconds=10.0)
    assert len(found.switchings) < 100
    momentum = found.states[:, 3:].sum(axis=1)
    np.testing.assert_allclose(momentum, -0.3, rtol=0, atol=1e-13)
    # They move together, as far as impacts closer than rounding can be resolved.
    np.testing.assert_allclose(found.states[-1, 3:], -0.1, rtol=0, atol=3e-4)


def test_masses_that_collapse_stay_together_from_the_accumulation_on() -> None:
    """For a restitution of 0.05 impacts accumulate at 19/14 s; then all have the mean speed."""
    contacts = [([-1, 1, 0], 0.0, 0.05), ([0, -1, 1], 0.0, 0.05)]
    model = free(3, contacts=contacts, force=Forcing.none(3))
    found = run(model, [0.0, 1.0, 2.5], [1.0, 0.0, -1.0], seconds=5.0)
    last = found.switchings[-1]
    assert last.closed == (0, 1)
    assert seconds_between(EPOCH, last.instant.stamp) == pytest.approx(19 / 14, abs=1e-7)
    np.testing.assert_allclose(found.states[-1], [7 / 6] * 3 + [0.0] * 3, rtol=0, atol=1e-8)


@pytest.mark.slow
def test_light_body_between_a_heavy_one_and_a_wall_conserves_energy() -> None:
    """Galperin's billiard: 314 collisions for a mass ratio of 10^4, many within one instant."""
    wall, between = ([1, 0], 0.0, 1.0), ([-1, 1], 0.0, 1.0)
    model = system(
        np.diag([1e-4, 1]), np.zeros((2, 2)), np.zeros((2, 2)), contacts=[wall, between]
    )
    found = run(model, [5e-6, 1e-5], [0, -10.0], seconds=0.1)
    assert len(found.impacts) == 314
    energy = float(found.states[-1, 2:] ** 2 @ [1e-4, 1])
    assert energy == pytest.approx(100.0, rel=1e-11)
    assert not any(switching.closed for switching in found.switchings)


@pytest.mark.slow
def test_redundant_supports_close_together_when_their_impacts_accumulate() -> None:
    """Three legs of a rigid table, two floors in one place: no contact at its stop is open."""
    legs = [([1, -1], 0.0, 0.4), ([1, 0], 0.0, 0.4), ([1, 1], 0.0, 0.4)]
    push = forcing(2, [-9.81, 0], [Harmonic(1.0, [0, 0], [0, 3.0])])
    table = system(
        np.diag([1, 0.3]), np.zeros((2, 2)), np.zeros((2, 2)), contacts=legs, force=push
    )
    found = run(table, [0.2, 0.05], [0.0, 0.0], seconds=4.0)
    assert found.switchings[-1].closed == (0, 1, 2)
    assert found.events[-1].stamp < EPOCH + NS_PER_S, "loads change legs without an event"
    floors = [([1], 0.0, 0.5), ([1], 0.0, 0.5)]
    ball = system(1, 0, 0, contacts=floors, force=forcing(1, -9.81))
    assert run(ball, [1.0], [0.0], seconds=2.0).switchings[-1].closed == (0, 1)


def test_body_that_starts_inside_its_stop_by_rounding_leaves_it() -> None:
    """Half a picometre deep and separating: no impact is found again and again."""
    model = system(1, 0, 0, contacts=[([1], 1.0, 0.5)], force=forcing(1, -1e-3))
    found = run(model, [-1 - 5e-13], [1e-6], seconds=0.1)
    assert len(found.impacts) <= 10
    assert np.min(found.states[:, 0] + 1) >= -1e-12


def collapsing(eps: float) -> list[tuple[float, Array]]:
    """Instants and velocities after the impacts of three masses in free flight, one by one."""
    q, u, t = np.array([0.0, 1.0, 2.5]), np.array([1.0, 0.0, -1.0]), 0.0
    found = []
    for _ in range(200):
        speed = np.diff(u)
        ahead = np.where(speed < 0, np.diff(q) / np.where(speed < 0, -speed, 1.0), np.inf)
        i = int(np.argmin(ahead))
        if not np.isfinite(ahead[i]):
            break
        q, t = q + u * ahead[i], t + ahead[i]
        middle, half = (u[i] + u[i + 1]) / 2, (u[i + 1] - u[i]) / 2
        u[i], u[i + 1] = middle + eps * half, middle - eps * half
        q[i + 1] = q[i]
        found.append((t, u.copy()))
    return found


def collapse(eps: float) -> Run:
    """The plant's run of the same masses."""
    contacts = [([-1, 1, 0], 0.0, eps), ([0, -1, 1], 0.0, eps)]
    model = free(3, contacts=contacts, force=forcing(3))
    plant = started(model, [0.0, 1.0, 2.5], [1.0, 0.0, -1.0])
    return simulate(plant, grid(EPOCH, EPOCH + from_seconds(4), 10.0))


def test_masses_that_collapse_without_a_load_stay_together() -> None:
    """Their impacts accumulate at 1.357142857 s; momentum and centre of mass are kept."""
    wanted, found = collapsing(0.05), collapse(0.05)
    assert wanted[-1][0] == pytest.approx(1.357142857, abs=1e-9)
    last = found.switchings[-1]
    assert kinds_in_order(last) == [Kind.CLOSE, Kind.CLOSE]
    assert 0 < wanted[-1][0] - seconds(last) < 1e-7
    for one, (t, _) in zip(found.switchings[:-1], wanted, strict=False):
        assert seconds(one) == pytest.approx(t, abs=1e-9)
    after = found.states[found.stamps > last.instant.stamp]
    np.testing.assert_allclose(after[:, :3], 3.5 / 3, atol=1e-12)
    np.testing.assert_allclose(after[:, 3:], 0.0, atol=1e-12)


def test_masses_above_the_critical_restitution_part() -> None:
    """Three masses collapse below 7 - 4 sqrt(3) = 0.072 only; with 0.3 three impacts part them."""
    wanted, found = collapsing(0.3), collapse(0.3)
    assert [kinds_in_order(one) for one in found.switchings] == [[Kind.IMPACT]] * 3
    for one, (t, u) in zip(found.switchings, wanted, strict=False):
        assert seconds(one) == pytest.approx(t, abs=1e-9)
        np.testing.assert_allclose(one.after[3:], u, atol=1e-12)
