# SPDX-License-Identifier: Apache-2.0
"""Switchings of a plant do not depend on the limits and instants that are asked for."""

import numpy as np
from numpy.typing import NDArray
from systems import EPOCH, forcing, sample, system

from impact_observer.errors import DynamicsError, ImpactLawError
from impact_observer.plant import Plant, Switching
from impact_observer.stamps import NS_PER_S

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


def test_states_between_impacts_are_those_of_the_flight() -> None:
    """In any order of asking, before and after the search has gone on."""
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


def test_contact_that_may_come_to_rest_is_left_to_the_plant() -> None:
    """A plastic impact of a body that is pressed against its stop."""
    model = system(1, 0, 1, contacts=[([1], 0.0, 0.0)], force=forcing(1, -2.0))
    plant = Plant(model, np.array([0.5]), np.zeros(1), epoch=0)
    (one,) = switchings(plant, 5.0)
    assert one.closed == (0,)
