# SPDX-License-Identifier: Apache-2.0
"""Playing a bag to the ROS graph, as ``ros2 bag play`` does."""

import math
import time
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import takewhile
from pathlib import Path

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile

from impact_observer.errors import UsageError
from impact_observer.io.interfaces import EVENTS, SIMULATED_CLOCK, Quality, usual_quality
from impact_observer.io.play_schedule import Control, Pace, Playing, ReadAhead, Ticks
from impact_observer.io.reader import BagReader, RawMessage
from impact_observer.plain_text import printable
from impact_observer.process_end import Stop
from impact_observer.ros.message_classes import message_class, ros_messages
from impact_observer.ros.qos import overriding_profile, qos_profile
from impact_observer.ros.session import ros_node
from impact_observer.stamps import NS_PER_S, from_seconds, seconds_between

DELAY = 5.0
"""Default of the longest wait for subscribers before the first message, s."""
_SETTLING_TIME = 1.0
"""Between the last subscriber's appearance and the first message, s."""
LINGER = 0.5
"""How long latched messages stay available to late subscribers after the last message, s."""
_ACKNOWLEDGE = 2.0
"""Longest wait until reliable subscribers have acknowledged what was sent, s."""
_LONGEST_SLEEP = 0.05
"""Longest time until a request to stop, or a key, is noticed, s."""
_LONGEST_SLEEP_NS = from_seconds(_LONGEST_SLEEP)
_KEY_PERIOD = 0.02
"""How often keys are read during a burst of messages, s."""
_MIN_DEPTH = 1000
"""Least depth of a volatile topic, for messages that are not acknowledged yet at a fast rate."""
_PROGRESS_PERIOD = 0.1
_MIN_PASS_TIME = 1_000_000
"""Least time of one pass of a loop, ns, so that it does not flood the network."""
_RATE_STEP = 1.1
"""Factor of the rate for one key."""
_RATES = (0.01, 100.0)
"""Range of the rate by keys."""

KeepOn = Callable[[], bool]


def _always() -> bool:
    """Never end by itself."""
    return True


class Player:
    """Publishes the messages of a bag with the quality of service they were recorded with.

    Attributes:
        topics: topics that are played, by names in the bag; those whose message type is not
            installed are omitted.
        count: messages sent so far, without the clock's.
        bag_time: log time of the last message sent, ns.
        length: length of one pass, s.
        pace: rate, and whether it is paused.
    """

    def __init__(self, node: Node, reader: BagReader, how: Playing | None = None) -> None:
        """Play ``reader`` with ``node``, which need not be spun.

        Args:
            node: publishes.
            reader: an open bag.
            how: None for the whole bag as recorded.

        Raises:
            UsageError: ``start`` is not in the bag, the bag lacks a topic, a name is invalid, or
                no topic can be played.
        """
        self._how = how = how or Playing()
        whole = seconds_between(reader.start, reader.end)
        if not 0 <= how.start <= whole:
            raise UsageError(f"start is {how.start}; expected 0 to {whole} s, the bag's length")
        self.count = 0
        self._node = node
        self._reader = reader
        self._start = self._next_time = reader.start + from_seconds(how.start)
        self._end = reader.end
        if how.duration is not None:
            self._end = min(self._end, self._start + from_seconds(how.duration))
        self.length = seconds_between(self._start, self._end)
        self.bag_time = self._start
        self.pace = Pace(self._start, time.monotonic_ns(), how.rate, how.paused)
        self._ticks: Ticks | None = None
        self._published_time: int | None = None
        self._steps = 0
        self._publishers = self._make_publishers()
        self.topics = tuple(self._publishers)
        self._latched = self._latched_before_start()
        self._clock: Publisher | None = None
        if how.clock_rate is not None:
            topic = SIMULATED_CLOCK.topic
            self._clock = node.create_publisher(
                message_class(SIMULATED_CLOCK.type),
                how.names.get(topic, topic),
                self._profile(topic, SIMULATED_CLOCK.quality),
            )

    @property
    def elapsed(self) -> float:
        """From the start to the last message sent, s."""
        return seconds_between(self._start, self.bag_time)

    def control(self, wanted: Control) -> None:
        """Apply a key; ``QUIT`` is for the caller of :meth:`play`."""
        now = time.monotonic_ns()
        if wanted is Control.PAUSE:
            self.pace.toggle_pause(now, self._next_time)
        elif wanted is Control.NEXT and self.pace.paused:
            self._steps += 1
        elif wanted in {Control.FASTER, Control.SLOWER}:
            factor = _RATE_STEP if wanted is Control.FASTER else 1 / _RATE_STEP
            if _RATES[0] <= self.pace.rate * factor <= _RATES[1]:
                self.pace.scale_rate(now, self._next_time, factor)

    def _quality(self, topic: str) -> Quality:
        """The quality of service to offer: overridden, else as recorded, else the usual one."""
        if topic in self._how.profiles:
            return self._how.profiles[topic].quality
        return self._reader.topics[topic].quality or usual_quality(topic)

    def _profile(self, topic: str, quality: Quality) -> QoSProfile:
        """``quality`` for ``rclpy``, or the policies of a file with overrides."""
        override = self._how.profiles.get(topic)
        return qos_profile(quality) if override is None else overriding_profile(override)

    def _make_publishers(self) -> dict[str, Publisher]:
        """A publisher for every topic whose message type is installed."""
        how, found = self._how, self._reader.topics
        topics = found if how.topics is None else how.topics
        missing = [topic for topic in (*topics, *how.names) if topic not in found]
        if how.clock_rate is not None:
            missing = [topic for topic in missing if topic != SIMULATED_CLOCK.topic]
        if missing:
            there = ", ".join(found) or "none"
            raise UsageError(f"{self._reader.path}: no topic {missing[0]}; in the bag: {there}")
        publishers: dict[str, Publisher] = {}
        types: dict[str, str] = {}
        for topic in topics:
            if topic == SIMULATED_CLOCK.topic and how.clock_rate is not None:
                continue
            name, type_name = how.names.get(topic, topic), found[topic].type
            if types.setdefault(name, type_name) != type_name:
                raise UsageError(f"{name}: would be {types[name]} and {type_name}; rename one")
            if publisher := self._publisher(topic, name, type_name):
                publishers[topic] = publisher
        if not publishers:
            raise UsageError(f"{self._reader.path}: nothing to play")
        return publishers

    def _publisher(self, topic: str, name: str, type_name: str) -> Publisher | None:
        """A publisher of a topic called ``name``; None where the type is not installed."""
        try:
            message_type = message_class(type_name)
        except UsageError as error:
            self._node.get_logger().warning(printable(f"{topic} is not played: {error}"))
            return None
        quality = self._quality(topic)
        if quality.depth and not quality.transient_local:
            quality = replace(quality, depth=max(quality.depth, _MIN_DEPTH))
        return self._node.create_publisher(message_type, name, self._profile(topic, quality))

    def _latched_before_start(self) -> list[RawMessage]:
        """Messages that latched topics hold at the start, without events.

        Events before the start would not match the states of a run that starts there.
        """
        if self._start <= self._reader.start:
            return []
        kept: dict[str, deque[RawMessage]] = {
            topic: deque(maxlen=quality.depth or None)
            for topic in self.topics
            if (quality := self._quality(topic)).transient_local and usual_quality(topic) != EVENTS
        }
        messages = self._reader.raw([*kept])
        for message in takewhile(lambda each: each.log_time < self._start, messages):
            kept[message.topic].append(message)
        return sorted((m for each in kept.values() for m in each), key=lambda m: m.log_time)

    def other_publishers(self) -> list[str]:
        """Topics to be played that another node publishes too, including the clock."""
        names = {publisher.topic_name for publisher in self._all()}
        return sorted(
            name for name in names if len(self._node.get_publishers_info_by_topic(name)) > 1
        )

    def wait_for_subscribers(self, delay: float, keep_on: KeepOn = _always) -> bool:
        """Wait until events have a subscriber; without events, until every topic has one.

        Args:
            delay: the longest wait, s.
            keep_on: called repeatedly; the wait ends when it returns False.

        Returns:
            Whether these topics have a subscriber.
        """
        events = [p for topic, p in self._publishers.items() if self._quality(topic) == EVENTS]
        wanted = events or self._all()
        now = begin = since = time.monotonic_ns()
        before: list[int] = []
        matched = False
        while now < begin + from_seconds(delay):
            counts = [publisher.get_subscription_count() for publisher in wanted]
            if counts != before:  # more may follow
                before, since = counts, now
            matched = all(counts)
            if matched and now > since + from_seconds(_SETTLING_TIME):
                break
            if not _sleep_until(now + 10_000_000, keep_on):
                break
            now = time.monotonic_ns()
        return matched

    def play(self, keep_on: KeepOn = _always) -> None:
        """Publish every message when it is due.

        Args:
            keep_on: called at least twenty times a second; playing ends when it returns False.

        Raises:
            BagError: the bag is damaged.
        """
        how, ahead = self._how, self._ahead()
        try:
            begin = time.monotonic_ns()
            while self._play_once(ahead, begin, keep_on):
                if how.loop:  # read the next pass during the rest of this one
                    ahead.close()
                    ahead = self._ahead()
                elif how.duration is None:
                    return
                if not self._reach(self._end, keep_on) or not how.loop:
                    return
                due = self.pace.due(self._end) or time.monotonic_ns()
                begin = max(due, begin + _MIN_PASS_TIME)
        finally:
            ahead.close()

    def _ahead(self) -> ReadAhead:
        """The messages of one pass, read ahead."""
        start = self._start if self._start > self._reader.start else 0
        return ReadAhead(self._reader.raw(self.topics, start))

    def _play_once(self, ahead: ReadAhead, begin: int, keep_on: KeepOn) -> bool:
        """Play one pass from wall time ``begin`` on; whether it reached the end."""
        self.pace.jump(self._start, begin)
        self._next_time, self._published_time = self._start, None
        if self._how.clock_rate is not None:
            self._ticks = Ticks(self._how.clock_rate, begin)
        for message in self._latched:
            self._send(message)
        for message in ahead:
            if message.log_time > self._end:
                break
            if not self._reach(message.log_time, keep_on):
                return False
            if self._steps:
                self._steps -= 1
                self.pace.jump(message.log_time, time.monotonic_ns())
            self._publish_clock(message.log_time)
            self._send(message)
        return True

    def _reach(self, log_time: int, keep_on: KeepOn) -> bool:
        """Wait until ``log_time`` is due, and publish the clock meanwhile; whether to keep on."""
        self._next_time = log_time
        while True:
            due, now = self.pace.due(log_time), time.monotonic_ns()
            tick = self._ticks.next if self._ticks else None
            soonest = min(t for t in (due, tick, now + _LONGEST_SLEEP_NS) if t is not None)
            if self._ticks and tick == soonest <= now:
                self._publish_clock(min(self.pace.at(soonest), log_time), always=self.pace.paused)
                self._ticks.count += 1
            elif due == soonest <= now or self._steps:
                return keep_on()
            else:
                time.sleep((soonest - now) / NS_PER_S)
            if not keep_on():
                return False

    def _publish_clock(self, bag_time: int, *, always: bool = False) -> None:
        """Publish the bag's time, unless it was published already."""
        self.bag_time = bag_time
        if self._clock and (always or bag_time != self._published_time):
            self._clock.publish(ros_messages().clock(bag_time))
            self._published_time = bag_time

    def _send(self, message: RawMessage) -> None:
        """Publish a message."""
        self._publishers[message.topic].publish(message.data)
        self.count += 1

    def finish(self, keep_on: KeepOn = _always) -> None:
        """Wait a short time until the messages have arrived.

        Reliable subscribers get up to two seconds to acknowledge. Latched messages stay
        available for another half second.

        Args:
            keep_on: called repeatedly; the wait ends when it returns False.
        """
        latest = time.monotonic_ns() + from_seconds(_ACKNOWLEDGE)
        for publisher in self._all():
            while keep_on() and time.monotonic_ns() < latest:
                if publisher.wait_for_all_acked(Duration(seconds=_LONGEST_SLEEP)):
                    break
        if any(self._quality(topic).transient_local for topic in self.topics):
            _sleep_until(time.monotonic_ns() + from_seconds(LINGER), keep_on)

    def _all(self) -> list[Publisher]:
        """Every publisher, including the clock's."""
        return [*self._publishers.values(), *([self._clock] if self._clock else [])]


def play(
    path: Path | str,
    how: Playing | None = None,
    *,
    delay: float = DELAY,
    on_progress: Callable[[Player], None] | None = None,
    controls: Callable[[], Iterable[Control]] = tuple,
) -> int:
    """Play a bag until its end, SIGINT or SIGTERM.

    Args:
        path: the bag.
        how: None for the whole bag as recorded.
        delay: longest wait for a subscriber on every topic before the first message, s.
        on_progress: called about ten times a second, and at the end.
        controls: returns the controls since its last call.

    Returns:
        The number of messages sent.

    Raises:
        UsageError: there is no bag at ``path``, or ``how`` does not fit it.
        BagError: the bag is damaged.
    """
    if not 0 <= delay < math.inf:
        raise UsageError(f"delay is {delay}; expected 0 or more seconds")
    with Stop() as stop, BagReader(path) as reader, ros_node("player") as (node, _):
        player = Player(node, reader, how)
        last_shown = last_keys = time.monotonic()
        ended = False

        def keep_on() -> bool:
            nonlocal last_shown, last_keys, ended
            now = time.monotonic()
            if now > last_keys + _KEY_PERIOD:
                last_keys = now
                for control in controls():
                    ended = ended or control is Control.QUIT
                    player.control(control)
            if on_progress and now > last_shown + _PROGRESS_PERIOD:
                last_shown = now
                on_progress(player)
            return not (stop.requested or ended)

        player.wait_for_subscribers(delay, keep_on)
        if others := player.other_publishers():
            node.get_logger().warning(
                printable(
                    f"another node publishes {', '.join(others)} too; its messages mix with the"
                    " bag's"
                )
            )
        player.play(keep_on)
        player.finish(keep_on)
        if on_progress:
            on_progress(player)
        return player.count


def _sleep_until(wall: int, keep_on: KeepOn) -> bool:
    """Sleep until the monotonic time ``wall`` (ns); whether to keep on."""
    while (left := wall - time.monotonic_ns()) > 0 and keep_on():
        time.sleep(min(left / NS_PER_S, _LONGEST_SLEEP))
    return keep_on()
