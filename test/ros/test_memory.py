# SPDX-License-Identifier: Apache-2.0
"""Memory of an observer node: what it keeps does not grow with what it has received."""

import gc
import tracemalloc
from itertools import pairwise

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from benchmarks.memory import rig

pytestmark = [pytest.mark.ros, pytest.mark.slow]

SOME = 250
"""Events, of which the node's history holds as many."""
MOST = 20.0
"""Bytes an event; a number that was kept would take more."""


def held() -> int:
    """Bytes that Python has allocated, without garbage."""
    gc.collect()
    return tracemalloc.get_traced_memory()[0]


def test_memory_of_a_node_does_not_grow_with_its_events(ros_environment: dict[str, str]) -> None:
    """Python has no more memory allocated after twice as many events.

    What is kept is kept each time; caches that happen to grow do not grow twice.
    """
    assert ros_environment
    tracemalloc.start()
    try:
        with rig() as made:
            readings = []
            for _ in range(3):
                made.send(2 * SOME)
                readings.append(held())
    finally:
        tracemalloc.stop()
    assert made.received >= 6 * SOME
    assert min(b - a for a, b in pairwise(readings)) / (2 * SOME) < MOST
