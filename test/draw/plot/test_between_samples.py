# SPDX-License-Identifier: Apache-2.0
"""States between samples: a smooth motion is drawn smoothly, and jumps stay jumps."""

import numpy as np
import pytest

from impact_observer.draw.plot.between_samples import (
    MOST,
    PARTS,
    FreeMotion,
    with_states_between,
)
from impact_observer.model import read_model
from impact_observer.states import Matrix, Stamps

OMEGA = 2 * np.pi * 23


def sampled(rate: float, count: int = 60) -> tuple[Stamps, Matrix]:
    """A vibration of 23 Hz: its states."""
    stamps = (1e9 * (1 + np.arange(count) / rate)).astype(np.int64)
    return stamps, exact(stamps)


def exact(stamps: Stamps) -> Matrix:
    """The states of the vibration."""
    phase = OMEGA * (stamps - 1e9) / 1e9
    return np.column_stack([np.cos(phase), -OMEGA * np.sin(phase)])


NO_JUMPS = np.array([], dtype=np.int64)


@pytest.mark.parametrize("rate", [100.0, 200.0])
def test_a_vibration_of_four_samples_a_period_is_smooth(rate: float) -> None:
    """Within the bound of Hermite's cubic, ``(omega dt)^4 / 384``; all samples stay."""
    stamps, x = sampled(rate)
    at, states = with_states_between(stamps, x, NO_JUMPS)
    assert at.size == PARTS * (stamps.size - 1) + 1
    error = np.abs(states - exact(at))
    assert error[:, 0].max() <= (OMEGA / rate) ** 4 / 384
    assert error[:, 0].max() < 0.02
    assert error[:, 1].max() < 0.12 * OMEGA
    np.testing.assert_array_equal(states[np.isin(at, stamps)], x)


def test_a_ball_has_its_kink_at_the_impact_between_two_samples() -> None:
    """The ball falls with the model's motion, and rises with another velocity."""
    fall, g, eps = 0.437, 9.81, 0.8

    def ball(seconds: np.ndarray) -> Matrix:
        up = seconds >= fall
        t = np.where(up, seconds - fall, seconds)
        speed = eps * g * fall
        q = np.where(up, speed * t - g / 2 * t**2, g / 2 * (fall**2 - t**2))
        return np.column_stack([q, np.where(up, speed - g * t, -g * t)])

    stamps = (1e9 + 1e8 * np.arange(8)).astype(np.int64)
    x = ball(np.arange(8) / 10)
    jump = np.array([1_437_000_000])
    free = FreeMotion(read_model("bouncing_ball").system, 1_000_000_000)
    at, states = with_states_between(stamps, x, jump, free)
    np.testing.assert_allclose(states, ball(at / 1e9 - 1 + 1e-12), atol=1e-7)
    assert np.count_nonzero((at > stamps[4]) & (at < stamps[5])) == PARTS
    assert states[:, 0].min() < 1e-7
    late = jump + 60_000_000
    at, _ = with_states_between(stamps, x, late, free)
    assert np.count_nonzero((at > stamps[4]) & (at < stamps[5])) == 0


@pytest.mark.parametrize(("rate", "count"), [(40.0, 60), (1000.0, MOST + 1), (100.0, 2)])
def test_samples_that_are_too_few_or_enough_stay_as_they_are(rate: float, count: int) -> None:
    """Two samples a period do not determine the motion between the samples."""
    stamps, x = sampled(rate, count)
    at, states = with_states_between(stamps, x, NO_JUMPS)
    np.testing.assert_array_equal(at, stamps)
    np.testing.assert_array_equal(states, x)


def test_a_jump_beside_its_stamp_gets_no_peak() -> None:
    """A stamp 15 ms early lies in the interval before: no velocity is beyond those of samples."""
    seconds, jump = 0.1 * np.arange(12), 0.505
    q = np.where(seconds < jump, -seconds, seconds - 2 * jump)
    u = np.where(seconds < jump, -1.0, 1.0)
    x = np.column_stack([q - seconds**2 / 4, u - seconds / 2])
    stamps = (1e9 * (1 + seconds)).round().astype(np.int64)
    at, states = with_states_between(stamps, x, np.array([1_490_000_000]))
    assert at.size > 60
    assert states[:, 1].max() <= x[:, 1].max() + 1e-9
    assert states[:, 1].min() >= x[:, 1].min() - 1e-9


@pytest.mark.parametrize("share", [0.02, 0.25, 0.5, 0.9])
def test_an_impact_that_nobody_reported_makes_no_spike(share: float) -> None:
    """A ball rises from a floor at a ``share`` of an interval: no speed is above its samples'."""
    fall, g = (3 + share) / 10, 9.81
    t = np.arange(8) / 10
    up, since = t >= fall, t - fall
    speed = 0.8 * g * fall
    q = np.where(up, speed * since - g / 2 * since**2, g / 2 * (fall**2 - t**2))
    x = np.column_stack([q, np.where(up, speed - g * since, -g * t)])
    stamps = (1e9 + 1e8 * np.arange(8)).astype(np.int64)
    at, states = with_states_between(stamps, x, NO_JUMPS)
    assert at.size > stamps.size
    assert np.min(states[:, 1]) >= np.min(x[:, 1]) - 1e-9
    assert np.max(states[:, 1]) <= np.max(x[:, 1]) + 1e-9
