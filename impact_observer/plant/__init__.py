"""The plant: the impacting system itself, integrated from event to event or step by step."""

from impact_observer.plant.master import Master, make_plant
from impact_observer.plant.plant import Plant
from impact_observer.plant.simulation import Run, simulate
from impact_observer.plant.switching import Switching, event_of
from impact_observer.plant.time_stepping import TimeSteppingPlant

__all__ = [
    "Master",
    "Plant",
    "Run",
    "Switching",
    "TimeSteppingPlant",
    "event_of",
    "make_plant",
    "simulate",
]
