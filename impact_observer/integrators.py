# SPDX-License-Identifier: Apache-2.0
"""The names of the plant's integrators; this module imports none of the integrators."""

EVENT_DRIVEN = "event-driven"
"""Exact motion from event to event."""
MOREAU = "moreau"
"""Moreau's time stepping."""
INTEGRATORS = (EVENT_DRIVEN, MOREAU)
DEFAULT_STEP = 1e-4
"""Length of the steps of ``moreau``, s."""


def described(integrator: str, step: float) -> str:
    """Returns the name of an integrator; ``step`` (s) is added for time stepping."""
    return f"{integrator}, steps of {step:g} s" if integrator == MOREAU else integrator
