# SPDX-License-Identifier: Apache-2.0
"""Sensors that notice the hits of another contact are named."""

import numpy as np

from impact_observer.detector import Source
from impact_observer.detector.sensors import SignalTrace
from impact_observer.recording.crosstalk import crosstalk

FRONT, BACK = Source("front", "/CH1"), Source("back", "/CH2")


def trace(milliseconds: list[float]) -> SignalTrace:
    """A sensor with impacts at these times."""
    return SignalTrace(impacts=[round(1e6 * each) for each in milliseconds])


def test_a_sensor_with_the_hits_of_another_one_is_named() -> None:
    """Half of its impacts come 0.3 ms after those of the other."""
    front = [100.0 * k for k in range(1, 40)]
    back = [each + late for each in front for late in (0.3, 47)]
    (line,) = crosstalk([FRONT, BACK], [trace(front), trace(back)])
    assert line.startswith("back: 39 of 78")


def test_hits_that_meet_by_chance_are_no_crosstalk() -> None:
    """Two independent contacts, and one that never hits."""
    rng = np.random.default_rng(2)
    front, back = (sorted(rng.uniform(0, 10_000, 90).tolist()) for _ in range(2))
    assert not [*crosstalk([FRONT, BACK], [trace(front), trace(back)])]
    assert not [*crosstalk([FRONT, BACK], [trace(front), trace([])])]
