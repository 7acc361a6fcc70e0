# SPDX-License-Identifier: Apache-2.0
"""Message classes, qualities of service, and messages that wait, by ``rclpy``."""

from array import array
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from importlib import import_module
from typing import Any, TypeAlias

from rclpy.callback_groups import CallbackGroup
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from impact_observer.errors import UsageError
from impact_observer.io.interfaces import Quality, usual_quality
from impact_observer.io.messages import AnyMessage, Messages
from impact_observer.states import Vector

MessageInfo: TypeAlias = Mapping[str, int]
"""Data of the middleware on a message, such as its ``source_timestamp``, ns."""


@cache
def message_class(type_name: str) -> AnyMessage:
    """The ROS class of a message type, such as ``sensor_msgs/msg/JointState``.

    Raises:
        UsageError: its interface package is not installed, or not sourced.
    """
    package, _, name = type_name.partition("/")
    module, _, name = name.partition("/")
    try:
        return getattr(import_module(f"{package}.{module}"), name)
    except (ImportError, AttributeError) as error:
        raise UsageError(
            f"{type_name}: no such ROS message here ({error}); build or source {package}"
        ) from error


@cache
def ros_messages() -> Messages:
    """The maker of messages of the classes of ROS."""
    return Messages(message_class, _floats)


def _floats(values: Vector) -> "array[float]":
    """The numbers as an ``array``, which ROS takes for ``float64[]`` without a check of each."""
    numbers = array("d")
    numbers.frombytes(values.tobytes())
    return numbers


def qos_profile(quality: Quality) -> QoSProfile:
    """The profile of ``quality``, to offer or to request."""
    offered = quality.offered()  # its policies have the numbers of those of rclpy
    return QoSProfile(
        history=HistoryPolicy(offered.history.value),
        depth=offered.depth,
        reliability=ReliabilityPolicy(offered.reliability.value),
        durability=DurabilityPolicy(offered.durability.value),
    )


def common_offer(topic: str, publishers: Iterable[TopicEndpointInfo]) -> Quality:
    """The quality of service that all publishers of a topic offer; at least one publisher."""
    depth = usual_quality(topic).depth
    return Quality.common(Quality.of_publisher(each.qos_profile, depth) for each in publishers)


class PolledGroup(CallbackGroup):
    """Subscriptions for which no executor wakes, as that takes longer than a read."""

    def can_execute(self, entity: object) -> bool:
        """Whether the executor waits for ``entity``: never."""
        del entity
        return False


def waiting_messages(subscription: Subscription, most: int) -> Iterator[tuple[Any, MessageInfo]]:
    """Take up to ``most`` messages that have arrived already; bytes if the subscription is raw.

    The executor takes one message each time it waits, so that a burst would overflow the queue.
    """
    with (handle := subscription.handle):
        for _ in range(most):
            if (taken := handle.take_message(subscription.msg_type, subscription.raw)) is None:
                return
            yield taken
