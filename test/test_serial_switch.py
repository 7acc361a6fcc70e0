# SPDX-License-Identifier: Apache-2.0
"""The example of a switch at a microcontroller: its clock, its lines, its node."""

import os
import pty
import runpy
import subprocess
import sys
import time
import tty
from pathlib import Path
from typing import Any

import numpy as np
import pytest

EXAMPLE = Path(__file__).resolve().parent.parent / "examples" / "serial_switch.py"
NS = 1_000_000_000


@pytest.fixture(scope="module")
def switch() -> dict[str, Any]:
    """What the example defines."""
    return runpy.run_path(str(EXAMPLE))


def test_stamps_are_those_of_the_microcontroller(switch: dict[str, Any]) -> None:
    """Two hours of a clock that drifts, over its overflow, on a line of varying latency."""
    rng = np.random.default_rng(1)
    true = np.arange(0.0, 7200.0, 0.1)
    micros = np.round(true * (1 + 40e-6) * 1e6).astype(np.int64) % 2**32
    late = 1e-3 + rng.exponential(4e-3, true.size)
    clock = switch["Clock"]()
    begin = 1_700_000_000 * NS
    found = [
        clock.stamp(int(own), begin + round((t + delay) * 1e9)) - begin - round(t * 1e9)
        for own, t, delay in zip(micros, true, late, strict=True)
    ]
    errors = np.array(found[100:]) * 1e-9 - 1e-3
    assert np.abs(errors).max() < 0.6e-3
    assert late.mean() > 4e-3


def test_lines_that_cannot_be_read_are_left_out(switch: dict[str, Any]) -> None:
    """A beat is no edge; noise of a plug is neither."""
    lines = [(b"5 1", 10_000), (b"7", 12_000), (b"\xff\x00 1", 13_000), (b"8 0\r", 13_000)]
    lines += [(b"", 14_000), (b"9 1 1", 15_000), (b"-9 1", 16_000)]
    assert list(switch["edges"](iter(lines))) == [(10_000, True), (13_000, False)]


@pytest.mark.ros
def test_edges_of_a_serial_line_become_messages_with_their_stamps(
    ros_environment: dict[str, str],
) -> None:
    """A pseudo-terminal is the microcontroller; its switch closes until the messages arrive.

    What it writes before the node has opened the line, or before the two nodes have found each
    other, is lost, as with a real one.
    """
    from processes import spinning
    from sensor_msgs.msg import Range

    board, device = pty.openpty()
    tty.setraw(device)
    command = [sys.executable, str(EXAMPLE), os.ttyname(device)]
    process = subprocess.Popen(command, env=ros_environment, stderr=subprocess.DEVNULL)
    received: list[Range] = []
    next_press = 0.0

    def pressed_and_released() -> bool:
        """Press for 5 ms, five times a second; whether a press and its release have arrived."""
        nonlocal next_press
        if time.monotonic() > next_press:
            own = time.monotonic_ns() // 1000 % 2**32
            os.write(board, b"%d 1\n%d 0\n" % (own, own + 5000))
            next_press = time.monotonic() + 0.2
        return [each.range for each in received[-2:]] == [1.0, 0.0]

    start = time.time_ns()
    try:
        with spinning() as spinner:
            spinner.probe.create_subscription(Range, "/switch", received.append, 100)
            spinner.until(lambda: spinner.probe.count_publishers("/switch"))
            spinner.until(pressed_and_released)
    finally:
        process.kill()
        process.wait()
        os.close(board)
        os.close(device)
    stamps = [each.header.stamp.sec * NS + each.header.stamp.nanosec for each in received[-2:]]
    assert start <= stamps[1] <= time.time_ns()
    assert 0 <= stamps[1] - stamps[0] <= 5_000_000
