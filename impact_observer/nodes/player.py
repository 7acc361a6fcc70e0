"""Playing a bag to the ROS graph, as ``ros2 bag play`` does."""

import math
import time
from collections.abc import Callable, Collection
from contextlib import closing
from dataclasses import replace
from itertools import takewhile
from pathlib import Path

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher

from impact_observer.bag.interfaces import EVENTS, LATCHED, SIMULATED_CLOCK, Quality, usual_quality
from impact_observer.bag.reader import BagReader, RawMessage
from impact_observer.bag.schedule import Schedule, read_ahead, steps
from impact_observer.errors import UsageError
from impact_observer.nodes.messages import message_class, ros_messages
from impact_observer.nodes.quality import qos_profile
from impact_observer.nodes.session import Stop, ros_node
from impact_observer.stamps import NS_PER_S, from_seconds, seconds_between

DELAY = 5.0
"""Longest wait for subscribers before the first message, s, unless told otherwise."""
_SETTLE = 1.0
"""Between the last subscriber's appearance and the first message, s."""
LINGER = 0.5
"""How long latched messages stay available to late subscribers after the last message, s."""
_ACKNOWLEDGE = 2.0
"""Longest wait until reliable subscribers have acknowledged what was sent, s."""
_LONGEST_SLEEP = 0.05
"""How long a request to stop may go unnoticed, s."""
_BURST = 1000
"""Least depth of a volatile topic: what a fast rate piles up before it is acknowledged."""
_PROGRESS_PERIOD = 0.1
_SHORTEST_PASS = 1_000_000
"""The least time that one pass of a loop takes, ns, so that it cannot flood the network."""

KeepOn = Callable[[], bool]


def _always() -> bool:
    """Keep on."""
    return True


class Player:
    """Publishes the messages of a bag with the quality of service they were recorded with.

    Attributes:
        topics: what is played; topics whose message type ROS does not know are left out.
        count: messages sent so far, the clock's not counted.
        bag_time: log time of what was sent last, ns.
        length: from the bag's start to its end, s.
    """

    def __init__(
        self,
        node: Node,
        reader: BagReader,
        topics: Collection[str] | None = None,
        *,
        rate: float = 1.0,
        start: float = 0.0,
        clock_rate: float | None = None,
    ) -> None:
        """Play ``reader`` with ``node``, which need not be spun.

        Args:
            node: publishes.
            reader: an open bag.
            topics: only these absolute names; None for all.
            rate: seconds of the bag a second of the wall clock.
            start: where to begin, s after the bag's start. The last value of each latched topic
                before that is sent first.
            clock_rate: ticks of ``/clock``, Hz of wall time, besides one at every message; the
                bag's own clock is left out then. None for no clock.

        Raises:
            UsageError: a number is out of range, the bag lacks a topic, or nothing is to play.
        """
        _check_positive("rate", rate)
        if clock_rate is not None:
            _check_positive("clock rate", clock_rate)
        self.length = seconds_between(reader.start, reader.end)
        if not 0 <= start <= self.length:
            raise UsageError(f"start is {start}; expected 0 to {self.length} s, the bag's length")
        self.count = 0
        self._node = node
        self._reader = reader
        self._clock_rate = clock_rate
        self._schedule = Schedule(reader.start + from_seconds(start), rate)
        self.bag_time = self._schedule.start
        self._publishers = self._advertised(reader.topics if topics is None else topics)
        self.topics = tuple(self._publishers)
        self._latched = self._values_before_start()
        self._clock: Publisher | None = None
        if clock_rate is not None:
            self._clock = node.create_publisher(
                message_class(SIMULATED_CLOCK.type),
                SIMULATED_CLOCK.topic,
                qos_profile(SIMULATED_CLOCK.quality),
            )

    @property
    def elapsed(self) -> float:
        """From the bag's start to what was sent last, s."""
        return seconds_between(self._reader.start, self.bag_time)

    def _quality(self, topic: str) -> Quality:
        """The quality of service to offer: as recorded, else the usual one."""
        return self._reader.topics[topic].quality or usual_quality(topic)

    def _advertised(self, topics: Collection[str]) -> dict[str, Publisher]:
        """A publisher for every topic whose message type ROS knows."""
        publishers = {}
        for topic in topics:
            if topic not in self._reader.topics:
                found = ", ".join(self._reader.topics) or "none"
                raise UsageError(f"{self._reader.path}: no topic {topic}; in the bag: {found}")
            if topic == SIMULATED_CLOCK.topic and self._clock_rate is not None:
                continue
            try:
                message_type = message_class(self._reader.topics[topic].type)
            except UsageError as error:
                self._node.get_logger().warning(f"{topic} is not played: {error}")
                continue
            quality = self._quality(topic)
            if quality.depth and not quality.transient_local:
                quality = replace(quality, depth=max(quality.depth, _BURST))
            publishers[topic] = self._node.create_publisher(
                message_type, topic, qos_profile(quality)
            )
        if not publishers:
            raise UsageError(f"{self._reader.path}: nothing to play")
        return publishers

    def _values_before_start(self) -> list[RawMessage]:
        """The last message of each latched topic before the start."""
        if self._schedule.start <= self._reader.start:
            return []
        topics = [topic for topic in self.topics if self._quality(topic) == LATCHED]
        before = takewhile(
            lambda message: message.log_time < self._schedule.start, self._reader.raw(topics)
        )
        return list({message.topic: message for message in before}.values())

    def rivals(self) -> list[str]:
        """Topics to be played that another node publishes already."""
        return [
            topic
            for topic in self.topics
            if len(self._node.get_publishers_info_by_topic(topic)) > 1
        ]

    def wait_for_subscribers(self, delay: float, keep_on: KeepOn = _always) -> bool:
        """Wait until events have a subscriber, so that it misses none of them.

        A bag without events waits for a subscriber on every topic.

        Args:
            delay: the longest wait, s.
            keep_on: asked meanwhile; the wait ends when it says no.

        Returns:
            Whether all that are waited for have one.
        """
        events = [p for topic, p in self._publishers.items() if self._quality(topic) == EVENTS]
        wanted = events or self._all()
        now = begin = since = time.monotonic_ns()
        before: list[int] = []
        matched = False
        while now < begin + from_seconds(delay):
            counts = [publisher.get_subscription_count() for publisher in wanted]
            if counts != before:  # others may be on their way
                before, since = counts, now
            matched = all(counts)
            if matched and now > since + from_seconds(_SETTLE):
                break
            if not _sleep_until(now + 10_000_000, keep_on):
                break
            now = time.monotonic_ns()
        return matched

    def play(self, *, loop: bool = False, keep_on: KeepOn = _always) -> None:
        """Publish everything when it is due.

        Every due time is measured from the beginning, so delays do not add up.

        Args:
            loop: whether to begin again at the end, again and again; the clock jumps back.
            keep_on: asked at least twenty times a second; playing ends when it says no.

        Raises:
            BagError: the bag is damaged.
        """
        begin = time.monotonic_ns()
        length = max(self._schedule.due(self._reader.end), _SHORTEST_PASS)
        while self._play_once(begin, keep_on) and loop:
            begin += length

    def _play_once(self, begin: int, keep_on: KeepOn) -> bool:
        """Play from start to end, beginning at wall time ``begin``; whether it got there."""
        for message in self._latched:
            self._send(message)
        start = self._schedule.start
        messages = self._reader.raw(self.topics, start if start > self._reader.start else 0)
        shown = None
        with closing(read_ahead(messages)) as ahead:
            for step in steps(ahead, self._schedule, self._clock_rate):
                if not _sleep_until(begin + step.due, keep_on):
                    return False
                if self._clock and step.bag_time != shown:
                    self._clock.publish(ros_messages().clock(step.bag_time))
                    shown = step.bag_time
                if step.message:
                    self._send(step.message)
                self.bag_time = step.bag_time
        return True

    def _send(self, message: RawMessage) -> None:
        """Publish a message."""
        self._publishers[message.topic].publish(message.data)
        self.count += 1

    def finish(self, keep_on: KeepOn = _always) -> None:
        """Wait, a short time, until what was sent has arrived.

        Reliable subscribers get up to two seconds to acknowledge; latched messages stay
        available to late ones for another half.

        Args:
            keep_on: asked meanwhile; the wait ends when it says no.
        """
        latest = time.monotonic_ns() + from_seconds(_ACKNOWLEDGE)
        for publisher in self._all():
            while keep_on() and time.monotonic_ns() < latest:
                if publisher.wait_for_all_acked(Duration(seconds=_LONGEST_SLEEP)):
                    break
        if any(self._quality(topic).transient_local for topic in self.topics):
            _sleep_until(time.monotonic_ns() + from_seconds(LINGER), keep_on)

    def _all(self) -> list[Publisher]:
        """Every publisher, the clock's included."""
        return [*self._publishers.values(), *([self._clock] if self._clock else [])]


def play(
    path: Path | str,
    topics: Collection[str] | None = None,
    *,
    rate: float = 1.0,
    loop: bool = False,
    start: float = 0.0,
    clock_rate: float | None = None,
    delay: float = DELAY,
    on_progress: Callable[[Player], None] | None = None,
) -> int:
    """Play a bag until its end, SIGINT or SIGTERM.

    Args:
        path: the bag.
        topics: only these absolute names; None for all.
        rate: seconds of the bag a second of the wall clock.
        loop: whether to begin again at the end.
        start: where to begin, s after the bag's start.
        clock_rate: ticks of ``/clock``, Hz of wall time; None for no clock.
        delay: longest wait for a subscriber on every topic before the first message, s.
        on_progress: told about ten times a second how far it is, and at the end.

    Returns:
        The number of messages sent.

    Raises:
        UsageError: there is no bag at ``path``, or an argument does not fit it.
        BagError: the bag is damaged.
    """
    if not 0 <= delay < math.inf:
        raise UsageError(f"delay is {delay}; expected 0 or more seconds")
    with Stop() as stop, BagReader(path) as reader, ros_node("player") as (node, _):
        player = Player(node, reader, topics, rate=rate, start=start, clock_rate=clock_rate)
        shown = time.monotonic()

        def keep_on() -> bool:
            nonlocal shown
            if on_progress and time.monotonic() > shown + _PROGRESS_PERIOD:
                shown = time.monotonic()
                on_progress(player)
            return not stop.requested

        player.wait_for_subscribers(delay, keep_on)
        if rivals := player.rivals():
            node.get_logger().warning(
                f"another node publishes {', '.join(rivals)} too; its messages mix with the bag's"
            )
        player.play(loop=loop, keep_on=keep_on)
        player.finish(keep_on)
        if on_progress:
            on_progress(player)
        return player.count


def _sleep_until(wall: int, keep_on: KeepOn) -> bool:
    """Sleep until the monotonic time ``wall`` (ns); whether to keep on."""
    while (left := wall - time.monotonic_ns()) > 0 and keep_on():
        time.sleep(min(left / NS_PER_S, _LONGEST_SLEEP))
    return keep_on()


def _check_positive(name: str, value: float) -> None:
    """Raise unless ``value`` is a positive finite number."""
    if not 0 < value < math.inf:
        raise UsageError(f"{name} is {value}; expected a positive number")
