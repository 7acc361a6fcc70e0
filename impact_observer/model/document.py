# SPDX-License-Identifier: Apache-2.0
"""Documents as values of a schema.

Every mistake is one error that names the key, what was found and what is expected.
"""

import math
import re
import types
from collections.abc import Collection, Mapping, Sequence
from typing import Annotated, Any, Literal, TypeAlias, TypeVar, Union, get_args, get_origin
from typing import get_type_hints as hints_of

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import ArrayLike

from impact_observer.errors import ModelError
from impact_observer.states import Vector, frozen

LARGEST = 1e15
"""Largest magnitude of any number of a model, SI units; products of larger numbers overflow."""
Value: TypeAlias = object
"""Any value in a YAML file."""
Number = Annotated[float, Meta(ge=-LARGEST, le=LARGEST)]
Positive = Annotated[float, Meta(gt=0.0, le=LARGEST)]
NotNegative = Annotated[float, Meta(ge=0.0, le=LARGEST)]
Share = Annotated[float, Meta(ge=0.0, le=1.0)]
Name = Annotated[str, Meta(pattern=r"^[^\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]+$")]
"""A text that can be printed, of one letter at least."""
T = TypeVar("T")
_STEP = re.compile(r"\.([^.\[]+)|\[(\d+|\.\.\.)\]")
_MESSAGE = re.compile(r"(.*?)(?: - at `(?:key` in `)?\$(.*)`)?", re.DOTALL)
_WORDS: dict[object, str] = {
    float: "a number",
    int: "a whole number",
    str: "a name",
    bool: "true or false",
    dict: "keys and values",
}
_MEMBERS: dict[object, str] = {float: "numbers", str: "names", tuple: "lists of numbers"}
"""What types, and the members of lists, are called in errors."""

_BY_SPEED = "a table of restitutions by speed"
_DRIVE = "the drive whose index pulses tell a force's phase"
_OF_CONTACTS = {
    "contact_time": "the duration of an impact",
    "velocity_offset": "the speed of a stop that drives what it hits",
    "restitution.speeds": _BY_SPEED,
    "restitution.values": _BY_SPEED,
}
_GONE = {
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
"""What version 0.4.0 took out, by its key without indices, or by key and value."""


class Keys(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Keys that stand together in a file; any other key there is an error."""


def converted(value: Value, kind: type[T], key: str = "") -> T:
    """A ``value`` of a file as a ``kind`` of the schema; ``key`` is its key in the file.

    Raises:
        ModelError: one line that names the key, what was found and what is expected.
    """
    try:
        return msgspec.convert(_without_numpy(value), kind)
    except msgspec.ValidationError as error:
        raise _explained(str(error), value, kind, key) from None


def _without_numpy(value: Value) -> Value:
    """A value, or a mapping, in which a number of an array is a number."""
    if isinstance(value, np.generic):
        return value.item()
    return {k: _without_numpy(v) for k, v in value.items()} if isinstance(value, dict) else value


def _explained(message: str, found: Value, kind: object, key: str) -> ModelError:
    """The error for a ``message`` of msgspec on the conversion of what was ``found``."""
    parts = _MESSAGE.fullmatch(message)
    problem, path = parts.groups(default="") if parts else (message, "")
    for name, index in _STEP.findall(path):
        if not isinstance(found, list | Mapping):
            break  # such as a set
        at = _alternative(kind, found)
        if isinstance(found, list):
            kind, key, found = get_args(at)[0], f"{key}[{index}]", found[int(index)]
            continue
        kind = hints_of(at, include_extras=True)[name] if name else get_args(at)[-1]
        # msgspec does not name the member of a mapping
        member = name or next(k for k, value in found.items() if not _fits(value, kind))
        key, found = f"{key}.{member}", found[member]
    key = key.removeprefix(".")
    if "`key`" in message and isinstance(found, Mapping):
        names = [str(name) for name in found if not isinstance(name, str)]
        return ModelError(f"{key}.{names[0]}".removeprefix("."), "is no text; expected a name")
    if what := re.search("(unknown|missing required) field `(.*)`", problem, re.DOTALL):
        key = f"{key}.{what[2]}".removeprefix(".")
        if what[1] != "unknown":
            return ModelError(key, "is missing")
        known = ", ".join(_alternative(kind, found).__struct_fields__)
        return ModelError(key, _gone(key) or f"is not known here; expected one of {known}")
    if isinstance(found, float | int) and not abs(found) <= LARGEST:
        return ModelError(key, f"{shown(found)} found; expected a number of at most {LARGEST:g}")
    wanted = _gone(key) or _gone(key, found)
    return ModelError(key, wanted or f"{shown(found)} found; expected {_expected(kind)}")


def _gone(key: str, value: object = None) -> str:
    """Why ``key``, such as ``stops[0].gap``, cannot have its ``value``; empty where nothing went.

    Args:
        key: the key in the file.
        value: what stands there; None asks for the key alone.
    """
    place = re.sub(r"\[\d+\]", "", key)
    purpose = _GONE.get(place if value is None else f"{place}: {value}")
    return f"{purpose} went in 0.4.0; impact_observer 0.3.0 has it" if purpose else ""


def _alternatives(kind: object) -> tuple[Any, ...]:
    """The types of which a value may be one."""
    if get_origin(kind) is Annotated:
        return _alternatives(get_args(kind)[0])
    if get_origin(kind) in (Union, types.UnionType):
        return tuple(each for part in get_args(kind) for each in _alternatives(part))
    return (kind,)


def _structs(kind: object) -> list[type[Keys]]:
    """Those of the alternatives that have keys."""
    every = _alternatives(kind)
    return [each for each in every if isinstance(each, type) and issubclass(each, Keys)]


def _alternative(kind: object, found: Value) -> type[Keys]:
    """The type of a list or a mapping, ``found``, among the alternatives."""
    wanted = tuple if isinstance(found, list) else dict
    containers = [each for each in _alternatives(kind) if get_origin(each) is wanted]
    return (containers or _structs(kind))[0]


def _fits(value: Value, kind: Any) -> bool:  # noqa: ANN401 (a type, as of a hint)
    try:
        msgspec.convert(value, kind)
    except msgspec.ValidationError:
        return False
    return True


def _expected(kind: object) -> str:
    """What a value of some ``kind`` is, in words."""
    if get_origin(kind) in (Union, types.UnionType):
        parts = [each for each in get_args(kind) if each not in (msgspec.UnsetType, type(None))]
        return " or ".join(map(_expected, parts))
    if get_origin(kind) is Annotated:
        plain, meta = get_args(kind)
        return _expected(plain) + _bounds(meta)
    if get_origin(kind) is Literal:
        return " or ".join(map(str, get_args(kind)))
    if structs := _structs(kind):
        return f"keys: {', '.join(structs[0].__struct_fields__)}"
    if get_origin(kind) is tuple:
        (member, *_) = _alternatives(get_args(kind)[0])
        return f"a list of {_MEMBERS.get(get_origin(member) or member, 'keys and values')}"
    return _WORDS.get(get_origin(kind) or kind, "something else")


def _bounds(meta: Meta) -> str:
    """The bounds of a number or of the length of a list, in words; empty for the usual ones."""
    if meta.min_length is not None:
        least, most = meta.min_length, meta.max_length
        return f", {least}" if least == most else f", at least {least}"
    low, high = meta.ge if meta.gt is None else meta.gt, meta.le if meta.lt is None else meta.lt
    if low is None or high is None or (low, high) == (-LARGEST, LARGEST):
        return ""
    if high == LARGEST:
        return f" above {low:g}" if meta.ge is None else f" of at least {low:g}"
    return f" from {low:g} to {'' if meta.lt is None else 'below '}{high:g}"


def shown(value: Value) -> str:
    """A value of a file in an error, shortened."""
    text = "nothing" if value is None else repr(value)
    return text if len(text) <= 40 else text[:37] + "..."


def vector(
    key: str, values: Sequence[float] | msgspec.UnsetType, n: int, meaning: str = ""
) -> Vector:
    """``n`` numbers, zeros where the key is absent, shape (n,); ``meaning`` is for errors.

    Raises:
        ModelError: another number of numbers.
    """
    if isinstance(values, msgspec.UnsetType):
        return np.zeros(n)
    return finite(key, values, (n,), f"a list of {n} numbers{meaning}")


def matrix(key: str, rows: Sequence[Sequence[float]], shape: tuple[int, int]) -> Vector:
    """Rows of numbers as an array of this ``shape``.

    Raises:
        ModelError: another number of rows, or of numbers in a row.
    """
    if len(rows) != shape[0]:
        problem = f"{len(rows)} rows found; expected {shape[0]} rows of {shape[1]} numbers"
        raise ModelError(key, problem)
    for i, row in enumerate(rows):
        if len(row) != shape[1]:
            problem = f"{len(row)} values found; expected a list of {shape[1]} numbers"
            raise ModelError(f"{key}[{i}]", problem)
    return np.reshape(np.array(rows, dtype=np.float64), shape)


def finite(
    key: str, values: ArrayLike, shape: tuple[int, ...], what: str, largest: float = LARGEST
) -> Vector:
    """``values`` as a frozen array of ``shape``; ``what`` names the expected value in errors.

    Raises:
        ModelError: ``values`` have another shape, or a value that is no finite number or larger
            than ``largest``.
    """
    try:
        array = frozen(values)
    except (TypeError, ValueError):
        raise ModelError(key, f"is not made of numbers only; expected {what}") from None
    if array.shape != shape:
        given = " x ".join(map(str, array.shape)) or "a single number"
        found = f"{given} values found" if array.ndim == 1 else f"has shape {given}"
        raise ModelError(key, f"{found}; expected {what}")
    if (np.abs(array) <= largest).all():
        return array
    at = np.argwhere(~(np.abs(array) <= largest))[0]
    index = "".join(f"[{i}]" for i in at)
    is_finite = math.isfinite(array[tuple(at)])
    why = f"is too large; expected at most {largest:g}" if is_finite else "is not finite"
    raise ModelError(f"{key}{index}", why)


def check_names(
    key: str,
    names: Sequence[object],
    least: str = "",
    *,
    member: str = "",
    taken: Collection[object] = (),
) -> None:
    """Check names that must differ.

    Args:
        key: of the list in errors.
        names: in the order of the list.
        least: of what at least one is needed; empty where there may be none.
        member: the key of the name in a member of the list, such as ``.name``.
        taken: names that none may have.

    Raises:
        ModelError: at ``key`` with the index of the wrong name.
    """
    for i, name in enumerate(names):
        place = f"{key}[{i}]{member}"
        if not isinstance(name, str) or not name:
            raise ModelError(place, f"{name!r:.40} is not a name; give a non-empty string")
        if not name.isprintable():
            raise ModelError(place, f"{name!r} has characters that cannot be printed")
        if name in names[:i] or name in taken:
            raise ModelError(place, f"{name!r} is taken already; names must differ")
    if least and not names:
        raise ModelError(key, f"is empty; expected {least}")
