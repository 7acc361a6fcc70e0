# SPDX-License-Identifier: Apache-2.0
"""The observer: a replica of the plant, switched by nothing but impact events."""

from impact_observer.observer.belief import Belief
from impact_observer.observer.laws import Law, ReplicaLaw, law_named, law_names
from impact_observer.observer.make_observer import (
    initial_state,
    make_observer,
    options_of_laws,
)
from impact_observer.observer.observer import Observer
from impact_observer.observer.replay import replay, replay_batches
from impact_observer.options import Options

__all__ = [
    "Belief",
    "Law",
    "Observer",
    "Options",
    "ReplicaLaw",
    "initial_state",
    "law_named",
    "law_names",
    "make_observer",
    "options_of_laws",
    "replay",
    "replay_batches",
]
