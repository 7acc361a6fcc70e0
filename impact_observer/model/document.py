# SPDX-License-Identifier: Apache-2.0
"""Documents as values of a schema.

Every mistake is one error that names the key, what was found and what is expected.
"""

import math
import re
import types
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Annotated, Any, Literal, TypeAlias, TypeVar, Union, get_args, get_origin

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
_WORDS: dict[object, str] = {
    float: "a number",
    int: "a whole number",
    str: "a name",
    bool: "true or false",
    dict: "keys and values",
}
_MEMBERS: dict[object, str] = {float: "numbers", str: "names", tuple: "lists of numbers"}
"""What types, and the members of lists, are called in errors."""
_GONE = re.compile(
    r"friction|grounds\.motion\.live|(forces|forcing\.harmonics)\.order|measurements\.gain|"
    r"(stops|contacts)\.(contact_time|velocity_offset|restitution\.(speeds|values))|"
    r"measurements\.deviation: learn|unit: deg"
)
"""What version 0.4.0 took out: keys without indices, or such a key and its value."""
_WENT = "went in 0.4.0; impact_observer 0.3.0 has it"


class Keys(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Keys that stand together in a file; any other key there is an error.

    What a class asks of several keys is in its ``__post_init__``, whose errors name such a key.
    """

    def check_form(self, needed: tuple[str, ...], optional: tuple[str, ...] = ()) -> None:
        """Check that of the keys that may be left out only those of one form are given.

        Raises:
            ModelError: a ``needed`` key is missing, or one is given that is not ``optional``.
        """
        for each in msgspec.structs.fields(self):
            is_given = each.required or getattr(self, each.name) is not None
            if each.name in needed and not is_given:
                raise ModelError(each.name, "is missing")
            if is_given and not (each.required or each.name in (*needed, *optional)):
                raise ModelError(each.name, f"does not go with {needed[0]}")


def converted(value: Value, kind: type[T], key: str = "") -> T:
    """A ``value`` of a file as a ``kind`` of the schema; ``key`` is its key in the file.

    Raises:
        ModelError: one line that names the key, what was found and what is expected.
    """
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError:
        raise next(_mistakes(value, kind, key)) from None


def _mistakes(found: Value, kind: object, key: str) -> Iterator[ModelError]:
    """The errors of what was ``found`` at a ``key``, of parts before the whole."""
    try:
        msgspec.convert(found, kind)
    except msgspec.ValidationError as error:
        yield from _explained(found, kind, key, error.__cause__)


def _explained(
    found: Value, kind: object, key: str, cause: BaseException | None
) -> Iterator[ModelError]:
    """The errors of what is no ``kind``; ``cause`` is that of a check of several keys."""
    at = _alternative(kind, found)
    if isinstance(found, list) and get_origin(at) is tuple:
        for i, each in enumerate(found):
            yield from _mistakes(each, get_args(at)[0], f"{key}[{i}]")
    elif isinstance(found, Mapping) and at is not None:
        yield from _mistakes_of_keys(found, at, f"{key}." if key else "")
    if isinstance(cause, ModelError):
        yield ModelError(f"{key}.{cause.key}".removeprefix("."), cause.problem)
    wanted = _expected(kind)
    if isinstance(found, float | int) and not abs(found) <= LARGEST:
        wanted = f"a number of at most {LARGEST:g}"
    went = f"{found} {_WENT}" if _is_gone(f"{key}: {found}") else f"{shown(found)} found"
    yield ModelError(key, _WENT if _is_gone(key) else f"{went}; expected {wanted}")


def _mistakes_of_keys(found: Mapping[Any, Value], at: Any, prefix: str) -> Iterator[ModelError]:  # noqa: ANN401 (a type, as of a hint)
    """The errors of unknown and missing keys, then of the values."""
    is_struct = get_origin(at) is None
    fields = {each.encode_name: each for each in msgspec.structs.fields(at)} if is_struct else {}
    for name in found:
        if not isinstance(name, str):
            yield ModelError(f"{prefix}{name}", "is no text; expected a name")
        elif is_struct and name not in fields:
            known = ", ".join(filter(str.isprintable, fields))
            unknown = f"is not known here; expected one of {known}"
            yield ModelError(f"{prefix}{name}", _WENT if _is_gone(prefix + name) else unknown)
    for name, each in fields.items():
        if each.required and name not in found:
            yield ModelError(f"{prefix}{name}", "is missing")
    for name, value in found.items():
        of = fields[name].type if is_struct else get_args(at)[1]
        yield from _mistakes(value, of, f"{prefix}{name}")


def _is_gone(what: str) -> bool:
    """Whether version 0.4.0 took out a key, or a key with its value."""
    return _GONE.fullmatch(re.sub(r"\[\d+\]", "", what)) is not None


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


def _alternative(kind: object, found: Value) -> Any:  # noqa: ANN401 (a type, as of a hint)
    """The type of a list or a mapping, ``found``, among the alternatives; None without any."""
    wanted = tuple if isinstance(found, list) else dict
    containers = [each for each in _alternatives(kind) if get_origin(each) is wanted]
    return next(iter(containers or _structs(kind)), None)


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
        first, *others = get_args(kind)
        (member, *_) = _alternatives(first)
        count = "" if Ellipsis in others else f"{1 + len(others)} "
        return f"a list of {count}{_MEMBERS.get(get_origin(member) or member, 'keys and values')}"
    return _WORDS.get(get_origin(kind) or kind, "something else")


def _bounds(meta: Meta) -> str:
    """The bounds of a number or of the length of a list, in words; empty for the usual ones."""
    if meta.min_length is not None:
        most = "" if meta.max_length is None else f" and at most {meta.max_length}"
        return f", at least {meta.min_length}{most}"
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


def vector(key: str, values: Sequence[float] | None, n: int) -> Vector:
    """``n`` numbers, zeros where the key is absent, shape (n,).

    Raises:
        ModelError: another number of numbers.
    """
    if values is None:
        return np.zeros(n)
    return finite(key, values, (n,), f"a list of {n} numbers")


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
        raise ModelError(
            key, f"has rows of several lengths, or other things than numbers; expected {what}"
        ) from None
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


def symmetric(key: str, matrix: Vector, slack: float | Vector) -> Vector:
    """The symmetric part of a ``matrix``, frozen, shape (n, n).

    Raises:
        ModelError: entries differ from those across the diagonal by more than ``slack``.
    """
    for i, j in np.argwhere(np.abs(matrix - matrix.T) > slack)[:1].tolist():
        problem = f"[{i}][{j}] is {matrix[i, j]:g} but [{j}][{i}] is {matrix[j, i]:g}"
        raise ModelError(key, f"is not symmetric: {problem}; make them equal")
    return frozen((matrix + matrix.T) / 2)


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
        if not isinstance(name, str) or not name or not name.isprintable():
            raise ModelError(place, f"{name!r:.40} is not a name that can be printed")
        if name in names[:i] or name in taken:
            raise ModelError(place, f"{name!r} is taken already; names must differ")
    if least and not names:
        raise ModelError(key, f"is empty; expected {least}")
