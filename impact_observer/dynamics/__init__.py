"""Exact motion in every phase, the law at an impact, and where the next phase begins."""

from impact_observer.dynamics.clutch import Clutches
from impact_observer.dynamics.flow import Flow, Motion
from impact_observer.dynamics.impact_law import ImpactLaw
from impact_observer.dynamics.lasting import Resting, resting
from impact_observer.dynamics.location import DEPTH, Crossing, Search, window
from impact_observer.dynamics.phase import Phase, Phases, timescale
from impact_observer.dynamics.projection import KEPT, PositionProjection
from impact_observer.dynamics.spectral import flow_of
from impact_observer.dynamics.watched import Watched

__all__ = [
    "DEPTH",
    "KEPT",
    "Clutches",
    "Crossing",
    "Flow",
    "ImpactLaw",
    "Motion",
    "Phase",
    "Phases",
    "PositionProjection",
    "Resting",
    "Search",
    "Watched",
    "flow_of",
    "resting",
    "timescale",
    "window",
]
