# SPDX-License-Identifier: Apache-2.0
"""The keys of a model file, or of one of measurements, that version 0.4.0 took out."""

import re
from collections.abc import Mapping

GONE = {
    "friction": "dry friction of guides",
    "grounds.motion.live": "a ground whose motion arrives live",
    "forces.order": "the drive whose index pulses tell a force's phase",
    "forcing.harmonics.order": "the drive whose index pulses tell a force's phase",
    **{
        f"{contacts}.{key}": purpose
        for contacts in ("stops", "contacts")
        for key, purpose in {
            "contact_time": "the duration of an impact",
            "velocity_offset": "the speed of a stop that drives what it hits",
            "restitution.speeds": "a table of restitutions by speed",
            "restitution.values": "a table of restitutions by speed",
        }.items()
    },
    "measurements.gain": "the use of samples by laws without covariance",
}
"""What each key was for, by its place without indices, such as ``stops.gap``."""
_INSTEAD: dict[str, object] = {"restitution": 0.0, "motion": {"harmonics": []}}
"""What stands where all keys of a mapping went, for the comparison of states."""


def problem_with(key: str, allowed: str) -> str:
    """Why ``key``, such as ``stops[0].gap``, cannot stand where ``allowed`` keys are expected."""
    if (purpose := GONE.get(re.sub(r"\[\d+\]", "", key))) is not None:
        return f"{purpose} went in 0.4.0; impact_observer 0.3.0 has it; expected no such key"
    return f"is not known here; expected one of {allowed}"


def problem_with_unit(found: str, wanted: str) -> str:
    """Why ``unit`` cannot be ``found``, where ``wanted`` units are expected."""
    if found == "deg":
        went = "the conversion of degrees went in 0.4.0; impact_observer 0.3.0 has it"
        return f"{went}; expected {wanted}"
    return f"{found!r} found; expected {wanted}"


def without_gone(document: object, place: str = "") -> object:
    """A ``document`` for the comparison of states: without gone keys and deviations.

    Energies of differences, names of coordinates and names of contacts are those of the whole
    document, which stands at ``place``.
    """
    if isinstance(document, list):
        return [without_gone(each, place) for each in document]
    if not isinstance(document, Mapping):
        return document
    places = {key: f"{place}.{key}".removeprefix(".") for key in document}
    kept = {
        key: without_gone(each, places[key])
        for key, each in document.items()
        if places[key] not in {*GONE, "uncertainty"}
    }
    return kept if kept or not document else _INSTEAD[place.rpartition(".")[2]]
