# SPDX-License-Identifier: Apache-2.0
"""Publishes events and receives estimates, in the process of the benchmark."""

import random
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from impact_observer_msgs.msg import ImpactEvent, ObserverState
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState

from benchmarks.harness import DisagreementError
from impact_observer.events import ImpactEvent as Event
from impact_observer.events import Switch
from impact_observer.io.interfaces import EVENTS, STATES
from impact_observer.ros.message_classes import ros_messages
from impact_observer.ros.qos import qos_profile
from impact_observer.stamps import NS_PER_S

PATIENCE = 10.0
"""How long an answer may take, s."""
WARM = 1.0
"""Time of estimates before the first event that is measured, s."""
PAUSES = (0.005, 0.015)
"""Between an answer and the next event, s."""


class Driver:
    """Publishes events and waits for the estimates that contain them."""

    def __init__(self, context: Context, late: int) -> None:
        """Join a domain.

        Args:
            context: of ROS.
            late: how long ago the instants of events are when they are published, ns.
        """
        self._node = Node("driver", context=context)
        # The joint states need a subscriber too; what it receives is not used.
        self._beside = Node("beside", context=context)
        self._late = late
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self._node)
        self._impacts = self._node.create_publisher(ImpactEvent, "impacts", qos_profile(EVENTS))
        state, joints = "observer/state", "observer/joint_states"
        self._node.create_subscription(ObserverState, state, self._receive, qos_profile(STATES))
        self._beside.create_subscription(JointState, joints, print, qos_profile(STATES))
        self._make = ros_messages()
        self._pauses = random.Random(1)
        self._epoch = time.time_ns() - NS_PER_S
        self._sent = self._received = 0
        self._arrived = 0.0

    def meet(self) -> None:
        """Wait for the other side, and let it publish for a while."""
        self._until(self._impacts.get_subscription_count)
        self.trip()
        self._spin(WARM)

    def trip(self) -> float:
        """Time from an event to the estimate that contains it, s."""
        self._spin(self._pauses.uniform(*PAUSES))
        self._sent += 1
        stamp = time.time_ns() - self._late
        event = Event(stamp, (Switch("stop"),), self._sent, epoch=self._epoch)
        message = self._make.event(event)
        begin = time.perf_counter()
        self._impacts.publish(message)
        self._until(lambda: self._received >= self._sent)
        return self._arrived - begin

    def close(self) -> None:
        """Leave the domain."""
        self._executor.shutdown()
        for node in (self._node, self._beside):
            node.destroy_node()

    def _receive(self, message: ObserverState) -> None:
        if message.last_sequence > self._received:
            self._arrived = time.perf_counter()
            self._received = message.last_sequence

    def _spin(self, seconds: float) -> None:
        end = time.perf_counter() + seconds
        while (left := end - time.perf_counter()) > 0:
            self._executor.spin_once(left)

    def _until(self, condition: Callable[[], object]) -> None:
        end = time.perf_counter() + PATIENCE
        while not condition():
            if time.perf_counter() > end:
                raise DisagreementError(f"no answer to event {self._sent} in {PATIENCE:g} s")
            self._executor.spin_once(0.05)


@contextmanager
def driving(late: int) -> Iterator[Driver]:
    """A driver connected to the other side, in the ROS domain of the environment."""
    context = Context()
    context.init(args=[])
    try:
        driver = Driver(context, late)
        try:
            driver.meet()
            yield driver
        finally:
            driver.close()
    finally:
        context.try_shutdown()
