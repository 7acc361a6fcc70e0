# SPDX-License-Identifier: Apache-2.0
"""Playing a bag to the ROS graph, as ``ros2 bag play`` does."""

import math
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from pathlib import Path

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher

from impact_observer.errors import UsageError
from impact_observer.io.interfaces import EVENTS, SIMULATED_CLOCK, Quality, usual_quality
from impact_observer.io.reader import BagReader
from impact_observer.plain_text import printable
from impact_observer.process_end import Stop
from impact_observer.ros.session import ros_node
from impact_observer.ros.topics import message_class, qos_profile, ros_messages
from impact_observer.stamps import NS_PER_S, from_seconds, seconds_between

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
KeepOn = Callable[[], bool]


@dataclass(frozen=True, slots=True)
class Playing:
    """Options for playing a bag.

    Attributes:
        topics: only these absolute names; None for all.
        rate: seconds of the bag per second of the wall clock.
        loop: whether to begin again at the end.
    """

    topics: Collection[str] | None = None
    rate: float = 1.0
    loop: bool = False

    def __post_init__(self) -> None:
        """Raise UsageError unless the rate is a positive number."""
        if not 0 < self.rate < math.inf:
            raise UsageError(f"rate is {self.rate}; expected a positive number")


class Player:
    """Publishes the messages of a bag with the quality of service of their recording.

    Attributes:
        topics: topics that are played; a topic whose message type is not installed is omitted.
        count: messages sent so far, without those of ``/clock``.
        length: length of one pass, s.
        elapsed: the bag's time since the start of the pass, s.
    """

    def __init__(self, node: Node, reader: BagReader, how: Playing | None = None) -> None:
        """Make the publishers.

        Args:
            node: publishes; the node need not be spun.
            reader: an open bag.
            how: None for the whole bag as recorded.

        Raises:
            UsageError: the bag lacks a topic, or no topic can be played.
        """
        self._how = how or Playing()
        self.count, self.elapsed = 0, 0.0
        self._node, self._reader = node, reader
        self._start, self._end = reader.start, reader.end
        self.length = seconds_between(self._start, self._end)
        self._publishers = self._make_publishers()
        self.topics = tuple(self._publishers)
        kind, quality = message_class(SIMULATED_CLOCK.type), SIMULATED_CLOCK.quality
        self._clock = node.create_publisher(kind, SIMULATED_CLOCK.topic, qos_profile(quality))

    def _quality(self, topic: str) -> Quality:
        """The recorded quality of service; the usual one of a topic recorded without."""
        return self._reader.topics[topic].quality or usual_quality(topic)

    def _make_publishers(self) -> dict[str, Publisher]:
        """A publisher for every topic whose message type is installed."""
        recorded, publishers = self._reader.topics, {}
        for topic in recorded if self._how.topics is None else self._how.topics:
            if topic == SIMULATED_CLOCK.topic:
                continue
            if topic not in recorded:
                there = ", ".join(recorded) or "none"
                raise UsageError(f"{self._reader.path}: no topic {topic}; in the bag: {there}")
            try:
                kind = message_class(recorded[topic].type)
            except UsageError as error:
                part = f"{recorded[topic].count} of {self._reader.message_count} messages"
                line = f"{topic}, {part} of the bag, is not played: {error}"
                self._node.get_logger().warning(printable(line))
                continue
            quality = self._quality(topic)
            if quality.depth and not quality.transient_local:
                quality = replace(quality, depth=max(quality.depth, _MIN_DEPTH))
            publishers[topic] = self._node.create_publisher(kind, topic, qos_profile(quality))
        if not publishers:
            raise UsageError(f"{self._reader.path}: nothing to play")
        return publishers

    def other_publishers(self) -> list[str]:
        """Topics to be played that another node publishes too, including the clock."""
        names = {publisher.topic_name for publisher in self._all()}
        return sorted(n for n in names if len(self._node.get_publishers_info_by_topic(n)) > 1)

    def wait_for_subscribers(self, delay: float, keep_on: KeepOn = lambda: True) -> bool:
        """Wait until events have a subscriber; without events, until every topic has one.

        Args:
            delay: the longest wait, s.
            keep_on: called repeatedly; the wait ends when ``keep_on`` returns False.

        Returns:
            Whether these topics have a subscriber.
        """
        events = [p for topic, p in self._publishers.items() if self._quality(topic) == EVENTS]
        counts: list[int] = []
        now = changed = time.monotonic()
        latest = now + delay
        while now < latest and keep_on():
            before, counts = counts, [p.get_subscription_count() for p in events or self._all()]
            if counts != before:  # more subscribers may follow
                changed = now
            if all(counts) and now > changed + _SETTLING_TIME:
                break
            time.sleep(_TICK)
            now = time.monotonic()
        return bool(counts) and all(counts)

    def play(self, keep_on: KeepOn = lambda: True) -> None:
        """Publish every message when the message is due.

        Due times are measured from the begin of a pass, so delays do not add up.

        Args:
            keep_on: called at every message and at least a hundred times a second; playing ends
                when ``keep_on`` returns False.

        Raises:
            BagError: the bag is damaged.
        """
        begin = time.monotonic_ns()
        length = max(round((self._end - self._start) / self._how.rate), _SHORTEST_PASS)
        while self._play_once(begin, keep_on) and self._how.loop:
            begin += length

    def _play_once(self, begin: int, keep_on: KeepOn) -> bool:
        """Play one pass from the monotonic time ``begin`` (ns) on; whether the end was reached."""
        for message in self._reader.raw(self.topics):
            if not self._wait_until(message.log_time, begin, keep_on):
                return False
            self._publish_clock(message.log_time)
            self._publishers[message.topic].publish(message.data)
            self.count += 1
        return self._wait_until(self._end, begin, keep_on)

    def _wait_until(self, log_time: int, begin: int, keep_on: KeepOn) -> bool:
        """Wait until ``log_time`` is due, and publish the clock meanwhile; whether to keep on."""
        rate = self._how.rate
        due = begin + round((log_time - self._start) / rate)
        while (left := (due - time.monotonic_ns()) / NS_PER_S) > _TICK:
            time.sleep(_TICK)
            if not keep_on():
                return False
            self._publish_clock(log_time - from_seconds(max(left - _TICK, 0.0) * rate))
        time.sleep(max(left, 0.0))
        return keep_on()

    def _publish_clock(self, bag_time: int) -> None:
        """Publish the bag's time, ns."""
        self.elapsed = seconds_between(self._start, bag_time)
        self._clock.publish(ros_messages().clock(bag_time))

    def finish(self, keep_on: KeepOn = lambda: True) -> None:
        """Wait a short time until the messages have arrived, while ``keep_on`` returns True."""
        latest = time.monotonic() + _ACKNOWLEDGE
        for publisher in self._all():
            while keep_on() and time.monotonic() < latest:
                if publisher.wait_for_all_acked(Duration(seconds=_TICK)):
                    break
        latched = any(self._quality(topic).transient_local for topic in self.topics)
        latest = time.monotonic() + _LINGER
        while latched and keep_on() and time.monotonic() < latest:
            time.sleep(_TICK)

    def _all(self) -> list[Publisher]:
        """The publishers of all topics, and that of the clock."""
        return [*self._publishers.values(), self._clock]


def play(
    path: Path | str,
    how: Playing | None = None,
    *,
    delay: float = 5.0,
    on_progress: Callable[[Player], object] = lambda _: None,
) -> int:
    """Play a bag until its end, SIGINT or SIGTERM.

    Args:
        path: the bag.
        how: None for the whole bag as recorded.
        delay: longest wait for subscribers before the first message, s.
        on_progress: called again and again.

    Returns:
        The number of messages sent.

    Raises:
        UsageError: there is no bag at ``path``, ``how`` does not fit the bag, or ``delay`` is no
            time.
        BagError: the bag is damaged.
    """
    if not 0 <= delay < math.inf:
        raise UsageError(f"delay is {delay}; expected 0 or more seconds")
    with Stop() as stop, BagReader(path) as reader, ros_node("player") as (node, _):
        player = Player(node, reader, how)

        def keep_on() -> bool:
            on_progress(player)
            return not stop.requested

        player.wait_for_subscribers(delay, keep_on)
        if others := player.other_publishers():
            line = (
                f"another node publishes {', '.join(others)} too; its messages mix with the bag's"
            )
            node.get_logger().warning(printable(line))
        player.play(keep_on)
        player.finish(keep_on)
        return player.count
