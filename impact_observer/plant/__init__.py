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

"""The plant: the impacting system itself, integrated from event to event or step by step."""

from impact_observer.plant.event_driven import Plant
from impact_observer.plant.master import Master, make_plant
from impact_observer.plant.sensor import (
    IDEAL,
    SensorMessage,
    SensorModel,
    SensorSimulation,
    simulate_sensor,
)
from impact_observer.plant.simulation import Run, simulate
from impact_observer.plant.switching import Switching
from impact_observer.plant.time_stepping import TimeSteppingPlant

__all__ = [
    "IDEAL",
    "Master",
    "Plant",
    "Run",
    "SensorMessage",
    "SensorModel",
    "SensorSimulation",
    "Switching",
    "TimeSteppingPlant",
    "make_plant",
    "simulate",
    "simulate_sensor",
]
