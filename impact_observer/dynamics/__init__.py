"""Exact motion between impacts, the law at an impact, and where the next impact lies."""

from impact_observer.dynamics.flow import Flow, Motion
from impact_observer.dynamics.impact_law import ImpactLaw
from impact_observer.dynamics.location import Closing, ContactSearch
from impact_observer.dynamics.projection import PositionProjection
from impact_observer.dynamics.spectral import flow_of

__all__ = [
    "Closing",
    "ContactSearch",
    "Flow",
    "ImpactLaw",
    "Motion",
    "PositionProjection",
    "flow_of",
]
