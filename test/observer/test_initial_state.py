# SPDX-License-Identifier: Apache-2.0
"""Where a replica starts, as users write it."""

import numpy as np
import pytest
from systems import sample

from impact_observer.errors import UsageError
from impact_observer.observer import initial_state

SYSTEM = sample("two_mass").system


def test_zero_is_rest_in_the_rest_position() -> None:
    """The default of the command line."""
    q, u = initial_state(" zero ", SYSTEM)
    assert (q.tolist(), u.tolist()) == ([0, 0], [0, 0])


def test_numbers_are_positions_then_velocities() -> None:
    """In every notation of numbers that Python reads."""
    q, u = initial_state("1, -2e-3,.5,4", SYSTEM)
    assert (q.tolist(), u.tolist()) == ([1, -0.002], [0.5, 4])


def test_random_state_is_the_documented_draw() -> None:
    """``default_rng(SEED).normal(size=2n)``, q then u: other tools can repeat it."""
    q, u = initial_state("random:7", SYSTEM)
    expected = np.random.default_rng(7).normal(size=4)
    assert np.concatenate([q, u]).tolist() == expected.tolist()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "initial state ''"),
        ("one", "initial state 'one'"),
        ("1,2,3", "initial state '1,2,3'"),
        ("1,2,3,4,5", "5 numbers, expected 4"),
        ("1,2,3,", "expected zero, random:SEED or 4 numbers"),
        ("1,2,3,nan", "velocity.* is not finite"),
        ("random", "initial state 'random'"),
        ("drawn:1", "expected zero, random:SEED or 4 numbers"),
        ("random:", "expected random:SEED"),
        ("random:-1", "expected random:SEED"),
        ("random:1.5", "expected random:SEED"),
        ("random:²", "expected random:SEED"),
        ("zero:1", "initial state 'zero:1'"),
    ],
)
def test_state_that_cannot_be_read_is_one_line(text: str, message: str) -> None:
    """The line shows what was found and what is expected."""
    with pytest.raises(UsageError, match=message) as caught:
        initial_state(text, SYSTEM)
    assert len(str(caught.value).splitlines()) == 1
