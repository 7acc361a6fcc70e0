# SPDX-License-Identifier: Apache-2.0
"""Subscriptions that take all messages that wait, and follow the publishers of their topic."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeAlias

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from impact_observer.io.interfaces import Quality, usual_quality
from impact_observer.io.messages import AnyMessage, MessageError
from impact_observer.ros.message_classes import message_class
from impact_observer.ros.qos import offered_quality, qos_profile

if TYPE_CHECKING:
    from impact_observer.ros.base_node import BaseNode

MOST_TOGETHER = 200
"""Messages that one call of a callback takes at most: then timers and services have their turn."""
MessageInfo: TypeAlias = Mapping[str, int]
"""Data of the middleware on a message, such as its ``source_timestamp``, ns."""
FOLLOWING = SubscriptionEventCallbacks(use_default_callbacks=False)
"""For a receiver that connects anew where a publisher does not fit: no log line says so."""


class PolledGroup(CallbackGroup):
    """A subscription whose messages are polled by ``Receiver.waiting``.

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


class Receiver:
    """Receives the messages of one topic, whose publishers may change their type and quality.

    Messages are taken as bytes. A message that is longer than the parameter ``max_message`` is
    refused before its conversion, which may take seconds. So is a message that cannot be
    converted or read. The node counts and tells what is refused.

    Attributes:
        topic: absolute name of the topic.
        offers: by type, the quality that all publishers offer, as of the last ``look``. One that
            was volatile stays so while there is a publisher: past messages would come again.
        type_name: type of the messages that are received; empty while none are.
        most_together: messages that are handed over together at most.
    """

    def __init__(
        self,
        node: "BaseNode",
        topic: str,
        on_messages: Callable[[list[Any]], None],
        *,
        read: Callable[[AnyMessage, MessageInfo], object] = lambda message, _: message,
        event_callbacks: SubscriptionEventCallbacks | None = None,
        group: CallbackGroup | None = None,
    ) -> None:
        """Receive nothing yet.

        Args:
            node: owner of the subscription, with the parameter ``max_message``.
            topic: name of the topic.
            on_messages: called with what is read of messages that wait together, in the order of
                arrival; at least one.
            read: what is handed over for a message; may raise a ``MessageError``.
            event_callbacks: called for events of the middleware; None for the usual log lines.
            group: callback group; None for that of the node.
        """
        self._node, self._group, self._event_callbacks = node, group, event_callbacks
        self._on_messages, self._read = on_messages, read
        self._most_bytes = node.values.integer("max_message")
        self._quality: Quality | None = None
        self._subscription: Subscription | None = None
        self.topic: str = node.resolve_topic_name(topic)
        self.offers: dict[str, Quality] = {}
        self.type_name = ""
        self.most_together = MOST_TOGETHER

    @property
    def fault(self) -> str:
        """What is wrong with the publishers, as of the last ``look``; empty for nothing."""
        if not self.offers:
            return f"no node publishes {self.topic}"
        others = ", ".join(each for each in self.offers if each != self.type_name)
        return f"{self.topic}: {others} is published and not received" if others else ""

    def look(self) -> bool:
        """Look at the publishers; whether they offer other types or qualities than before."""
        by_type: dict[str, list[TopicEndpointInfo]] = {}
        for each in self._node.get_publishers_info_by_topic(self.topic):
            by_type.setdefault(each.topic_type, []).append(each)
        before, self.offers = self.offers, {}
        for name, publishers in by_type.items():
            offer = common_offer(self.topic, publishers)
            keeps = offer.transient_local and before.get(name, offer).transient_local
            self.offers[name] = replace(offer, transient_local=keeps)
        return self.offers != before

    def connect(self, type_name: str, quality: Quality) -> None:
        """Receive messages of a type, with a quality of service, from now on.

        Raises:
            UsageError: the type is not installed.
        """
        if (type_name, quality) == (self.type_name, self._quality):
            return
        kind = message_class(type_name)
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
        self.type_name, self._quality = type_name, quality
        self._subscription = self._node.create_subscription(
            kind,
            self.topic,
            self._take,
            qos_profile(quality),
            callback_group=self._group,
            event_callbacks=self._event_callbacks,
            raw=True,
        )

    def waiting(self, most: int) -> list[Any]:
        """What is read of up to ``most`` messages that have arrived already."""
        if self._subscription is None:
            return []
        taken = waiting_messages(self._subscription, most)
        return [used for each in taken for used in self._used(*each)]

    def _take(self, data: bytes, info: MessageInfo) -> None:
        """Hand over a message and those that wait behind it."""
        if got := [*self._used(data, info), *self.waiting(self.most_together - 1)]:
            self._on_messages(got)

    def _used(self, data: bytes, info: MessageInfo) -> Iterator[Any]:
        """Yields what is read of a message, unless the message is refused."""
        try:
            if len(data) > self._most_bytes:
                limit = f"max_message allows {self._most_bytes}"
                raise MessageError(f"a message of {len(data)} bytes; {limit}")
            yield self._read(deserialize_message(data, message_class(self.type_name)), info)
        except Exception as error:  # noqa: BLE001 (anybody may publish anything)
            self._node.note(f"{self.topic}: refused", f"{self.topic}: {error}")


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
