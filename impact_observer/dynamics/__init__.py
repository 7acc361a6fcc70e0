"""Exact motion between events, the law at an impact, and where a phase of motion ends.

``flow`` moves a state through one linear phase, ``contact`` closes and opens contacts, ``guards``
finds the instant at which a phase ends.
"""

from impact_observer.dynamics.contact.clutch import Clutches, Piecewise
from impact_observer.dynamics.contact.friction import Grip, ended
from impact_observer.dynamics.contact.impact_law import ImpactLaw
from impact_observer.dynamics.contact.persistent_contact import persistent_contacts
from impact_observer.dynamics.contact.projection import KEPT, PositionProjection
from impact_observer.dynamics.flow.flow import Flow, Motion
from impact_observer.dynamics.flow.phase import Phase, Phases
from impact_observer.dynamics.flow.scales import Scales, sizes
from impact_observer.dynamics.flow.strides import flow_of
from impact_observer.dynamics.guards.location import DEPTH, Crossing, Search
from impact_observer.dynamics.guards.watched import Watched

__all__ = [
    "DEPTH",
    "KEPT",
    "Clutches",
    "Crossing",
    "Flow",
    "Grip",
    "ImpactLaw",
    "Motion",
    "Phase",
    "Phases",
    "Piecewise",
    "PositionProjection",
    "Scales",
    "Search",
    "Watched",
    "ended",
    "flow_of",
    "persistent_contacts",
    "sizes",
]
