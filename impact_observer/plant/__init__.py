# SPDX-License-Identifier: Apache-2.0
"""The plant: the impacting system itself, integrated from event to event."""

from impact_observer.plant.event_driven import Plant
from impact_observer.plant.random_parameters import RandomPlant, random_plant
from impact_observer.plant.sensor import (
    IDEAL,
    SensorMessage,
    SensorModel,
    SensorSimulation,
    simulate_sensor,
)
from impact_observer.plant.simulation import Run, simulate
from impact_observer.plant.switching import Switching

__all__ = [
    "IDEAL",
    "Plant",
    "RandomPlant",
    "Run",
    "SensorMessage",
    "SensorModel",
    "SensorSimulation",
    "Switching",
    "random_plant",
    "simulate",
    "simulate_sensor",
]
