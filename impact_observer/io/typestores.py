# SPDX-License-Identifier: Apache-2.0
"""Message types: of ROS 2 Jazzy, of this package's ``.msg`` texts, and of a bag's definitions.

The texts in ``msg_defs/msg`` are the single source of our messages: ``colcon`` builds the ROS
classes from them, this module registers them with ``rosbags``.
"""

import os
import re
import sys
from collections.abc import Iterator
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Msgdef, Nodetype
from rosbags.interfaces.typing import Typesdict
from rosbags.serde import SerdeError
from rosbags.typesys import (
    Stores,
    TypesysError,
    get_types_from_idl,
    get_types_from_msg,
    get_typestore,
)
from rosbags.typesys.store import Typestore

from impact_observer.errors import BagError
from impact_observer.resources import shared

_PACKAGE = "impact_observer_msgs"
_RESERVE = 64
_SEPARATOR = "=" * 80 + "\n"
_IDL = re.compile(r"^\s*module\s+\w+\s*\{", re.MULTILINE)
"""Begins a definition as IDL; no text of a message type has such a line."""


class _Extended(Typestore):
    """The shared types and others. Code for the shared ones is compiled once in a process."""

    def get_msgdef(self, typename: str) -> Msgdef[object]:
        if typename not in self.cache and typename in typestore().fielddefs:
            self.cache[typename] = typestore().get_msgdef(typename)
        return super().get_msgdef(typename)


def new_typestore() -> Typestore:
    """A typestore of ROS 2 Jazzy's and our message types; types may be added to it.

    Raises:
        UsageError: the package was installed without its message texts.
    """
    known, store = typestore(), _Extended()
    store.types.update(known.types)
    store.fielddefs.update(known.fielddefs)
    return store


@cache
def typestore() -> Typestore:
    """A shared typestore; no types may be added to it."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for path in sorted(shared("msg_defs/msg").glob("*.msg")):
        store.register(get_types_from_msg(path.read_text("utf-8"), f"{_PACKAGE}/msg/{path.stem}"))
    return store


@lru_cache(100)  # many bags have the same long ones
def parse_definition(definition: str, type_name: str) -> Typesdict:
    """The types in a definition: the text of a message type, then those of its parts; or IDL.

    Raises:
        BagError: the text is no definition of ``type_name``.
    """
    try:
        if not _IDL.search(definition):
            return get_types_from_msg(definition, type_name)
        types: Typesdict = {}
        for part in definition.removeprefix(_SEPARATOR).split(_SEPARATOR):
            _, _, text = part.partition("\n") if part.startswith("IDL: ") else ("", "", part)
            types.update(get_types_from_idl(text))
    except (TypesysError, AssertionError, LookupError, ValueError) as error:
        raise BagError(f"the definition of {type_name} cannot be parsed") from error
    return types


def add_definition(store: Typestore, definition: str, type_name: str) -> None:
    """Add to ``store`` the types of a ``definition`` that it does not have.

    Raises:
        BagError: the text is no definition of ``type_name``, or ``store`` has the type, or a part
            of it, with other fields.
    """
    types, known = parse_definition(definition, type_name), store.fielddefs
    if all(name in known and known[name][1] == fields for name, (_, fields) in types.items()):
        return  # registering takes longer
    try:
        store.register(types)
    except TypesysError:
        raise BagError(f"another definition of {type_name} than the known one") from None


def begins_with_stamp(store: Typestore, type_name: str) -> bool:
    """Whether messages of a type begin with a stamp: with a header, or the stamp of a header."""
    _, fields = store.fielddefs[type_name]
    return bool(fields) and fields[0][1][1] in {
        "std_msgs/msg/Header",
        "builtin_interfaces/msg/Time",
    }


def deserialize(store: Typestore, data: bytes, type_name: str) -> Any:  # noqa: ANN401 (a class of rosbags)
    """The message in serialized ``data`` (CDR of either byte order).

    A few bytes too many are accepted: ``rclpy.serialization.serialize_message``, with which
    scripts write bags, returns its whole buffer.

    Raises:
        SerdeError: the bytes are no message of that type; or another exception of ``rosbags``.
    """
    if len(data) < 4 or data[0] != 0 or data[1] > 1:
        raise SerdeError("no CDR header")
    definition = store.get_msgdef(type_name)
    read = definition.deserialize_cdr_le if data[1] else definition.deserialize_cdr_be
    message, end = read(data[4:], 0, definition.cls, store)
    if (left := len(data) - 4 - end) > _RESERVE:
        raise SerdeError(f"{left} bytes are left over")
    return message


def blank(type_name: str) -> Any:  # noqa: ANN401 (a class of rosbags)
    """A message with zeros and empty texts."""
    store = typestore()
    _, members = store.fielddefs[type_name]
    return store.types[type_name](**{name: _blank_field(kind) for name, kind in members})


def _blank_field(kind: Any) -> Any:  # noqa: ANN401 (as rosbags describes it)
    """The value of a field of this kind."""
    node, detail = kind
    if node is Nodetype.NAME:
        return blank(detail)
    if node is Nodetype.BASE:
        return {"string": "", "bool": False}.get(detail[0], 0)
    (_, (base, *_)), count = detail
    if base == "string":
        return [""] * int(count or 0)
    return np.zeros(int(count or 0), dtype=base)


def installed_definition(type_name: str) -> str | None:
    """The text of a message type and its parts, for :func:`parse_definition`; None without.

    The texts are those in ``share/<package>/msg`` of the prefixes in ``AMENT_PREFIX_PATH`` and of
    the Python environment.
    """
    texts: dict[str, str] = {}
    pending = [type_name]
    while pending:
        name = pending.pop(0)
        if name in texts:
            continue
        if (path := _installed_text(name)) is None:
            return None
        texts[name] = path.read_text("utf-8")
        pending += _parts(parse_definition(texts[name], name)[name][1])
    first, *others = texts.items()
    return first[1] + "".join(
        f"\n{_SEPARATOR}MSG: {name.replace('/msg/', '/')}\n{text}" for name, text in others
    )


def _installed_text(type_name: str) -> Path | None:
    """The installed ``.msg`` file of a type; None if no such file is installed."""
    package, kind, name = type_name.split("/")
    prefixes = (*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix)
    paths = (Path(prefix, "share", package, kind, f"{name}.msg") for prefix in prefixes if prefix)
    return next((path for path in paths if path.is_file()), None)


def _parts(description: object) -> Iterator[str]:
    """Names of the message types in a tree of field descriptions: strings with a slash."""
    if isinstance(description, str):
        if "/" in description:
            yield description
    elif isinstance(description, (list, tuple)):
        for part in description:
            yield from _parts(part)
