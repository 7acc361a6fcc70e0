"""Bags: topics, messages, reader and writer, without ROS.

Bags are read and written by ``rosbags``; nothing in this room imports ``rclpy``. The same tables
and conversions serve the nodes, which bring their own message classes.
"""

from impact_observer.bag.columns import JointStates, ObserverStates
from impact_observer.bag.interfaces import Interface, Quality
from impact_observer.bag.messages import EstimateError, JointState, MessageError, Messages
from impact_observer.bag.reader import BagReader, TopicInfo
from impact_observer.bag.writer import BagWriter, copy_topics

__all__ = [
    "BagReader",
    "BagWriter",
    "EstimateError",
    "Interface",
    "JointState",
    "JointStates",
    "MessageError",
    "Messages",
    "ObserverStates",
    "Quality",
    "TopicInfo",
    "copy_topics",
]
