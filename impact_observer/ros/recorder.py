# SPDX-License-Identifier: Apache-2.0
"""Recording topics of the ROS graph into a bag, as ``ros2 bag record`` does."""

import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from impact_observer.errors import ImpactObserverError, UsageError
from impact_observer.io.interfaces import Quality
from impact_observer.io.typestores import installed_definition, typestore
from impact_observer.io.writer import FLUSH, BagWriter
from impact_observer.plain_text import printable
from impact_observer.process_end import Stop
from impact_observer.ros.message_classes import message_class
from impact_observer.ros.session import ros_node, spin_once
from impact_observer.ros.subscribing import common_offer, subscribe_raw

_DISCOVERY_PERIOD = 0.1
"""How often the graph is searched for new topics, s."""
_DEPTH = 5000
"""Messages of a topic that may wait; more than any publisher of this package keeps."""
_DRAIN = 0.05
"""Time without messages before a stopped recording is closed, s."""
_LONGEST_DRAIN = 1.0
"""Longest time until a stopped recording is closed, s."""


@dataclass(frozen=True, slots=True)
class RecordedTopics:
    """The topics of a recording.

    Attributes:
        counts: messages by topic; 0 for a topic without messages.
        missing: requested topics that never appeared.
    """

    counts: Mapping[str, int]
    missing: tuple[str, ...]


class Recorder:
    """Writes the messages of topics, as serialized, to a bag while its node is spun.

    A topic is subscribed to when its first publisher appears, with the quality of service that
    all its publishers offer, so that latched messages and earlier events are recorded too. The
    log time is the node's clock, which may be simulated; log times never go back.

    Attributes:
        counts: messages recorded, by topic; 0 for a topic without messages so far.
    """

    def __init__(
        self,
        node: Node,
        writer: BagWriter,
        topics: Collection[str] | None = None,
        *,
        on_topic: Callable[[str, str], None] = lambda _topic, _type: None,
    ) -> None:
        """Record with ``node`` into ``writer``.

        Args:
            node: subscribes; the caller spins the node.
            writer: an open bag; the caller closes the bag, after :meth:`close`.
            topics: only these topics; None for every topic that appears, without hidden ones.
            on_topic: called with name and type of each topic that is recorded.
        """
        self.counts: dict[str, int] = {}
        self._node = node
        self._writer = writer
        self._wanted = None if topics is None else {resolved(node, topic) for topic in topics}
        self._on_topic = on_topic
        self._requested: dict[str, Quality] = {}
        self._refused: set[str] = set()
        self._subscriptions: dict[str, Subscription] = {}
        self._last = 0
        self._waiting: list[tuple[str, bytes]] = []
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(_DISCOVERY_PERIOD, self._discover, clock=steady)

    @property
    def missing(self) -> list[str]:
        """Requested topics that have not appeared."""
        return sorted((self._wanted or set()) - self.counts.keys() - self._refused)

    def is_connected(self, topic: str) -> bool:
        """Whether a publisher of ``topic`` is connected."""
        subscription = self._subscriptions.get(self._node.resolve_topic_name(topic))
        return subscription is not None and subscription.get_publisher_count() > 0

    def close(self) -> None:
        """Unsubscribe from everything."""
        if self._waiting:
            self._node.get_logger().warning(
                printable(f"{len(self._waiting)} messages are not recorded: /clock never ran")
            )
        self._node.destroy_timer(self._timer)
        for subscription in self._subscriptions.values():
            self._node.destroy_subscription(subscription)
        self._subscriptions.clear()

    def _discover(self) -> None:
        """Subscribe to the topics that have appeared since the last call."""
        for topic, _ in self._node.get_topic_names_and_types():
            if self._is_wanted(topic) and (publishers := self._publishers(topic)):
                offer = common_offer(topic, publishers)
                if topic in self.counts:
                    self._check(topic, offer)
                else:
                    self._subscribe(topic, publishers[0].topic_type, offer)

    def _is_wanted(self, topic: str) -> bool:
        """Whether a topic is to be recorded."""
        if topic in self._refused:
            return False
        if self._wanted is not None:
            return topic in self._wanted
        return not any(part.startswith("_") for part in topic.split("/"))

    def _publishers(self, topic: str) -> list[TopicEndpointInfo]:
        """The publishers of a topic, other than this node itself."""
        own = (self._node.get_name(), self._node.get_namespace())
        return [
            publisher
            for publisher in self._node.get_publishers_info_by_topic(topic)
            if (publisher.node_name, publisher.node_namespace) != own
        ]

    def _subscribe(self, topic: str, type_name: str, offer: Quality) -> None:
        """Record a topic from now on, or warn once why it cannot be recorded."""
        is_standard = type_name in typestore().fielddefs
        definition = "" if is_standard else installed_definition(type_name)
        try:
            if definition is None:
                raise UsageError(f"the definition of {type_name} is not installed")
            message_type = message_class(type_name)
            self._writer.declare(topic, type_name=type_name, quality=offer, definition=definition)
        except ImpactObserverError as error:
            self._refused.add(topic)
            self._node.get_logger().warning(printable(f"{topic} is not recorded: {error}"))
            return
        self.counts[topic] = 0
        self._requested[topic] = offer
        quality = replace(offer, depth=_DEPTH)
        self._subscriptions[topic] = subscribe_raw(
            self._node, topic, message_type, quality, self._write
        )
        self._on_topic(topic, type_name)

    def _check(self, topic: str, offer: Quality) -> None:
        """Warn once that a later publisher offers less than was requested."""
        requested = self._requested[topic]
        if (requested.reliable, requested.transient_local) != (
            requested.reliable and offer.reliable,
            requested.transient_local and offer.transient_local,
        ):
            self._requested[topic] = offer
            self._node.get_logger().warning(
                printable(
                    f"{topic} has a new publisher that is less reliable or durable than the first;"
                    " its messages are not recorded"
                )
            )

    def _write(self, topic: str, data: bytes) -> None:
        """Write a message; before simulated time runs, messages wait for its first instant."""
        self._waiting.append((topic, data))
        if (now := self._node.get_clock().now().nanoseconds) == 0:
            return
        self._last = max(self._last, now)
        for name, message in self._waiting:
            self._writer.write_raw(name, self._last, message)
            self.counts[name] += 1
        self._waiting.clear()


def record(
    path: Path | str,
    topics: Collection[str] | None = None,
    *,
    use_sim_time: bool = False,
    duration: float | None = None,
    compressed: bool = False,
    flush: float = FLUSH,
    on_topic: Callable[[str, str], None] = lambda _topic, _type: None,
    on_progress: Callable[[int, float], None] = lambda _count, _passed: None,
) -> RecordedTopics:
    """Record a bag until SIGINT, SIGTERM or the end of ``duration``.

    Messages published before the end are still recorded.

    Args:
        path: the folder to create.
        topics: only these topics; None for every topic that appears.
        use_sim_time: whether log times follow ``/clock``.
        duration: how long, s of wall time; None for until a signal.
        compressed: whether the messages are compressed.
        flush: longest time until a message is on the disk, s.
        on_topic: called with name and type of each topic that is recorded.
        on_progress: called with the number of messages and the seconds passed, about ten times
            a second.

    Returns:
        The topics with their counts, and the missing ones.

    Raises:
        UsageError: ``path`` exists already, a topic's name is invalid, or the duration is not
            positive. Then no bag is created.
        BagError: the bag cannot be written.
    """
    if duration is not None and not 0 < duration < float("inf"):
        raise UsageError(f"duration is {duration}; expected a positive number of seconds")
    with Stop() as stop, ros_node("recorder", use_sim_time=use_sim_time) as (node, executor):
        for topic in topics or ():
            resolved(node, topic)  # before the bag is made
        with BagWriter(path, compressed=compressed, flush=flush) as writer:
            recorder = Recorder(node, writer, topics, on_topic=on_topic)
            begin = shown = time.monotonic()
            while not stop.requested and (duration is None or time.monotonic() < begin + duration):
                spin_once(executor, node, _DISCOVERY_PERIOD)
                if time.monotonic() > shown + _DISCOVERY_PERIOD:
                    shown = time.monotonic()
                    on_progress(writer.message_count, shown - begin)
            drain(executor, writer)
            recorder.close()
            return RecordedTopics(recorder.counts, tuple(recorder.missing))


def resolved(node: Node, topic: str) -> str:
    """The absolute name of a topic, resolved by a node.

    Raises:
        UsageError: the name is invalid.
    """
    try:
        return str(node.resolve_topic_name(topic))
    except Exception as error:  # noqa: BLE001 (rclpy's own class has no public name)
        reason = str(error).partition(", at ")[0].removeprefix("failed to resolve name: ")
        raise UsageError(f"topic {topic!r}: {reason}") from None


def drain(executor: SingleThreadedExecutor, writer: BagWriter) -> None:
    """Spin until no message has arrived for a moment."""
    latest = silent_since = time.monotonic()
    latest += _LONGEST_DRAIN
    while time.monotonic() < min(latest, silent_since + _DRAIN):
        before = writer.message_count
        executor.spin_once(timeout_sec=_DRAIN)
        if writer.message_count > before:
            silent_since = time.monotonic()
