"""The plant: the impacting system itself, integrated from event to event."""

from impact_observer.plant.plant import Impact, Plant, event_of
from impact_observer.plant.simulation import Run, simulate

__all__ = ["Impact", "Plant", "Run", "event_of", "simulate"]
