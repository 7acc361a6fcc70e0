# SPDX-License-Identifier: Apache-2.0
"""Sizes of the errors of a robot's velocity jumps, learned from hit to hit."""

import math

import pytest

from impact_observer.filter.jump_error import LEVELS, JumpError


def after_hits(*levels: int) -> JumpError:
    """After hits of these levels."""
    error = JumpError()
    for level in levels:
        error = error.after_hit(level)
    return error


def test_priors_of_the_next_hit_add_to_one_and_follow_the_hits() -> None:
    """A level that was seen often is expected."""
    for error in (JumpError(), after_hits(0, 2, 1, 0), after_hits(*[2] * 50)):
        priors = [math.exp(error.log_prior(level)) for level in range(len(LEVELS))]
        assert sum(priors) == pytest.approx(1.0)
    assert (
        after_hits(*[2] * 50).log_prior(2) > after_hits(2).log_prior(2) > JumpError().log_prior(2)
    )


def test_a_few_large_errors_in_many_hits_are_not_strange() -> None:
    """Half of six hits are, one of six is not, and none is before two have come."""
    assert not JumpError().is_strange
    assert not after_hits(2).is_strange
    assert not after_hits(0, 0, 1, 0, 0, 0).is_strange
    assert after_hits(0, 2, 0, 1, 0, 2).is_strange
    assert after_hits(2, 2, 2).is_strange


def test_strange_jumps_that_have_ended_are_forgotten() -> None:
    """Such as those of a tip that has been exchanged."""
    assert after_hits(*[2] * 20).is_strange
    assert not after_hits(*[2] * 20, *[0] * 30).is_strange


def test_a_contradicted_hit_counts_as_the_largest_error() -> None:
    """Its former level does not count then; before any hit nothing changes."""
    assert after_hits(0, 1, 0).unexplained.counts == pytest.approx(after_hits(0, 1, 2).counts)
    assert JumpError().unexplained == JumpError()
