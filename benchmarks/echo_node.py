# SPDX-License-Identifier: Apache-2.0
"""A minimal node in Python that answers impacts with estimates, without an observer.

    python -m benchmarks.echo_node --ros-args -p rate:=1000.0

It has the topics and the quality of service of the observer node, and catches up on as many missed
estimates. Its messages are made once and changed in place.
"""

import rclpy
from builtin_interfaces.msg import Time
from impact_observer_msgs.msg import EventVerdict, ImpactEvent, ObserverState
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState

from impact_observer.io.interfaces import EVENTS, STATES
from impact_observer.ros.topics import qos_profile
from impact_observer.stamps import NS_PER_S

NAMES = ("x1", "x2")
MOST_AT_ONCE = 8
"""Missed estimates that an observer node catches up on."""


class EchoNode(Node):  # type: ignore[misc]
    """Publishes one state again and again, with the last event's number and stamp in it."""

    def __init__(self) -> None:
        super().__init__("observer")
        self._rate = self.declare_parameter("rate", 1000.0).value
        self._last = 0
        zeros = [0.0] * len(NAMES)
        self._state = ObserverState(law="echo", name=NAMES, position=zeros, velocity=zeros)
        self._joints = JointState(name=NAMES, position=zeros, velocity=zeros)
        self._verdict = EventVerdict(contact="stop")
        self._states = self.create_publisher(ObserverState, "~/state", qos_profile(STATES))
        self._joint_states = self.create_publisher(
            JointState, "~/joint_states", qos_profile(STATES)
        )
        self._verdicts = self.create_publisher(EventVerdict, "~/verdicts", qos_profile(EVENTS))
        self.create_subscription(ImpactEvent, "impacts", self._on_event, qos_profile(EVENTS))
        self.create_timer(1.0 / self._rate, self._on_timer)

    def _on_event(self, event: ImpactEvent) -> None:
        self._state.last_sequence = event.sequence
        self._state.last_event = event.header.stamp
        self._publish(self._state.header.stamp)
        self._verdict.header.stamp = event.header.stamp
        self._verdict.sequence = event.sequence
        self._verdicts.publish(self._verdict)

    def _on_timer(self) -> None:
        now = self.get_clock().now().nanoseconds
        newest = int(now / NS_PER_S * self._rate)
        for k in range(max(self._last + 1, newest + 1 - MOST_AT_ONCE), newest + 1):
            seconds, nanoseconds = divmod(round(k * NS_PER_S / self._rate), NS_PER_S)
            self._publish(Time(sec=seconds, nanosec=nanoseconds))
        self._last = newest

    def _publish(self, stamp: Time) -> None:
        self._state.header.stamp = self._joints.header.stamp = stamp
        self._states.publish(self._state)
        self._joint_states.publish(self._joints)


def main() -> None:
    """Spin as the tutorials of ROS do."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # a signal ends it
    rclpy.spin(EchoNode())


if __name__ == "__main__":
    main()
