# SPDX-License-Identifier: Apache-2.0
"""Errors of the model: their levels follow the innovations, and their effect is the derivative."""

import math

import numpy as np
import pytest
from systems import chain

from impact_observer.dynamics import ImpactLaw
from impact_observer.filter.model_error import ErrorKind, LearnedError, largest, unit_kicks
from impact_observer.filter.tuning import TUNING


@pytest.mark.parametrize("first", [0.02, 1.0, 50.0])
def test_level_converges_to_the_deviation_of_the_innovations(first: float) -> None:
    """Gaps deviate by 0.03 per level and by 0.01 of other errors; the true level is 1."""
    rng, unit, other = np.random.default_rng(5), 0.03, 0.01
    error, levels = LearnedError(ErrorKind.ACCELERATION, first), []
    for _ in range(600):
        deviation = math.hypot(error.level * unit, other)
        seen = rng.normal(scale=math.hypot(unit, other))
        error = error.matched(seen / deviation, deviation, unit, most=100.0)
        levels.append(error.level)
    assert error.events == 600
    assert np.median(levels[200:]) == pytest.approx(1.0, rel=0.15)


def test_level_stays_where_events_tell_nothing_of_it() -> None:
    """Other errors are a thousand times larger: no innovation moves it by a percent."""
    error = LearnedError(ErrorKind.RESTITUTION, 0.05)
    for innovation in (5.0, -0.1, 3.0, 0.0):
        error = error.matched(innovation, 1.0, 0.02, most=0.1)
    assert error.level == pytest.approx(0.05, rel=0.01)


def test_level_is_limited() -> None:
    """However large the innovations are."""
    error = LearnedError(ErrorKind.RESTITUTION, 0.09)
    for _ in range(50):
        error = error.matched(30.0, 1.0, 10.0, most=0.1)
    assert error.level == 0.1
    assert largest(ErrorKind.RESTITUTION, np.ones(2), 0.1) == TUNING.largest_restitution_error
    assert largest(ErrorKind.ACCELERATION, np.array([3.0, 4.0]), 0.25) == pytest.approx(0.25)


def test_kick_is_the_derivative_of_the_impact_by_the_restitution() -> None:
    """Newton's law is linear in it: the difference of two impacts is exact."""
    stops = [[([0, 0, -1.0], 0.2, restitution)] for restitution in (0.5, 0.6)]
    low, high = (chain(3, contacts=each) for each in stops)
    x = np.array([0.1, 0.0, 0.2, 0.3, -0.4, 1.7])
    after = [ImpactLaw(model).velocity_after(x[3:], (0,)) for model in (low, high)]
    gamma = low.contact_speed(x[3:])
    found = -0.1 * gamma * unit_kicks(low)[:, 0]
    np.testing.assert_allclose(found, after[1] - after[0], atol=1e-14)
