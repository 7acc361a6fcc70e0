# Copyright 2026 impact_observer developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

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
