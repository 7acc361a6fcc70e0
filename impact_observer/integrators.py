# SPDX-License-Identifier: Apache-2.0
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
