# SPDX-License-Identifier: Apache-2.0
"""Playing a bag to the ROS graph, as ``ros2 bag play`` does."""

import time
from collections.abc import Callable, Collection
from dataclasses import replace
from pathlib import Path

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher

from impact_observer.errors import UsageError
from impact_observer.io.interfaces import EVENTS, SIMULATED_CLOCK, usual_quality
from impact_observer.io.reader import BagReader
from impact_observer.plain_text import printable
from impact_observer.process_end import Stop
from impact_observer.ros.session import ros_node
from impact_observer.ros.topics import message_class, qos_profile, ros_messages
from impact_observer.stamps import NS_PER_S, from_seconds, seconds_between

_DELAY = 5.0
"""Longest wait for subscribers before the first message, s."""
_SETTLING_TIME = 1.0
"""Wait between the appearance of the last subscriber and the first message, s."""
_ACKNOWLEDGE = 2.0
"""Longest wait until reliable subscribers have acknowledged all messages, s."""
_LINGER = 0.5
"""How long latched messages stay available after the last message, s."""
_TICK = 0.01
"""Time between two messages of ``/clock`` while no other message is due, s."""
_MIN_DEPTH = 1000
"""Least depth of a volatile topic, for messages that are not acknowledged yet at a fast rate."""
_SHORTEST_PASS = 1_000_000
"""Least time of one pass of a loop, ns, so that a loop does not flood the network."""


class Player:
    """Publishes the messages of a bag with the quality of service of their recording.

    Attributes:
        topics: topics that are played; a topic whose message type is not installed is omitted.
        count: messages sent so far, without those of ``/clock``.
        length: length of one pass, s.
        elapsed: the bag's time since the start of the pass, s.
    """

    def __init__(
        self,
        node: Node,
        reader: BagReader,
        topics: Collection[str] | None = None,
        *,
        rate: float = 1.0,
        loop: bool = False,
        keep_on: Callable[[], bool] = lambda: True,
    ) -> None:
        """Make the publishers.

        Args:
            node: publishes; the node need not be spun.
            reader: an open bag.
            topics: only these absolute names; None for all.
            rate: seconds of the bag per second of the wall clock, above 0.
            loop: whether to begin again at the end.
            keep_on: called again and again; a wait or the playing ends when it returns False.

        Raises:
            UsageError: the bag lacks a topic, or no topic can be played.
        """
        self._node, self._reader, self._rate, self._loop = node, reader, rate, loop
        self._keep_on = keep_on
        self.count, self.elapsed = 0, 0.0
        self.length = seconds_between(reader.start, reader.end)
        self._qualities = {
            each.name: each.quality or usual_quality(each.name) for each in reader.topics.values()
        }
        self._publishers: dict[str, Publisher] = {}
        for topic in reader.topics if topics is None else topics:
            if topic != SIMULATED_CLOCK.topic:
                self._advertise(topic)
        if not self._publishers:
            raise UsageError(f"{reader.path}: nothing to play")
        self.topics = tuple(self._publishers)
        kind, quality = message_class(SIMULATED_CLOCK.type), SIMULATED_CLOCK.quality
        self._clock = node.create_publisher(kind, SIMULATED_CLOCK.topic, qos_profile(quality))

    def _advertise(self, topic: str) -> None:
        """Make the publisher of a topic, or warn that its message type is not installed."""
        recorded = self._reader.topics
        if topic not in recorded:
            there = ", ".join(recorded) or "none"
            raise UsageError(f"{self._reader.path}: no topic {topic}; in the bag: {there}")
        try:
            kind = message_class(recorded[topic].type)
        except UsageError as error:
            part = f"{recorded[topic].count} of {self._reader.message_count} messages"
            line = f"{topic}, {part} of the bag, is not played: {error}"
            self._node.get_logger().warning(printable(line))
            return
        quality = self._qualities[topic]
        if quality.depth and not quality.transient_local:
            quality = replace(quality, depth=max(quality.depth, _MIN_DEPTH))
        self._publishers[topic] = self._node.create_publisher(kind, topic, qos_profile(quality))

    def warn_of_other_publishers(self) -> None:
        """Warn of topics that another node publishes too, including the clock."""
        names = sorted({publisher.topic_name for publisher in self._all()})
        others = [n for n in names if len(self._node.get_publishers_info_by_topic(n)) > 1]
        if others:
            found = f"another node publishes {', '.join(others)} too"
            self._node.get_logger().warning(printable(f"{found}; its messages mix with the bag's"))

    def wait_for_subscribers(self, delay: float = _DELAY) -> bool:
        """Wait until events have a subscriber; without events, until every topic has one.

        Returns:
            Whether these topics have a subscriber, after ``delay`` (s) at the latest.
        """
        events = [p for topic, p in self._publishers.items() if self._qualities[topic] == EVENTS]
        counts: list[int] = []
        now = changed = time.monotonic()
        latest = now + delay
        while now < latest and self._keep_on():
            before, counts = counts, [p.get_subscription_count() for p in events or self._all()]
            if counts != before:  # more subscribers may follow
                changed = now
            if all(counts) and now > changed + _SETTLING_TIME:
                break
            time.sleep(_TICK)
            now = time.monotonic()
        return bool(counts) and all(counts)

    def play(self) -> None:
        """Publish every message when the message is due.

        Due times are measured from the begin of a pass, so delays do not add up.

        Raises:
            BagError: the bag is damaged.
        """
        begin = time.monotonic_ns()
        length = round((self._reader.end - self._reader.start) / self._rate)
        while self._play_once(begin) and self._loop:
            begin += max(length, _SHORTEST_PASS)

    def _play_once(self, begin: int) -> bool:
        """Play one pass from the monotonic time ``begin`` (ns) on; whether the end was reached."""
        for message in self._reader.raw(self.topics):
            if not self._wait_until(message.log_time, begin):
                return False
            self._publish_clock(message.log_time)
            self._publishers[message.topic].publish(message.data)
            self.count += 1
        return self._wait_until(self._reader.end, begin)

    def _wait_until(self, log_time: int, begin: int) -> bool:
        """Wait until ``log_time`` is due, and publish the clock meanwhile; whether to keep on."""
        due = begin + round((log_time - self._reader.start) / self._rate)
        while (left := (due - time.monotonic_ns()) / NS_PER_S) > _TICK:
            time.sleep(_TICK)
            if not self._keep_on():
                return False
            self._publish_clock(log_time - from_seconds(max(left - _TICK, 0.0) * self._rate))
        time.sleep(max(left, 0.0))
        return self._keep_on()

    def _publish_clock(self, bag_time: int) -> None:
        """Publish the bag's time, ns."""
        self.elapsed = seconds_between(self._reader.start, bag_time)
        self._clock.publish(ros_messages().clock(bag_time))

    def finish(self) -> None:
        """Wait a short time until the messages have arrived."""
        latest = time.monotonic() + _ACKNOWLEDGE
        for publisher in self._all():
            while self._keep_on() and time.monotonic() < latest:
                if publisher.wait_for_all_acked(Duration(seconds=_TICK)):
                    break
        latest = time.monotonic() + _LINGER
        is_latched = any(self._qualities[topic].transient_local for topic in self.topics)
        while is_latched and self._keep_on() and time.monotonic() < latest:
            time.sleep(_TICK)

    def _all(self) -> list[Publisher]:
        """The publishers of all topics, and that of the clock."""
        return [*self._publishers.values(), self._clock]


def play(
    path: Path,
    topics: Collection[str] | None = None,
    *,
    rate: float = 1.0,
    loop: bool = False,
    delay: float = _DELAY,
    on_progress: Callable[[float, float], object] = lambda _elapsed, _length: None,
) -> int:
    """Play a bag until its end, SIGINT or SIGTERM; errors are those of ``Player``.

    Args:
        path: the bag.
        topics: only these absolute names; None for all.
        rate: seconds of the bag per second of the wall clock, above 0.
        loop: whether to begin again at the end.
        delay: longest wait for subscribers before the first message, s.
        on_progress: called again and again with the time played and the length of the bag, s.

    Returns:
        The number of messages sent.
    """
    with Stop() as stop, BagReader(path) as reader, ros_node("player") as (node, _):

        def keep_on() -> bool:
            on_progress(player.elapsed, player.length)
            return not stop.requested

        player = Player(node, reader, topics, rate=rate, loop=loop, keep_on=keep_on)
        player.wait_for_subscribers(delay)
        player.warn_of_other_publishers()
        player.play()
        player.finish()
        return player.count
