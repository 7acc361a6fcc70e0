# SPDX-License-Identifier: Apache-2.0
"""Live samples and pulses in a node, without an executor."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

from std_msgs.msg import Header

from impact_observer.io import interfaces
from impact_observer.ros.live_intake import LiveIntake
from impact_observer.ros.message_classes import ros_messages
from impact_observer.stamps import NS_PER_S


def test_a_pulse_ahead_of_a_late_clock_is_given_when_the_clock_has_come() -> None:
    """Every early pulse is reported; no pulse counts as invalid."""
    now, pulses, lines = [10 * NS_PER_S], list[int](), list[str]()
    node = SimpleNamespace(create_subscription=lambda *_, **__: None)
    intake = LiveIntake(
        node,
        None,
        now=lambda: now[0],
        future=1.0,
        on_problem=lines.append,
        on_samples=lambda _: None,
        on_pulse=pulses.append,
    )
    messages = [Header(stamp=ros_messages().time(s * NS_PER_S)) for s in (10, 12, 13)]
    intake.take_messages(interfaces.PHASE_REFERENCE, messages)
    assert pulses == [10 * NS_PER_S]
    early = "phase_reference: stamped {}.000 s after the clock; future allows 1 s, and it waits"
    assert lines == [early.format(2), early.format(3)]
    now[0] = 11 * NS_PER_S
    intake.take_what_was_ahead()
    assert pulses == [10 * NS_PER_S, 12 * NS_PER_S]
    intake.clear()
    now[0] = 20 * NS_PER_S
    intake.take_what_was_ahead()
    assert len(pulses) == 2
    assert intake.counts == {"samples": 3}
