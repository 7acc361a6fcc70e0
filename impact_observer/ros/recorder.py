# SPDX-License-Identifier: Apache-2.0
"""Recording topics of the ROS graph into a bag, as ``ros2 bag record`` does."""

import time
from collections.abc import Callable, Collection
from dataclasses import replace
from operator import itemgetter
from pathlib import Path

from rclpy.node import Node
from rclpy.subscription import Subscription

from impact_observer.errors import ImpactObserverError, UsageError
from impact_observer.io.interfaces import Quality
from impact_observer.io.typestores import installed_definition, typestore
from impact_observer.io.writer import BagWriter
from impact_observer.plain_text import printable
from impact_observer.process_end import Stop
from impact_observer.ros.session import ros_node
from impact_observer.ros.topics import (
    PolledGroup,
    common_offer,
    message_class,
    qos_profile,
    waiting_messages,
)

_PERIOD = 0.01
"""How often messages are taken, s; log times are those of their arrival."""
_DISCOVERY_PERIOD = 0.1
"""How often the graph is searched for new topics, s."""
_CHUNK_PERIOD = 0.8
"""How often the chunk of the bag is closed, s: a killed recorder loses less than a second."""
_DEPTH = 5000
"""Messages of a topic that may wait; more than any publisher of this package keeps."""
_DRAIN, _LONGEST_DRAIN = 0.05, 1.0
"""Time without messages before a stopped recording is closed, and the longest until then, s."""


class Recorder:
    """Writes the messages of topics, as serialized, to a bag at each call of ``take``.

    A topic is subscribed to when its first publisher appears, with the quality of service that
    all its publishers offer, so that latched messages and earlier events are recorded too. Log
    times are those of arrival, under simulated time those of ``/clock``, and never go back.

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
        """Record with ``node``, which need not be spun, into ``writer``, an open bag.

        Args:
            node: subscribes.
            writer: the caller closes the bag.
            topics: only these topics; None for every topic that appears, without hidden ones.
            on_topic: called with name and type of each topic that is recorded.

        Raises:
            UsageError: a topic's name is invalid.
        """
        self.counts: dict[str, int] = {}
        self._node, self._writer, self._on_topic = node, writer, on_topic
        self._wanted = None if topics is None else {resolved(node, topic) for topic in topics}
        self._offers: dict[str, Quality] = {}
        self._subscriptions: dict[str, Subscription] = {}
        self._last = 0
        self._searched = self._flushed = 0.0

    @property
    def missing(self) -> list[str]:
        """Requested topics that have not appeared."""
        return sorted((self._wanted or set()) - self._offers.keys())

    def is_connected(self, topic: str) -> bool:
        """Whether a publisher of ``topic`` is connected."""
        subscription = self._subscriptions.get(self._node.resolve_topic_name(topic))
        return subscription is not None and subscription.get_publisher_count() > 0

    def take(self) -> bool:
        """Write what has arrived since the last call; whether anything has."""
        now = time.monotonic()
        if now > self._searched + _DISCOVERY_PERIOD:
            self._searched = now
            self._discover()
        arrived = [
            (info["received_timestamp"], topic, data)
            for topic, subscription in self._subscriptions.items()
            for data, info in waiting_messages(subscription, _DEPTH)
        ]
        clock = self._node.get_clock()
        for at, topic, data in sorted(arrived, key=itemgetter(0)):
            stamp = clock.now().nanoseconds if clock.ros_time_is_active else at
            self._last = max(self._last, stamp)
            self._writer.write_raw(topic, self._last, data)
            self.counts[topic] += 1
        if now > self._flushed + _CHUNK_PERIOD:
            self._flushed = now
            self._writer.flush()
        return bool(arrived)

    def drain(self) -> None:
        """Take messages until none has arrived for a moment."""
        silent_since = time.monotonic()
        latest = silent_since + _LONGEST_DRAIN
        while time.monotonic() < min(latest, silent_since + _DRAIN):
            if self.take():
                silent_since = time.monotonic()
            time.sleep(_PERIOD)

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
            before = self._offers.setdefault(topic, offer)
            if before is offer:
                self._subscribe(topic, publishers[0].topic_type, offer)
            elif topic in self._subscriptions and (
                before.reliable > offer.reliable or before.transient_local > offer.transient_local
            ):
                self._offers[topic] = offer
                self._warn(
                    f"{topic} has a new publisher that is less reliable or durable than the first;"
                    " its messages are not recorded"
                )

    def _subscribe(self, topic: str, type_name: str, offer: Quality) -> None:
        """Record a topic from now on, or warn why it cannot be recorded."""
        is_standard = type_name in typestore().fielddefs
        definition = "" if is_standard else installed_definition(type_name)
        try:
            if definition is None:
                raise UsageError(f"the definition of {type_name} is not installed")
            message_type = message_class(type_name)
            self._writer.declare(topic, type_name=type_name, quality=offer, definition=definition)
        except ImpactObserverError as error:
            self._warn(f"{topic} is not recorded: {error}")
            return
        self.counts[topic] = 0
        profile = qos_profile(replace(offer, depth=_DEPTH))
        self._subscriptions[topic] = self._node.create_subscription(
            message_type, topic, lambda _: None, profile, callback_group=PolledGroup(), raw=True
        )
        self._on_topic(topic, type_name)

    def _warn(self, line: str) -> None:
        self._node.get_logger().warning(printable(line))


def record(
    path: Path,
    topics: Collection[str] | None = None,
    *,
    duration: float = float("inf"),
    on_topic: Callable[[str, str], object] = lambda _topic, _type: None,
    on_progress: Callable[[int, float], object] = lambda _count, _passed: None,
) -> dict[str, int | None]:
    """Record a bag until SIGINT, SIGTERM or the end of ``duration``, s of wall time.

    Messages published before the end are still recorded.

    Args:
        path: the folder to create.
        topics: only these topics; None for every topic that appears.
        duration: how long.
        on_topic: called with name and type of each topic that is recorded.
        on_progress: called with the number of messages and the seconds passed.

    Returns:
        The number of messages by topic; None for a requested topic that never appeared.

    Raises:
        UsageError: ``path`` exists already, or a topic's name is invalid. Then no bag is created.
        BagError: the bag cannot be written.
    """
    with Stop() as stop, ros_node("recorder") as (node, _):
        for topic in topics or ():
            resolved(node, topic)  # before the bag is made
        with BagWriter(path) as writer:
            recorder = Recorder(node, writer, topics, on_topic=on_topic)
            begin = time.monotonic()
            while not stop.requested and (passed := time.monotonic() - begin) < duration:
                recorder.take()
                on_progress(writer.message_count, passed)
                time.sleep(_PERIOD)
            recorder.drain()
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
