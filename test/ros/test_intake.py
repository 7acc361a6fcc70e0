# SPDX-License-Identifier: Apache-2.0
"""What a node takes in of messages that have arrived, without an executor."""

from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy")

from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from impact_observer.io import interfaces
from impact_observer.io.messages import read_pulse
from impact_observer.model.measurement import read_measurements
from impact_observer.observer import Options, make_observer
from impact_observer.ros.intake import Receiver
from impact_observer.ros.sample_intake import SampleIntake, ages
from impact_observer.ros.topics import ros_messages
from impact_observer.stamps import NS_PER_S


class Inbox(nullcontext[None]):
    """Stands for the handle of a subscription, with messages that have arrived."""

    def __init__(self) -> None:
        super().__init__()
        self.messages: list[bytes] = []

    def take_message(self, *_: object) -> tuple[bytes, dict[str, int]] | None:
        """Take the first message."""
        return (self.messages.pop(0), {}) if self.messages else None


def node_of(inbox: Inbox, type_name: str, clock: list[int], told: list[str]) -> Any:  # noqa: ANN401
    """Stands for a node with a publisher of a type, and with a clock (ns)."""
    publisher = SimpleNamespace(topic_type=type_name, qos_profile=QoSProfile(depth=1))
    subscription = SimpleNamespace(handle=inbox, msg_type=None, raw=True)
    return SimpleNamespace(
        receivers=[],
        values={"future": 1.0, "max_message": 1000, "history": 10.0},
        lines=SimpleNamespace(error=told.append),
        note=lambda _, line: told.append(line),
        stamp_now=lambda: clock[0],
        resolve_topic_name=lambda name: name,
        create_subscription=lambda *_, **__: subscription,
        get_publishers_info_by_topic=lambda _: [publisher],
    )


def test_a_pulse_ahead_of_a_late_clock_is_given_when_the_clock_has_come() -> None:
    """Every early pulse is reported; one that is none is refused."""
    inbox, clock, told, pulses = Inbox(), [10 * NS_PER_S], list[str](), list[int]()
    receiver = Receiver(
        node_of(inbox, interfaces.HEADER, clock, told),
        interfaces.PHASE_REFERENCE,
        pulses.extend,
        read=lambda message, _: [read_pulse(message)],
        stamp=int,
    )
    for second in (10, 12, 13):
        pulse = Header(stamp=ros_messages().time(second * NS_PER_S))
        inbox.messages.append(serialize_message(pulse))
    receiver.take_arrived()
    assert pulses == [10 * NS_PER_S]
    early = "phase_reference: stamped {}.000 s after the clock; future allows 1 s, and it waits"
    assert told == [early.format(2), early.format(3)]
    clock[0] = 11 * NS_PER_S
    receiver.take_arrived()
    assert pulses == [10 * NS_PER_S, 12 * NS_PER_S]
    receiver.clear()
    clock[0] = 20 * NS_PER_S
    inbox.messages.append(serialize_message(Header()))
    receiver.take_arrived()
    assert len(pulses) == 2
    assert "Header.stamp" in told[-1]


def test_efforts_of_a_robot_are_read_from_a_topic_with_its_encoders() -> None:
    """Other joints and their numbers are left out; a message without efforts is reported."""
    pytest.importorskip("pinocchio", reason="not installed: extra robots")
    sensors = read_measurements("hammer_arm")
    options = Options("minimum-variance", epoch=NS_PER_S)
    observer = make_observer("hammer_arm", options, measurements=sensors)
    live = observer.live
    assert live is not None
    inbox, told, changed = Inbox(), list[str](), list[int]()
    node = node_of(inbox, interfaces.JOINT_STATE, [2 * NS_PER_S], told)
    intake = SampleIntake(node, observer, lambda since, _: changed.append(since))
    node.receivers[0].follow()  # that of the encoders; another one has the efforts
    message = JointState(name=["gripper", "elbow", "shoulder"], effort=[float("nan"), 1.5, -0.5])
    message.position = [0.0, 0.5, 0.25]
    message.header.stamp = ros_messages().time(NS_PER_S + 1)

    def take() -> None:
        """Let each receiver take the message."""
        data = serialize_message(message)
        for each in node.receivers[::-1]:
            inbox.messages.append(data)
            each.take_arrived()

    take()
    assert changed == [NS_PER_S + 1, NS_PER_S + 1]
    assert ages(live, NS_PER_S + 1) == {"shoulder": 0.0, "elbow": 0.0}
    assert live.samples.force[-1].tolist() == [-0.5, 1.5]
    assert intake.without_sample() == ()
    message.effort = []
    take()
    line = f"{intake.topics[0]}: JointState.effort: 0 numbers for 3 names; expected one each"
    assert line in told
    assert intake.counts == {"samples": 2, "invalid samples": 1}
    assert observer.samples.counts[1]["samples"] == 2, "its position is used"
