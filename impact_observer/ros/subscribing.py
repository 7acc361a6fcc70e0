# SPDX-License-Identifier: Apache-2.0
"""Subscribing with the quality of service that publishers offer, and reading bursts."""

import bisect
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, Generic, TypeAlias, TypeVar

from rclpy.callback_groups import CallbackGroup, ReentrantCallbackGroup
from rclpy.event_handler import EventHandler
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from impact_observer.io.interfaces import Quality, usual_quality
from impact_observer.io.messages import AnyMessage
from impact_observer.ros.qos import offered_quality, qos_profile

SLICE = 5_000_000
"""Longest time for messages before estimates, timers and services have their turn, ns."""
_PERIOD = 1.0
"""How often the executor looks for events of the middleware, s."""
_MOMENT = 0.01
"""For how long it looks then, s."""
MessageInfo: TypeAlias = Mapping[str, int]
"""What the middleware adds to a message: its ``source_timestamp`` among other things, ns."""


_T = TypeVar("_T")


class Ahead(Generic[_T]):
    """What is stamped ahead of the clock, until that has come near enough."""

    def __init__(self, most: int) -> None:
        """Keep ``most`` of them at most, the nearest."""
        self._most = most
        self._items: list[tuple[int, int, _T]] = []  # in the order of stamps
        self._number = 0

    def __len__(self) -> int:
        """How many there are."""
        return len(self._items)

    def add(self, stamp: int, item: _T) -> _T | None:
        """Keep ``item`` for ``stamp`` (ns); the one that there is no room for, if any."""
        self._number += 1
        bisect.insort(self._items, (stamp, self._number, item))
        return self._items.pop()[2] if len(self._items) > self._most else None

    def taken(self, latest: int) -> _T | None:
        """The first one, if its stamp is ``latest`` (ns) at most."""
        if self._items and self._items[0][0] <= latest:
            return self._items.pop(0)[2]
        return None

    def clear(self) -> None:
        """Forget all."""
        self._items.clear()


class Polled(CallbackGroup):
    """Subscriptions that the executor leaves alone: whoever needs their messages takes them.

    A message costs the executor several times what taking it does.
    """

    def can_execute(self, entity: object) -> bool:
        """Never."""
        del entity
        return False

    def beginning_execution(self, entity: object) -> bool:
        """Never."""
        del entity
        return False

    def ending_execution(self, entity: object) -> None:
        """Nothing has begun."""


class EventsSeldom(ReentrantCallbackGroup):
    """For an executor of one thread; the middleware's events only for a moment in each second.

    Each publisher and subscription has two such events, on partners that do not fit. Whenever the
    executor waits, they cost it as much as five timers.
    """

    def __init__(self) -> None:
        super().__init__()
        self._begun = -_PERIOD

    def can_execute(self, entity: object) -> bool:
        """Whether it is no event, or it is such a moment.

        One begins when this is asked a second or more after the last one began.
        """
        if not isinstance(entity, EventHandler):
            return True
        now = time.monotonic()
        if now >= self._begun + _PERIOD:
            self._begun = now
        return now < self._begun + _MOMENT


def common_offer(topic: str, publishers: Iterable[TopicEndpointInfo]) -> Quality:
    """What all publishers of a topic offer; at least one."""
    depth = usual_quality(topic).depth
    return Quality.common(offered_quality(each.qos_profile, depth) for each in publishers)


def waiting_messages(subscription: Subscription, most: int) -> Iterator[tuple[Any, MessageInfo]]:
    """Messages that have arrived already, ``most`` of them at most; bytes where it is raw.

    The executor takes several times longer for a message than this, so that a burst could
    arrive faster than it is read.
    """
    with (handle := subscription.handle):
        for _ in range(most):
            if (taken := handle.take_message(subscription.msg_type, subscription.raw)) is None:
                return
            yield taken


def with_waiting(message: AnyMessage, subscription: Subscription, most: int) -> Iterator[Any]:
    """A message and those that wait behind it, ``most`` of them, for a slice of time at most."""
    yield message
    yield from slice_of_waiting(subscription, most)


def slice_of_waiting(subscription: Subscription, most: int) -> Iterator[Any]:
    """Messages that have arrived already, ``most`` of them, for a slice of time at most."""
    end = time.monotonic_ns() + SLICE
    for waiting, _ in waiting_messages(subscription, most):
        yield waiting
        if time.monotonic_ns() >= end:
            return


def subscribe_raw(
    node: Node,
    topic: str,
    message_type: AnyMessage,
    quality: Quality,
    on_message: Callable[[str, bytes], None],
) -> Subscription:
    """Hand each message of a topic to ``on_message``, as serialized.

    Args:
        node: the caller spins it.
        topic: the absolute name.
        message_type: its class.
        quality: what to ask for; the depth is how many messages may wait.
        on_message: called with the topic and the bytes.
    """

    def take(data: bytes) -> None:
        on_message(topic, data)
        for waiting, _ in waiting_messages(subscription, quality.depth):
            on_message(topic, waiting)

    subscription = node.create_subscription(
        message_type, topic, take, qos_profile(quality), raw=True
    )
    return subscription
