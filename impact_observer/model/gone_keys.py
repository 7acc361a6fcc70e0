# SPDX-License-Identifier: Apache-2.0
"""Keys and values of files that version 0.4.0 took out."""

import re

_BY_SPEED = "a table of restitutions by speed"
_DRIVE = "the drive whose index pulses tell a force's phase"
_OF_CONTACTS = {
    "contact_time": "the duration of an impact",
    "velocity_offset": "the speed of a stop that drives what it hits",
    "restitution.speeds": _BY_SPEED,
    "restitution.values": _BY_SPEED,
}
GONE = {
    "friction": "dry friction of guides",
    "grounds.motion.live": "a ground whose motion arrives live",
    "forces.order": _DRIVE,
    "forcing.harmonics.order": _DRIVE,
    **{f"stops.{key}": purpose for key, purpose in _OF_CONTACTS.items()},
    **{f"contacts.{key}": purpose for key, purpose in _OF_CONTACTS.items()},
    "measurements.gain": "the use of samples by laws without covariance",
    "measurements.deviation: learn": "learn",
    "unit: deg": "the conversion of degrees",
}
"""What went, by its key without indices such as ``stops.gap``, or by key and value."""


def gone(key: str, value: object = None) -> str:
    """Why ``key``, such as ``stops[0].gap``, cannot have its ``value``; empty where nothing went.

    Args:
        key: the key in the file.
        value: what stands there; None asks for the key alone.
    """
    place = re.sub(r"\[\d+\]", "", key)
    purpose = GONE.get(place if value is None else f"{place}: {value}")
    return f"{purpose} went in 0.4.0; impact_observer 0.3.0 has it" if purpose else ""
