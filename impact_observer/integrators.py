"""The names of the plant's integrators, cheap to import where they can be chosen."""

EVENT_DRIVEN = "event-driven"
"""Exact motion from event to event."""
MOREAU = "moreau"
"""Moreau's time stepping."""
INTEGRATORS = (EVENT_DRIVEN, MOREAU)
DEFAULT_STEP = 1e-4
"""Length of the steps of ``moreau``, s."""


def described(integrator: str, step: float) -> str:
    """An integrator with its steps of ``step`` s, if it takes any."""
    return f"{integrator}, steps of {step:g} s" if integrator == MOREAU else integrator
