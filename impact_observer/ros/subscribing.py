# SPDX-License-Identifier: Apache-2.0
"""Subscriptions that take all messages that wait, with the quality that publishers offer."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, TypeAlias

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from impact_observer.io.interfaces import Quality, usual_quality
from impact_observer.io.messages import AnyMessage
from impact_observer.ros.qos import offered_quality, qos_profile

MOST_TOGETHER = 200
"""Messages that one call of a callback takes at most: then timers and services have their turn."""
MessageInfo: TypeAlias = Mapping[str, int]
"""Data of the middleware on a message, such as its ``source_timestamp``, ns."""


class PolledGroup(CallbackGroup):
    """A subscription whose messages are polled by ``waiting_messages``.

    The executor does not wake for each of these messages: that takes longer than to read one.

    Attributes:
        has_messages: whether a message has come. Events of the middleware, such as a publisher
            that does not fit, are waited for until then, as each message wakes who waits for them.
    """

    has_messages = False

    def can_execute(self, entity: object) -> bool:
        """Whether the executor waits for ``entity``."""
        return not (self.has_messages or isinstance(entity, Subscription))

    def beginning_execution(self, entity: object) -> bool:
        """Whether the callback of ``entity`` may begin: always, as there is one thread."""
        del entity
        return True

    def ending_execution(self, entity: object) -> None:
        """Take note that the callback of ``entity`` has ended."""


def common_offer(topic: str, publishers: Iterable[TopicEndpointInfo]) -> Quality:
    """The quality of service that all publishers of a topic offer; at least one publisher."""
    depth = usual_quality(topic).depth
    return Quality.common(offered_quality(each.qos_profile, depth) for each in publishers)


def waiting_messages(subscription: Subscription, most: int) -> Iterator[tuple[Any, MessageInfo]]:
    """Take up to ``most`` messages that have arrived already; bytes if the subscription is raw.

    The executor takes one message each time it waits, so that a burst would overflow the queue.
    """
    with (handle := subscription.handle):
        for _ in range(most):
            if (taken := handle.take_message(subscription.msg_type, subscription.raw)) is None:
                return
            yield taken


def subscribe(
    node: Node,
    message_type: AnyMessage,
    topic: str,
    quality: Quality,
    on_messages: Callable[[list[AnyMessage]], None],
    *,
    event_callbacks: SubscriptionEventCallbacks | None = None,
    group: CallbackGroup | None = None,
) -> Subscription:
    """Hand the messages of a topic to ``on_messages``, those that wait together in one list.

    Args:
        node: the caller spins the node.
        message_type: class of the messages.
        topic: name of the topic.
        quality: quality of service that is requested.
        on_messages: called with 1 to ``MOST_TOGETHER`` messages in the order of arrival.
        event_callbacks: called for events of the middleware; None for the usual log lines.
        group: callback group; None for that of the node.
    """

    def take(message: AnyMessage) -> None:
        others = waiting_messages(subscription, MOST_TOGETHER - 1)
        on_messages([message, *(each for each, _ in others)])

    subscription: Subscription = node.create_subscription(
        message_type,
        topic,
        take,
        qos_profile(quality),
        callback_group=group,
        event_callbacks=event_callbacks,
    )
    return subscription


def subscribe_raw(
    node: Node,
    topic: str,
    message_type: AnyMessage,
    quality: Quality,
    on_message: Callable[[str, bytes], None],
) -> Subscription:
    """Hand each message of a topic to ``on_message`` as serialized bytes.

    Args:
        node: the caller spins the node.
        topic: absolute name of the topic.
        message_type: class of the messages.
        quality: quality of service that is requested; ``depth`` messages may wait.
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
