"""The observer: a replica of the plant, switched by nothing but impact events."""

from impact_observer.observer.initial import initial_state
from impact_observer.observer.laws import Law, law_named, law_names
from impact_observer.observer.observer import DEFAULT_HISTORY, Observer
from impact_observer.observer.replay import replay

__all__ = [
    "DEFAULT_HISTORY",
    "Law",
    "Observer",
    "initial_state",
    "law_named",
    "law_names",
    "replay",
]
