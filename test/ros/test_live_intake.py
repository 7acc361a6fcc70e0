# SPDX-License-Identifier: Apache-2.0
"""Live samples and pulses in a node, without an executor."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")

from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from impact_observer.io import interfaces
from impact_observer.io.live_inputs import efforts_on
from impact_observer.model.measurement import read_measurements
from impact_observer.observer import Options, make_observer
from impact_observer.ros.live_intake import LiveIntake
from impact_observer.ros.topics import ros_messages
from impact_observer.stamps import NS_PER_S


def stub() -> Any:  # noqa: ANN401 (stands for a node)
    """A node that receives nothing."""
    return SimpleNamespace(
        create_subscription=lambda *_, **__: None,
        resolve_topic_name=lambda name: name,
        values=SimpleNamespace(integer=lambda _: 100),
    )


def test_a_pulse_ahead_of_a_late_clock_is_given_when_the_clock_has_come() -> None:
    """Every early pulse is reported; no pulse counts as invalid."""
    now, pulses, lines = [10 * NS_PER_S], list[int](), list[str]()
    node = stub()
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


def test_efforts_of_a_robot_are_read_from_a_topic_with_others() -> None:
    """Other joints and their numbers are left out; a message without efforts is reported."""
    pytest.importorskip("pinocchio", reason="not installed: extra robots")
    sensors = read_measurements("hammer_arm")
    options = Options("minimum-variance", epoch=NS_PER_S)
    live = make_observer("hammer_arm", options, measurements=sensors).live
    assert live is not None
    lines, told, efforts = list[str](), list[int](), efforts_on("/arm/joint_states")
    node = stub()
    intake = LiveIntake(
        node,
        live,
        now=lambda: 2 * NS_PER_S,
        future=1.0,
        on_problem=lines.append,
        on_samples=told.append,
        efforts=efforts,
    )
    message = JointState(name=["gripper", "elbow", "shoulder"], effort=[float("nan"), 1.5, -0.5])
    message.header.stamp = ros_messages().time(NS_PER_S + 1)
    intake.take_messages(efforts, [message])
    assert told == [NS_PER_S + 1]
    assert intake.ages(NS_PER_S + 1) == {"shoulder": 0.0, "elbow": 0.0}
    live.follow(NS_PER_S)
    np.testing.assert_array_equal(live.samples.force[-1], [-0.5, 1.5])
    intake.take_efforts([JointState(header=message.header, name=["elbow"])])
    assert lines == [
        f"{efforts.name}: JointState.effort: 0 numbers for 1 names; expected one each"
    ]
    assert len(told) == 1
