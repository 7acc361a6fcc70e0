"""Exact motion in every phase, the law at an impact, and where the next phase begins."""

from impact_observer.dynamics.clutch import Clutches
from impact_observer.dynamics.estimation import (
    Correction,
    correction,
    lengths,
    product,
    triangular,
)
from impact_observer.dynamics.flow import Flow, Motion
from impact_observer.dynamics.impact_law import ImpactLaw
from impact_observer.dynamics.lasting import Resting, resting
from impact_observer.dynamics.location import DEPTH, Crossing, Search
from impact_observer.dynamics.noise import diffusion
from impact_observer.dynamics.parametric import Map, Sensitivity, led
from impact_observer.dynamics.phase import Phase, Phases
from impact_observer.dynamics.projection import KEPT, PositionProjection
from impact_observer.dynamics.scales import sizes
from impact_observer.dynamics.spectral import flow_of
from impact_observer.dynamics.switched import (
    LEAST,
    ROUNDING,
    Expansion,
    Jet,
    Measured,
    Mirror,
    Rates,
)
from impact_observer.dynamics.watched import Watched

__all__ = [
    "DEPTH",
    "KEPT",
    "LEAST",
    "ROUNDING",
    "Clutches",
    "Correction",
    "Crossing",
    "Expansion",
    "Flow",
    "ImpactLaw",
    "Jet",
    "Map",
    "Measured",
    "Mirror",
    "Motion",
    "Phase",
    "Phases",
    "PositionProjection",
    "Rates",
    "Resting",
    "Search",
    "Sensitivity",
    "Watched",
    "correction",
    "diffusion",
    "flow_of",
    "led",
    "lengths",
    "product",
    "resting",
    "sizes",
    "triangular",
]
