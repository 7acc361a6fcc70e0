# SPDX-License-Identifier: Apache-2.0
"""Reading a message: numbers by the path of a field, and the stamp of the header.

Only attributes are used, which messages of ``rosbags`` and of ``rclpy`` have in common.
"""

import re
from collections.abc import Iterable, Sequence, Sized
from typing import TypeAlias

import numpy as np

from impact_observer.stamps import NS_PER_S

FieldPath: TypeAlias = tuple[str | int, ...]
"""Names and indices, outermost first."""

_PATH = re.compile(r"[A-Za-z]\w*(\[\d+\])*(\.[A-Za-z]\w*(\[\d+\])*)*", re.ASCII)
_PART = re.compile(r"[A-Za-z]\w*|\d+", re.ASCII)
_AXES = ("x", "y", "z")


def parse_path(text: str) -> FieldPath:
    """The parts of a path such as ``wrench.force.z`` or ``data[3]``.

    Raises:
        ValueError: ``text`` is no path; the caller puts the key before the message.
    """
    if not _PATH.fullmatch(text):
        raise ValueError(f"{text!r} found; expected a path such as wrench.force.z or data[3]")
    return tuple(int(part) if part.isdigit() else part for part in _PART.findall(text))


def numbers_at(message: object, path: FieldPath) -> tuple[float, ...]:
    """The numbers at ``path``: one, or the components of a vector or an array.

    Raises:
        ValueError: the field is missing or holds no numbers; the caller puts the key before the
            message.
    """
    value = message
    for depth, part in enumerate(path):
        value = _member(value, part, path_text(path[:depth]) or "the message")
    if hasattr(value, "x") and hasattr(value, "y"):
        value = [getattr(value, axis) for axis in _AXES if hasattr(value, axis)]
    numbers = np.asarray(value).ravel() if not isinstance(value, str) else np.empty(0)
    if numbers.dtype.kind not in "biuf" or not numbers.size:
        raise ValueError(f"{path_text(path)} holds no number{_list_of_fields(value)}")
    return tuple(float(number) for number in numbers.tolist())


def path_text(path: FieldPath) -> str:
    """``path`` as text."""
    parts = (f"[{part}]" if isinstance(part, int) else f".{part}" for part in path)
    return "".join(parts).lstrip(".")


def header_stamp(message: object) -> int | None:
    """The stamp (ns) of a message with a header, or of a header; None if missing or 0."""
    header = getattr(message, "header", message)
    time = getattr(header, "stamp", None)
    if time is None or not (hasattr(time, "sec") and hasattr(time, "nanosec")):
        return None
    stamp = int(time.sec) * NS_PER_S + int(time.nanosec)
    return stamp if stamp > 0 else None


def _member(value: object, part: str | int, where: str) -> object:
    """A field by its name, or a member by its index."""
    if isinstance(part, str):
        if part not in _names(value):
            raise ValueError(f"{where} has no {part}{_list_of_fields(value)}")
        return getattr(value, part)
    if isinstance(value, (Sequence, np.ndarray)) and part < len(value):
        return value[part]
    length = f"{len(value)} members" if isinstance(value, Sized) else "no members"
    raise ValueError(f"{where} has {length}, so it has no [{part}]")


def _names(message: object) -> list[str]:
    """Names of a message's fields."""
    fields = getattr(message, "get_fields_and_field_types", None)  # of rclpy
    names: Iterable[str] = fields() if fields else getattr(message, "__dataclass_fields__", ())
    return [name for name in names if not name.startswith("_")]


def _list_of_fields(message: object) -> str:
    """The fields of a message, as the end of an error line."""
    names = _names(message)
    return f"; its fields: {', '.join(names)}" if names else ""
