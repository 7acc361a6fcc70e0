"""Bags: topics, messages, reader and writer, without ROS.

Bags are read and written by ``rosbags``; nothing in this room imports ``rclpy``. The same tables
and conversions serve the nodes, which bring their own message classes.
"""

from impact_observer.io.interfaces import Quality
from impact_observer.io.messages import EstimateError, JointState
from impact_observer.io.reader import BagReader
from impact_observer.io.writer import BagWriter, copy_topics

__all__ = ["BagReader", "BagWriter", "EstimateError", "JointState", "Quality", "copy_topics"]
