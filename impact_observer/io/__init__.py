# SPDX-License-Identifier: Apache-2.0
"""Bags: topics, messages, reader and writer, without ROS.

Bags are read by ``rosbags`` and written by ``mcap``; nothing in this room imports ``rclpy``. The
same tables and conversions serve the nodes, which bring their own message classes. The names
below are imported when they are first used: comparisons without a bag need none of them.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from impact_observer.io.interfaces import Quality
    from impact_observer.io.messages import EstimateError, JointState
    from impact_observer.io.reader import BagReader
    from impact_observer.io.writer import BagWriter

_HOME = {
    "BagReader": "reader",
    "BagWriter": "writer",
    "EstimateError": "messages",
    "JointState": "messages",
    "Quality": "interfaces",
}
"""Module of each public name."""

__all__ = ["BagReader", "BagWriter", "EstimateError", "JointState", "Quality"]


def __getattr__(name: str) -> object:
    """A public name, imported from its module."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
