# Copyright 2026 impact_observer developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""The observer: a replica of the plant, switched by nothing but impact events."""

from impact_observer.estimation.contact_change import ContactChange
from impact_observer.estimation.ensemble import Ensemble
from impact_observer.estimation.uncertainty import Uncertainty, deviation_of
from impact_observer.events import Contacts
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
