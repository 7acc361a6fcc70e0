"""The observer: a replica of the plant, switched by nothing but impact events."""

from impact_observer.events import Contacts
from impact_observer.observer.agreement import AGREED, SURPRISING
from impact_observer.observer.belief import Belief, Course, Touch
from impact_observer.observer.ensemble import Ensemble
from impact_observer.observer.initial import initial_state
from impact_observer.observer.laws import Law, ReplicaLaw, law_named, law_names
from impact_observer.observer.observer import DEFAULT_ENSEMBLE, DEFAULT_HISTORY, Observer
from impact_observer.observer.options import COMPILING, Options
from impact_observer.observer.replay import replay, replay_together
from impact_observer.observer.uncertainty import Uncertainty, deviation_of

__all__ = [
    "AGREED",
    "COMPILING",
    "DEFAULT_ENSEMBLE",
    "DEFAULT_HISTORY",
    "SURPRISING",
    "Belief",
    "Contacts",
    "Course",
    "Ensemble",
    "Law",
    "Observer",
    "Options",
    "ReplicaLaw",
    "Touch",
    "Uncertainty",
    "deviation_of",
    "initial_state",
    "law_named",
    "law_names",
    "replay",
    "replay_together",
]
