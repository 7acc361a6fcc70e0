# SPDX-License-Identifier: Apache-2.0
"""Frequencies in Hz: ``hertz`` may stand for ``frequency``, in rad/s, in forces and waves."""

import math
from collections.abc import Iterator
from typing import Any

from impact_observer.errors import ModelError
from impact_observer.model.document import Value, number

HERTZ, _FREQUENCY = "hertz", "frequency"


def convert(document: Value) -> None:
    """Write ``frequency`` for each ``hertz`` of a document that ruamel has read, in its place.

    Raises:
        ModelError: a wave has both keys, or ``hertz`` is no number.
    """
    for place, each in _harmonics(document):
        if HERTZ not in each:
            continue
        if _FREQUENCY in each:
            raise ModelError(f"{place}.{HERTZ}", f"stands beside {_FREQUENCY}; write one of them")
        value, key = each[HERTZ], f"{place}.{HERTZ}"
        if isinstance(value, dict):
            turned = {name: _turned(f"{key}.{name}", part) for name, part in value.items()}
            value.update(turned)
        else:
            value = _turned(key, value)
        each.insert(list(each).index(HERTZ), _FREQUENCY, value)
        del each[HERTZ]


def _turned(key: str, value: Value) -> float:
    return math.tau * number(key, value)


def _harmonics(document: Value) -> Iterator[tuple[str, Any]]:
    """The key and the section of each force and wave."""
    yield from _members("forces", document)
    yield from _members("forcing.harmonics", document)
    yield from _members("forcing.squares", document)
    for place, ground in _members("grounds", document):
        for key, each in _members("motion.harmonics", ground):
            yield f"{place}.{key}", each


def _members(path: str, section: Value) -> Iterator[tuple[str, Any]]:
    """The sections in the list at a ``path`` of keys; none where anything else is there."""
    for key in path.split("."):
        section = section.get(key) if isinstance(section, dict) else None
    for k, each in enumerate(section if isinstance(section, list) else ()):
        if isinstance(each, dict):
            yield f"{path}[{k}]", each
