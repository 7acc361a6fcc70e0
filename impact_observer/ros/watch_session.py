"""Listening to the topics of the ROS graph as they appear."""

import time
from collections.abc import Callable
from dataclasses import replace

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.subscription import Subscription

from impact_observer.ros.message_classes import message_class
from impact_observer.ros.session import Stop, ros_node
from impact_observer.ros.snapshot import Glance
from impact_observer.ros.subscribing import common_offer, subscribe_raw
from impact_observer.ros.topic_listener import Listening

_DISCOVERY_PERIOD = 0.25
"""How often the graph is looked at for new topics, s."""
_BURST = 2000
"""Messages a topic may be ahead of us."""
_PATIENCE = 0.05
"""How long a key may go unnoticed, s."""


class Watcher:
    """Hands what is published on wanted topics, as serialized, to a :class:`Listening`.

    A topic is subscribed to when its first publisher appears, with the quality of service that
    all its publishers offer, so that earlier events and the model come too.
    """

    def __init__(self, node: Node, listening: Listening) -> None:
        """Listen with ``node``, which the caller spins."""
        self._node = node
        self._listening = listening
        self._subscriptions: dict[str, Subscription] = {}
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(_DISCOVERY_PERIOD, self.discover, clock=steady)
        self.discover()

    def discover(self) -> None:
        """Subscribe to the topics that have appeared since the last look."""
        for topic, types in self._node.get_topic_names_and_types():
            if topic in self._subscriptions or not self._listening.wants(topic, types[0]):
                continue
            publishers = self._node.get_publishers_info_by_topic(topic)
            if not publishers:
                continue
            quality = replace(common_offer(topic, publishers), depth=_BURST)
            self._subscriptions[topic] = subscribe_raw(
                self._node, topic, message_class(types[0]), quality, self._hear
            )

    def _hear(self, topic: str, data: bytes) -> None:
        self._listening.hear(topic, data, time.monotonic(), time.time_ns())


def watch(
    listening: Listening,
    show: Callable[[Glance], None],
    *,
    rate: float,
    keep_on: Callable[[], bool],
    duration: float | None = None,
) -> None:
    """Listen until SIGINT, SIGTERM, the end of ``duration`` or of patience.

    Args:
        listening: has heard nothing yet.
        show: told what there is to see, and once more at the end.
        rate: how often, Hz.
        keep_on: asked at least ten times a second; watching ends when it says no.
        duration: how long, s of wall time; None for no end.
    """
    with Stop() as stop, ros_node("watch") as (node, executor):
        Watcher(node, listening)
        begin = due = time.monotonic()
        while not stop.requested and keep_on():
            now = time.monotonic()
            if duration is not None and now > begin + duration:
                break
            if now >= due:
                due = now + 1.0 / rate
                show(listening.glance(now, time.time_ns()))
            executor.spin_once(timeout_sec=min(max(due - now, 0.0), _PATIENCE))
        show(listening.glance(time.monotonic(), time.time_ns()))
