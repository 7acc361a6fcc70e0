# SPDX-License-Identifier: Apache-2.0
"""The detector: turns messages of sensors into impact events.

The node and the command ``detect`` feed a :class:`Detector` with the same messages in the order of
reception, so both detect the same events.
"""

from impact_observer.detector.detection import Detection, Detector
from impact_observer.detector.sensor_file import parse_sources, read_sources
from impact_observer.detector.sensors import SensorCounts
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
