# SPDX-License-Identifier: Apache-2.0
"""The detector: turns what sensors publish into impact events. No ROS, no bags.

A :class:`Detector` is fed with messages in the order in which they were received. The node and the
command ``detect`` feed it with the same messages, so both find the same events.
"""

from impact_observer.detector.detection import Detection, Detector, SensorCounts
from impact_observer.detector.sensor_file import parse_sources, read_sources
from impact_observer.detector.source import KINDS, Source

__all__ = [
    "KINDS",
    "Detection",
    "Detector",
    "SensorCounts",
    "Source",
    "parse_sources",
    "read_sources",
]
