"""The detector: what sensors really say, turned into events. No ROS, no bags.

A :class:`Detector` is fed messages of any origin in the order of their arrival; a node and a bag
give it the same ones, so both say the same events.
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
