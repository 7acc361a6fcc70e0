"""ROS message classes by type name, and our values as ROS messages."""

from array import array
from functools import cache
from importlib import import_module
from typing import cast

from impact_observer.bag.messages import MessageClass, Messages
from impact_observer.errors import UsageError
from impact_observer.states import Vector


@cache
def message_class(type_name: str) -> MessageClass:
    """The ROS class of a message type, such as ``sensor_msgs/msg/JointState``.

    Raises:
        UsageError: its interface package is not installed, or not sourced.
    """
    package, _, name = type_name.partition("/")
    module, _, name = name.partition("/")
    try:
        return cast("MessageClass", getattr(import_module(f"{package}.{module}"), name))
    except (ImportError, AttributeError) as error:
        raise UsageError(
            f"{type_name}: no such ROS message here ({error}); build or source {package}"
        ) from error


@cache
def ros_messages() -> Messages:
    """Messages of the classes of ROS, to be published."""
    return Messages(message_class, _floats)


def _floats(values: Vector) -> "array[float]":
    """What ROS classes take for a ``float64[]`` without looking at each number."""
    numbers = array("d")
    numbers.frombytes(values.tobytes())
    return numbers
