"""Subscribing to what the publishers of a topic offer, and taking all that has come at once."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from itertools import islice
from typing import Any, TypeAlias

from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from impact_observer.io.interfaces import Quality, usual_quality
from impact_observer.io.messages import MessageClass
from impact_observer.ros.qos import offered_quality, qos_profile

Info: TypeAlias = Mapping[str, int]
"""What the middleware says of a message: its ``source_timestamp`` among other things, ns."""


def common_offer(topic: str, publishers: Iterable[TopicEndpointInfo]) -> Quality:
    """What all publishers of a topic offer; at least one."""
    depth = usual_quality(topic).depth
    return Quality.common(offered_quality(each.qos_profile, depth) for each in publishers)


def waiting(
    subscription: Subscription, most: int, *, raw: bool = False
) -> Iterator[tuple[Any, Info]]:
    """Messages that have come already, ``most`` of them at most; bytes where ``raw``.

    The executor's own work for a message is several times that of taking it, so that a burst
    would run ahead of it: a callback that has one takes those that wait behind it too.
    """
    with subscription.handle:
        take = partial(subscription.handle.take_message, subscription.msg_type, raw)
        yield from islice(iter(take, None), most)


def subscribe_raw(
    node: Node,
    topic: str,
    message_type: MessageClass,
    quality: Quality,
    hear: Callable[[str, bytes], None],
) -> Subscription:
    """Hand each message of a topic to ``hear``, as serialized.

    Args:
        node: the caller spins it.
        topic: the absolute name.
        message_type: its class.
        quality: what to ask for; the depth is how far the topic may be ahead of us.
        hear: told the topic and the bytes.
    """

    def take(data: bytes) -> None:
        hear(topic, data)
        for behind, _ in waiting(subscription, quality.depth, raw=True):
            hear(topic, behind)

    subscription = node.create_subscription(
        message_type, topic, take, qos_profile(quality), raw=True
    )
    return subscription
