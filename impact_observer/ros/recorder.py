# SPDX-License-Identifier: Apache-2.0
"""Recording topics of the ROS graph into a bag, as ``ros2 bag record`` does."""

import time
from collections.abc import Callable, Collection
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path

from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.subscription import Subscription

from impact_observer.errors import ImpactObserverError, UsageError
from impact_observer.io.interfaces import Quality
from impact_observer.io.typestores import installed_definition, typestore
from impact_observer.io.writer import BagWriter
from impact_observer.plain_text import printable
from impact_observer.process_end import Stop
from impact_observer.ros.session import ros_node, spin_once, warning_of
from impact_observer.ros.topics import (
    common_offer,
    message_class,
    qos_profile,
    waiting_messages,
)

_DISCOVERY_PERIOD = 0.1
"""How often the graph is searched for new topics, s."""
_CHUNK_PERIOD = 0.8
"""How often the chunk of the bag is closed, s: a killed recorder loses less than a second."""
_DEPTH = 5000
"""Messages of a topic that may wait; more than any publisher of this package keeps."""
_DRAIN = 0.05
"""Time without messages before a stopped recording is closed, s."""
_LONGEST_DRAIN = 1.0
"""Longest time until a stopped recording is closed, s."""


class Recorder:
    """Writes the messages of topics, as serialized, to a bag while its node is spun.

    A topic is subscribed to when its first publisher appears, with the quality of service that
    all its publishers offer, so that latched messages and earlier events are recorded too. Log
    times never go back.

    Attributes:
        counts: messages recorded, by topic; 0 for a topic without messages so far.
    """

    def __init__(
        self,
        node: Node,
        writer: BagWriter,
        topics: Collection[str] | None = None,
        *,
        on_topic: Callable[[str, str], object] = lambda _topic, _type: None,
    ) -> None:
        """Record with ``node`` into ``writer``.

        Args:
            node: subscribes; the caller spins the node.
            writer: an open bag; the caller closes the bag, after :meth:`close`.
            topics: only these topics; None for every topic that appears, without hidden ones.
            on_topic: called with name and type of each topic that is recorded.

        Raises:
            UsageError: a topic's name is invalid.
        """
        self.counts: dict[str, int] = {}
        self._node, self._writer, self._on_topic = node, writer, on_topic
        self._wanted = None if topics is None else {resolved(node, topic) for topic in topics}
        self._requested: dict[str, Quality | None] = {}
        self._subscriptions: dict[str, Subscription] = {}
        self._last = 0
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timers = [
            node.create_timer(_DISCOVERY_PERIOD, self._discover, clock=steady),
            node.create_timer(_CHUNK_PERIOD, writer.flush, clock=steady),
        ]

    @property
    def missing(self) -> list[str]:
        """Requested topics that have not appeared."""
        return sorted((self._wanted or set()) - self._requested.keys())

    def is_connected(self, topic: str) -> bool:
        """Whether a publisher of ``topic`` is connected."""
        subscription = self._subscriptions.get(self._node.resolve_topic_name(topic))
        return subscription is not None and subscription.get_publisher_count() > 0

    def close(self) -> None:
        """Unsubscribe from everything."""
        for timer in self._timers:
            self._node.destroy_timer(timer)
        for subscription in self._subscriptions.values():
            self._node.destroy_subscription(subscription)

    def _warn(self, line: str) -> None:
        """Log a warning."""
        self._node.get_logger().warning(printable(line))

    def _discover(self) -> None:
        """Subscribe to the topics that have appeared since the last call."""
        own = (self._node.get_name(), self._node.get_namespace())
        for topic, _ in self._node.get_topic_names_and_types():
            is_hidden = any(part.startswith("_") for part in topic.split("/"))
            if is_hidden if self._wanted is None else topic not in self._wanted:
                continue
            found = self._node.get_publishers_info_by_topic(topic)
            publishers = [each for each in found if (each.node_name, each.node_namespace) != own]
            if not publishers:
                continue
            offer = common_offer(topic, publishers)
            if topic not in self._requested:
                self._subscribe(topic, publishers[0].topic_type, offer)
            elif requested := self._requested[topic]:
                self._check(topic, requested, offer)

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
            self._requested[topic] = None
            self._warn(f"{topic} is not recorded: {error}")
            return
        self.counts[topic], self._requested[topic] = 0, offer
        self._subscriptions[topic] = self._node.create_subscription(
            message_type,
            topic,
            partial(self._write, topic),
            qos_profile(replace(offer, depth=_DEPTH)),
            raw=True,
        )
        self._on_topic(topic, type_name)

    def _check(self, topic: str, requested: Quality, offer: Quality) -> None:
        """Warn once that a later publisher offers less than was requested."""
        if (requested.reliable and not offer.reliable) or (
            requested.transient_local and not offer.transient_local
        ):
            self._requested[topic] = offer
            self._warn(
                f"{topic} has a new publisher that is less reliable or durable than the first;"
                " its messages are not recorded"
            )

    def _write(self, topic: str, data: bytes) -> None:
        """Write a message, and those that wait behind it."""
        waiting = waiting_messages(self._subscriptions[topic], _DEPTH)
        for each in chain([data], (more for more, _ in waiting)):
            self._last = max(self._last, self._node.get_clock().now().nanoseconds)
            self._writer.write_raw(topic, self._last, each)
            self.counts[topic] += 1


def record(
    path: Path | str,
    topics: Collection[str] | None = None,
    *,
    duration: float | None = None,
    on_topic: Callable[[str, str], object] = lambda _topic, _type: None,
    on_progress: Callable[[int, float], object] = lambda _count, _passed: None,
) -> dict[str, int | None]:
    """Record a bag until SIGINT, SIGTERM or the end of ``duration``.

    Messages published before the end are still recorded.

    Args:
        path: the folder to create.
        topics: only these topics; None for every topic that appears.
        duration: how long, s of wall time; None for until a signal.
        on_topic: called with name and type of each topic that is recorded.
        on_progress: called with the number of messages and the seconds passed, about ten times
            a second.

    Returns:
        The number of messages by topic; None for a requested topic that never appeared.

    Raises:
        UsageError: ``path`` exists already, a topic's name is invalid, or the duration is not
            positive. Then no bag is created.
        BagError: the bag cannot be written.
    """
    if duration is not None and not 0 < duration < float("inf"):
        raise UsageError(f"duration is {duration}; expected a positive number of seconds")
    with Stop() as stop, ros_node("recorder") as (node, executor):
        for topic in topics or ():
            resolved(node, topic)  # before the bag is made
        with BagWriter(path) as writer:
            warn = warning_of(node)
            recorder = Recorder(node, writer, topics, on_topic=on_topic)
            begin = now = shown = time.monotonic()
            while not stop.requested and (duration is None or now < begin + duration):
                spin_once(executor, warn, _DISCOVERY_PERIOD)
                if (now := time.monotonic()) > shown + _DISCOVERY_PERIOD:
                    shown = now
                    on_progress(writer.message_count, now - begin)
            drain(executor, writer)
            recorder.close()
            return {**recorder.counts, **dict.fromkeys(recorder.missing)}


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
