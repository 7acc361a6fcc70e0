# SPDX-License-Identifier: Apache-2.0
"""Angles of harmonics against exact rational arithmetic."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from systems import examples

from impact_observer.model.angles import Angles
from impact_observer.stamps import NS_PER_S


def _arctangent(inverse: int) -> Fraction:
    """``arctan(1 / inverse)`` to more than 60 digits."""
    terms = (Fraction((-1) ** k, (2 * k + 1) * inverse ** (2 * k + 1)) for k in range(60))
    return sum(terms, Fraction(0))


TURN = 8 * (4 * _arctangent(5) - _arctangent(239))
"""By Machin's formula."""


@given(omega=st.floats(1e-3, 1e4), ns=st.integers(-(10**18), 10**18))
@examples(100)
def test_angles_are_exact_but_for_whole_turns(omega: float, ns: int) -> None:
    """An angle up to thirty years before or after the epoch is right to 2e-15 rad."""
    angle = Angles(np.array([omega])).at_stamps(np.array([ns])).item()
    exact = Fraction(omega) * Fraction(ns, NS_PER_S)
    turns = (exact - Fraction(angle)) / TURN
    assert float((turns - round(turns)) * TURN) == pytest.approx(0.0, abs=2e-15)
