# SPDX-License-Identifier: Apache-2.0
"""Receiving the topics of the ROS graph as they appear."""

import time
from collections.abc import Callable
from dataclasses import replace

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.subscription import Subscription

from impact_observer.process_end import Stop
from impact_observer.ros.message_classes import message_class
from impact_observer.ros.session import ros_node, spin_once
from impact_observer.ros.subscribing import common_offer, subscribe_raw
from impact_observer.ros.watch.snapshot import Snapshot
from impact_observer.ros.watch.topic_listener import TopicListener

_DISCOVERY_PERIOD = 0.25
"""How often the graph is searched for new topics, s."""
_DEPTH = 2000
"""Messages of a topic that may wait to be read."""
_KEY_PERIOD = 0.05
"""Longest time until a key is noticed, s."""


class Watcher:
    """Hands the serialized messages of wanted topics to a :class:`TopicListener`.

    A topic is subscribed to when its first publisher appears, with the quality of service that
    all its publishers offer, so that earlier events and the model are received too.
    """

    def __init__(self, node: Node, listener: TopicListener) -> None:
        """Subscribe with ``node``, which the caller spins."""
        self._node = node
        self._listener = listener
        self._subscriptions: dict[str, Subscription] = {}
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(_DISCOVERY_PERIOD, self.discover, clock=steady)
        self.discover()

    def discover(self) -> None:
        """Subscribe to the topics that have appeared since the last call; count publishers."""
        for topic in self._subscriptions:
            self._listener.note_publishers(topic, self._node.count_publishers(topic))
        for topic, types in self._node.get_topic_names_and_types():
            if topic in self._subscriptions or not self._listener.wants(topic, types[0]):
                continue
            publishers = self._node.get_publishers_info_by_topic(topic)
            if not publishers:
                continue
            quality = replace(common_offer(topic, publishers), depth=_DEPTH)
            self._subscriptions[topic] = subscribe_raw(
                self._node, topic, message_class(types[0]), quality, self._on_message
            )

    def _on_message(self, topic: str, data: bytes) -> None:
        self._listener.receive(topic, data, time.monotonic(), time.time_ns())


def watch(
    listener: TopicListener,
    show: Callable[[Snapshot], None],
    *,
    rate: float,
    keep_on: Callable[[], bool],
    duration: float | None = None,
) -> None:
    """Receive until SIGINT, SIGTERM, the end of ``duration``, or ``keep_on`` is false.

    Args:
        listener: receives the messages.
        show: called with each snapshot, and once more at the end.
        rate: of snapshots, Hz.
        keep_on: called at least ten times a second; watching ends when it returns False.
        duration: how long, s of wall time; None for no end.
    """
    with Stop() as stop, ros_node("watch") as (node, executor):
        Watcher(node, listener)
        begin = due = time.monotonic()
        while not stop.requested and keep_on():
            now = time.monotonic()
            if duration is not None and now > begin + duration:
                break
            if now >= due:
                due = now + 1.0 / rate
                show(listener.snapshot(now, time.time_ns()))
            spin_once(executor, node, min(max(due - now, 0.0), _KEY_PERIOD))
        show(listener.snapshot(time.monotonic(), time.time_ns()))
