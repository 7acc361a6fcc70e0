# SPDX-License-Identifier: Apache-2.0
"""Signals that are no switch, and switches that do not move."""

import numpy as np
import pytest

from impact_observer.detector import Source
from impact_observer.recording.switch_choice import choose_switch, is_switch
from impact_observer.states import Vector

STAMPS = np.arange(0, 2000, dtype=np.int64) * 10**6
LINE = Source("stop", "/line")


def pulses(shape: Vector) -> Vector:
    """A signal with a pulse each 100 samples."""
    values = np.zeros(STAMPS.size)
    for begin in range(50, STAMPS.size, 100):
        values[begin : begin + shape.size] = shape
    return values


@pytest.mark.parametrize("samples", [7, 15, 31])
def test_pulses_of_a_force_and_ringing_are_no_switch(samples: int) -> None:
    """Half a sine as of a load cell, a decay as of a charge amplifier, a ringing."""
    s = np.linspace(0, 1, samples)
    for shape in (np.sin(np.pi * s), np.exp(-3 * s), np.exp(-3 * s) * np.sin(20 * s)):
        assert not is_switch(LINE, pulses(shape))


def test_a_threshold_that_is_declared_makes_a_peak() -> None:
    """Also where the signal has two levels."""
    values = pulses(np.ones(4))
    assert is_switch(LINE, values)
    assert not is_switch(Source("stop", "/line", threshold=0.5), values)


def test_a_switch_that_never_moves_is_left_as_declared() -> None:
    """Neither level is known to be the closed one."""
    assert choose_switch(LINE, STAMPS, np.ones(STAMPS.size)) == LINE
