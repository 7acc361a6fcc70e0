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
from impact_observer.io.live_inputs import read_pulse
from impact_observer.model.measurements_file import read_measurements
from impact_observer.observer import Options, make_observer
from impact_observer.ros.intake import Receiver
from impact_observer.ros.sample_intake import SampleIntake, ages
from impact_observer.ros.topics import ros_messages
from impact_observer.stamps import NS_PER_S


class Waiting(nullcontext[None]):
    """Stands for the handle of a subscription with some messages."""

    def __init__(self, messages: list[bytes]) -> None:
        super().__init__()
        self.messages = messages

    def take_message(self, *_: object) -> tuple[bytes, dict[str, int]] | None:
        """Take the first message."""
        return (self.messages.pop(0), {}) if self.messages else None


class Inbox:
    """Stands for a node: ``send`` puts a message into a topic.

    Attributes:
        now: the time, ns.
        told: what was logged and noted.
        receivers: as of a node.
        values: of parameters.
    """

    def __init__(self, now: int, type_name: str) -> None:
        self.now = now
        self.told: list[str] = []
        self.lines = SimpleNamespace(error=self.told.append)
        self.receivers: list[Receiver[Any]] = []
        self.values = {"future": 1.0, "max_message": 1000, "history": 10.0}
        self._type = type_name
        self._waiting: dict[str, list[bytes]] = {}

    def send(self, topic: str, message: object) -> None:
        """Let a message wait on a topic."""
        self._waiting[topic].append(serialize_message(message))

    def stamp_now(self) -> int:
        """The time, ns."""
        return self.now

    def note(self, _: str, line: str) -> None:
        """Keep a line."""
        self.told.append(line)

    def resolve_topic_name(self, name: str) -> str:
        """The name itself."""
        return name

    def get_publishers_info_by_topic(self, _: str) -> list[object]:
        """One publisher of each topic."""
        return [SimpleNamespace(topic_type=self._type, qos_profile=QoSProfile(depth=1))]

    def create_subscription(self, kind: type, topic: str, *_: object, **__: object) -> object:
        """A subscription with the messages that are sent."""
        handle = Waiting(self._waiting.setdefault(topic, []))
        return SimpleNamespace(handle=handle, msg_type=kind, raw=True)


def test_a_pulse_ahead_of_a_late_clock_is_given_when_the_clock_has_come() -> None:
    """Every early pulse is reported; one that is none is refused."""
    node: Any = Inbox(10 * NS_PER_S, interfaces.HEADER)
    pulses, interface = list[int](), interfaces.PHASE_REFERENCE
    receiver = Receiver(
        node,
        interface,
        pulses.extend,
        read=lambda message, _: [read_pulse(message)],
        stamp=int,
    )
    for second in (10, 12, 13):
        node.send(interface.name, Header(stamp=ros_messages().time(second * NS_PER_S)))
    receiver.take_arrived()
    assert pulses == [10 * NS_PER_S]
    early = "phase_reference: stamped {}.000 s after the clock; future allows 1 s, and it waits"
    assert node.told == [early.format(2), early.format(3)]
    node.now = 11 * NS_PER_S
    receiver.take_arrived()
    assert pulses == [10 * NS_PER_S, 12 * NS_PER_S]
    receiver.clear()
    node.now = 20 * NS_PER_S
    node.send(interface.name, Header())
    receiver.take_arrived()
    assert len(pulses) == 2
    assert "Header.stamp" in node.told[-1]


def test_efforts_of_a_robot_are_read_from_a_topic_with_its_encoders() -> None:
    """Other joints and their numbers are left out; a message without efforts is reported."""
    pytest.importorskip("pinocchio", reason="not installed: extra robots")
    sensors = read_measurements("hammer_arm")
    options = Options("minimum-variance", epoch=NS_PER_S)
    observer = make_observer("hammer_arm", options, measurements=sensors)
    live = observer.live
    assert live is not None
    node: Any = Inbox(2 * NS_PER_S, interfaces.JOINT_STATE)
    told = list[int]()
    intake = SampleIntake(node, observer, lambda since, _: told.append(since))
    (topic,) = intake.topics
    for each in node.receivers:
        each.follow()
    message = JointState(name=["gripper", "elbow", "shoulder"], effort=[float("nan"), 1.5, -0.5])
    message.position = [0.0, 0.5, 0.25]
    message.header.stamp = ros_messages().time(NS_PER_S + 1)
    node.send(topic, message)
    intake.take_arrived()
    assert told == [NS_PER_S + 1]
    assert ages(live, NS_PER_S + 1) == {"shoulder": 0.0, "elbow": 0.0}
    assert live.samples.force[-1].tolist() == [-0.5, 1.5]
    assert intake.without_sample() == ()
    without = JointState(header=message.header, name=["elbow"], position=[0.5])
    node.send(topic, without)
    intake.take_arrived()
    line = f"{topic}: JointState.effort: 0 numbers for 1 names; expected one each"
    assert line in node.told
    assert intake.counts == {"samples": 2, "invalid samples": 1}
    assert observer.samples.counts[1]["samples"] == 2, "its position is used"
