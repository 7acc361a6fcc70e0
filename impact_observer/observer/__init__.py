# SPDX-License-Identifier: Apache-2.0
"""The observer: a replica of the plant, switched by nothing but impact events."""

from impact_observer.events import Contacts
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.ensemble import Ensemble
from impact_observer.filter.uncertainty import Uncertainty, deviation_of
from impact_observer.observer.belief import Belief, Prediction
from impact_observer.observer.laws import Law, ReplicaLaw, law_named, law_names
from impact_observer.observer.make_observer import (
    initial_state,
    make_observer,
    options_of_laws,
)
from impact_observer.observer.observer import Observer
from impact_observer.observer.replay import replay, replay_batches
from impact_observer.observer.synchronization import LARGEST_INNOVATION
from impact_observer.options import Options

__all__ = [
    "LARGEST_INNOVATION",
    "Belief",
    "ContactChange",
    "Contacts",
    "Ensemble",
    "Law",
    "Observer",
    "Options",
    "Prediction",
    "ReplicaLaw",
    "Uncertainty",
    "deviation_of",
    "initial_state",
    "law_named",
    "law_names",
    "make_observer",
    "options_of_laws",
    "replay",
    "replay_batches",
]
