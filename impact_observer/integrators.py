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

"""The names of the plant's integrators, without importing them."""

EVENT_DRIVEN = "event-driven"
"""Exact motion from event to event."""
MOREAU = "moreau"
"""Moreau's time stepping."""
INTEGRATORS = (EVENT_DRIVEN, MOREAU)
DEFAULT_STEP = 1e-4
"""Length of the steps of ``moreau``, s."""


def described(integrator: str, step: float) -> str:
    """An integrator, with its step (s) if it has one."""
    return f"{integrator}, steps of {step:g} s" if integrator == MOREAU else integrator
