# SPDX-License-Identifier: Apache-2.0
"""Model files with ``unit: deg``: angles in degrees become radians before the file is read."""

import math
import re
from collections.abc import Collection, Iterator, Mapping
from typing import Any, TypeAlias

from impact_observer.errors import ModelError
from impact_observer.model.document import Value

DEGREES = "deg"
"""The unit of a model file in which angles are in degrees, and speeds in degrees a second."""
_UNIT = re.compile(rf"^unit *: *[\"']?{DEGREES}[\"']? *(#.*)?$", re.MULTILINE)
_OF_CONTACTS = ("limit", "gap")
_OF_REBOUNDS, _OF_STATES = ("speed", "speeds"), ("position", "velocity")
Place: TypeAlias = tuple[str | int, ...]
"""The path of a value in a model file."""


def is_in_degrees(text: str) -> bool:
    """Whether the ``text`` of a model file has angles in degrees."""
    return _UNIT.search(text) is not None


def radians(document: Value) -> dict[Place, Value]:
    """The angles of a model file in radians, and its unit, by their places.

    Angles are limits and gaps of stops, amplitudes of grounds, and the initial state; speeds of
    impacts are turned, too. Phases and frequencies are in rad and rad/s in every file, and forces,
    stiffness and damping in N m, N m/rad and N m s/rad.

    Raises:
        ModelError: the file has angles in a table or a covariance, which are not converted.
    """
    if not isinstance(document, Mapping):
        return {}
    if "uncertainty" in document:
        problem = f"does not go with unit: {DEGREES}; expected unit: rad, or deviations beside"
        raise ModelError("uncertainty", f"{problem} the numbers")
    return {
        **{place: _turned(value) for place, value in _angles(document)},
        ("unit",): "rad",
    }


def _angles(document: Mapping[str, Any]) -> Iterator[tuple[Place, Value]]:
    """The places and values of angles and their speeds."""
    for kind in ("stops", "contacts"):
        for i, each in _members(document.get(kind)):
            yield from _of_keys((kind, i), each, _OF_CONTACTS)
            yield from _of_keys((kind, i, "restitution"), each.get("restitution"), _OF_REBOUNDS)
    for i, each in _members(document.get("grounds")):
        motion = each.get("motion")
        if not isinstance(motion, Mapping):
            continue
        if "sampled" in motion:
            problem = f"a table does not go with unit: {DEGREES}; expected unit: rad"
            raise ModelError(f"grounds[{i}].motion.sampled", problem)
        for k, harmonic in _members(motion.get("harmonics")):
            place = ("grounds", i, "motion", "harmonics", k)
            yield from _of_keys(place, harmonic, ("amplitude",))
    yield from _of_keys(("initial_state",), document.get("initial_state"), _OF_STATES)


def _of_keys(place: Place, section: Value, keys: Collection[str]) -> Iterator[tuple[Place, Value]]:
    """The places and values of the keys that a section, if it is one, has."""
    if isinstance(section, Mapping):
        yield from (((*place, key), section[key]) for key in keys if key in section)


def _members(value: Value) -> Iterator[tuple[int, Mapping[str, Any]]]:
    """The mappings in a list, with their indices."""
    for i, each in enumerate(value if isinstance(value, list) else ()):
        if isinstance(each, Mapping):
            yield i, each


def _turned(value: Value) -> Value:
    """A number, a list of numbers, or a number with its deviation, in radians."""
    if isinstance(value, list):
        return [_turned(each) for each in value]
    if isinstance(value, Mapping):
        return {key: _turned(each) for key, each in value.items()}
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return math.radians(value) if is_number else value  # type: ignore[arg-type]
