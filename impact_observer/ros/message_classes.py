# SPDX-License-Identifier: Apache-2.0
"""ROS message classes by type name, and conversions that need them."""

from array import array
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING

from impact_observer.errors import UsageError
from impact_observer.io.messages import (
    AnyMessage,
    JointState,
    MessageError,
    Messages,
    read_joint_state,
)
from impact_observer.plain_text import printable
from impact_observer.states import Vector

if TYPE_CHECKING:
    from rclpy.node import Node


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
    """Makes messages of the classes of ROS."""
    return Messages(message_class, _floats)


def read_state(
    node: "Node", topic: str, message: AnyMessage, names: tuple[str, ...]
) -> JointState | None:
    """The state in a message, with its columns in the order of ``names``.

    Args:
        node: logs an error where the message has no state, or other coordinates.
        topic: the message's topic.
        message: a joint state.
        names: the coordinates of the node's model.
    """
    try:
        return read_joint_state(message).ordered(names)
    except MessageError as error:
        node.get_logger().error(printable(f"{topic}: {error}"), throttle_duration_sec=5.0)
        return None


def _floats(values: Vector) -> "array[float]":
    """The numbers as ROS classes take them for a ``float64[]`` without checking each."""
    numbers = array("d")
    numbers.frombytes(values.tobytes())
    return numbers
