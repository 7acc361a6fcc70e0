# SPDX-License-Identifier: Apache-2.0
"""Exact motion between events, the law at an impact, and where a phase of motion ends.

``mechanism`` is what other rooms ask of a model, and ``linear_mechanism`` answers for linear
systems: ``flow`` moves a state through one linear phase by the ``exponential`` of its matrix,
``phase`` has the phases of a system, ``contact`` closes and opens contacts, ``watched`` says what
ends a phase, ``roots`` finds when, and ``tangent`` has derivatives.
"""

from impact_observer.dynamics.contact.clutch import Clutches, Piecewise
from impact_observer.dynamics.contact.impact_law import ImpactLaw
from impact_observer.dynamics.contact.persistent_contact import ended, persistent_contacts
from impact_observer.dynamics.contact.projection import KEPT, PositionProjection
from impact_observer.dynamics.flow import Flow, Motion, PhaseMotion
from impact_observer.dynamics.linear_mechanism import LinearMechanism
from impact_observer.dynamics.mechanism import Grip, Mechanism, mechanism_of
from impact_observer.dynamics.phase import Phase, Phases
from impact_observer.dynamics.roots import Guards, RootSearch
from impact_observer.dynamics.scales import Scales
from impact_observer.dynamics.watched import DEPTH, End, Watch, watch

__all__ = [
    "DEPTH",
    "KEPT",
    "Clutches",
    "End",
    "Flow",
    "Grip",
    "Guards",
    "ImpactLaw",
    "LinearMechanism",
    "Mechanism",
    "Motion",
    "Phase",
    "PhaseMotion",
    "Phases",
    "Piecewise",
    "PositionProjection",
    "RootSearch",
    "Scales",
    "Watch",
    "ended",
    "mechanism_of",
    "persistent_contacts",
    "watch",
]
