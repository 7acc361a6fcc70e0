# SPDX-License-Identifier: Apache-2.0
"""Flights that the kernel flies ahead: the plant is the same as without."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from systems import EPOCH, chain, examples, forcing, sample, system, systems, vectors

from impact_observer.errors import DynamicsError, ImpactLawError
from impact_observer.model import System
from impact_observer.plant import Plant, Switching
from impact_observer.plant.flights import Hit
from impact_observer.stamps import NS_PER_S, Elapsed

Array = NDArray[np.float64]


def switchings(plant: Plant, seconds: float, *, most: int = 200) -> list[Switching]:
    """What the contacts do, at most so much."""
    found: list[Switching] = []
    limit = plant.epoch + round(seconds * NS_PER_S)
    try:
        while len(found) < most and (one := plant.next_switching(limit)) is not None:
            found.append(one)
            plant.cross(one)
    except (DynamicsError, ImpactLawError):
        pass
    return found


def alone(monkeypatch: pytest.MonkeyPatch, model: System, q: Array, u: Array) -> Plant:
    """A plant that makes all impacts itself: the kernel learns of none."""
    plant = Plant(model, q, u, epoch=EPOCH)
    monkeypatch.setattr(plant.impacts, "_learn", lambda _: False)
    return plant


def assert_same(one: list[Switching], other: list[Switching]) -> None:
    """The same contacts do the same at the same instants."""
    assert len(one) == len(other)
    for a, b in zip(one, other, strict=True):
        assert abs(a.instant.stamp - b.instant.stamp) <= 1
        assert (a.contacts, a.closed, a.held) == (b.contacts, b.closed, b.held)
        assert a.switches == b.switches
        size = 1e-9 * (1 + np.abs(b.after).max())
        np.testing.assert_allclose(a.before, b.before, rtol=0, atol=size)
        np.testing.assert_allclose(a.after, b.after, rtol=0, atol=size)


@pytest.mark.parametrize("name", ["two_mass", "three_mass", "bouncing_ball"])
def test_impacts_are_those_of_a_plant_alone(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The ball's impacts accumulate, and then it rests."""
    model = sample(name)
    start = model.initial_state()
    one = Plant(model.system, *start, epoch=EPOCH)
    found = switchings(one, 12.0)
    assert_same(found, switchings(alone(monkeypatch, model.system, *start), 12.0))
    assert found[-1].closed == ((0,) if name == "bouncing_ball" else ())


@pytest.mark.slow
@examples(150)
@given(st.data())
def test_impacts_of_any_system_are_those_of_a_plant_alone(data: st.DataObject) -> None:
    """Some come to rest, some close several contacts at once."""
    model = data.draw(systems(contacts=(1, 3), gaps=(0.0, 2.0)))
    q, u = data.draw(vectors(model.n, -1, 1)), data.draw(vectors(model.n, -4, 4))
    if np.any(model.gap(q) < 0):
        return
    try:
        plant = Plant(model, q, u, epoch=EPOCH)
    except ImpactLawError:
        return
    with pytest.MonkeyPatch.context() as patched:
        other = alone(patched, model, q, u)
    # Rounding decides what happens at one instant, and grows from there on.
    one, two = switchings(plant, 2.0, most=8), switchings(other, 2.0, most=8)
    if not any(len(each.contacts) != 1 or each.closed for each in (*one, *two)):
        assert_same(one, two)


def test_states_between_impacts_are_those_of_the_flight() -> None:
    """In any order of asking, before and after the kernel has flown on."""
    model = sample("two_mass")
    plant, other = (Plant(model.system, *model.initial_state(), epoch=EPOCH) for _ in range(2))
    assert other.next_switching(EPOCH + 30 * NS_PER_S) is not None  # flies far ahead
    for _ in range(12):
        one = plant.next_switching(EPOCH + 30 * NS_PER_S)
        two = other.next_switching(EPOCH + 30 * NS_PER_S)
        assert one is not None
        assert two is not None
        assert one.instant == two.instant
        stamps = np.linspace(one.instant.stamp - 10**8, one.instant.stamp, 5).astype(np.int64)
        np.testing.assert_array_equal(plant.states(stamps), other.states(stamps))
        np.testing.assert_allclose(plant.states(stamps)[-1], one.before, rtol=0, atol=1e-8)
        plant.cross(one)
        other.cross(two)
        np.testing.assert_allclose(plant.states(stamps[-1:])[0], one.after, rtol=0, atol=1e-8)


def test_small_steps_of_the_limit_change_nothing() -> None:
    """A node asks every millisecond."""
    model = sample("three_mass")
    at_once = Plant(model.system, *model.initial_state(), epoch=EPOCH)
    stepwise = Plant(model.system, *model.initial_state(), epoch=EPOCH)
    expected = switchings(at_once, 6.0)
    found: list[Switching] = []
    for limit in range(EPOCH, EPOCH + 6 * NS_PER_S, 7_000_000):
        while (one := stepwise.next_switching(limit)) is not None:
            assert one.instant.stamp <= limit
            found.append(one)
            stepwise.cross(one)
    assert [each.instant for each in found] == [each.instant for each in expected[: len(found)]]
    assert len(found) >= len(expected) - 1


def test_contacts_become_known_where_they_are_hit_first() -> None:
    """Whatever flies before: the same impacts as with contacts that were hit already."""
    model = chain(3, contacts=[([0, 0, -1], 0.2, 0.6), ([0, -1, 0], 0.3, 0.5)])
    x = np.array([0.1, 0.1, 0.1, 0.0, 3.0, 4.0])
    plain = Plant(model, *np.split(x, 2), epoch=0).impacts
    found: list[list[Hit]] = []
    for _ in range(2):
        plain.start(Elapsed(0), x)
        found.append([])
        while (hit := plain.next(5 * NS_PER_S)) is not None:
            found[-1].append(hit)
    assert {hit[2] for hit in found[0]} == {0, 1}
    for one, other in zip(*found, strict=True):
        assert one[:4] == other[:4]
        np.testing.assert_array_equal(one[5], other[5])


def test_contact_that_may_come_to_rest_is_left_to_the_plant() -> None:
    """A plastic impact of a body that is pressed against its stop."""
    model = system(1, 0, 1, contacts=[([1], 0.0, 0.0)], force=forcing(1, -2.0))
    plant = Plant(model, np.array([0.5]), np.zeros(1), epoch=0)
    (one,) = switchings(plant, 5.0)
    assert one.closed == (0,)


@pytest.mark.parametrize("remainder", [np.nan, -9.3e18, 1e300])
def test_instants_that_no_stamp_can_hold_are_refused(remainder: float) -> None:
    """A stamp and a remainder of seconds that do not fit in a stamp."""
    plant = Plant(sample("two_mass").system, np.zeros(2), np.zeros(2), epoch=0)
    with pytest.raises(ValueError, match="remainder"):
        plant.impacts.arena.start(0, remainder, np.zeros(4))
