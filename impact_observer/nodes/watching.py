"""Listening to the topics of the ROS graph as they appear."""

import time
from collections.abc import Callable
from functools import partial
from itertools import islice

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.subscription import Subscription

from impact_observer.bag.interfaces import Quality, usual_quality
from impact_observer.nodes.glance import Glance
from impact_observer.nodes.listening import Listening
from impact_observer.nodes.messages import message_class
from impact_observer.nodes.quality import offered_quality, qos_profile
from impact_observer.nodes.session import Stop, ros_node

_DISCOVERY_PERIOD = 0.25
"""How often the graph is looked at for new topics, s."""
_BURST = 2000
"""Messages a topic may be ahead of us."""
_PATIENCE = 0.05
"""How long a key may go unnoticed, s."""
_SERIALIZED = True


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
            depth = usual_quality(topic).depth
            offers = [offered_quality(each.qos_profile, depth) for each in publishers]
            offer = Quality.common(offers)
            quality = Quality(offer.reliable, offer.transient_local, depth=_BURST)
            self._subscriptions[topic] = self._node.create_subscription(
                message_class(types[0]),
                topic,
                partial(self._take, topic),
                qos_profile(quality),
                raw=True,
            )

    def _take(self, topic: str, data: bytes) -> None:
        """Hand on a message that the executor brings, and at once those that wait behind it."""
        self._hear(topic, data)
        subscription = self._subscriptions[topic]
        with subscription.handle:
            take = partial(subscription.handle.take_message, subscription.msg_type, _SERIALIZED)
            for data_behind, _ in islice(iter(take, None), _BURST):
                self._hear(topic, data_behind)

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
