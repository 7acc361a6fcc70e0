# SPDX-License-Identifier: Apache-2.0
"""ROS message classes by type name, and the maker of ROS messages."""

from array import array
from functools import cache
from importlib import import_module

from impact_observer.errors import UsageError
from impact_observer.io.messages import AnyMessage, Messages
from impact_observer.states import Vector


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
