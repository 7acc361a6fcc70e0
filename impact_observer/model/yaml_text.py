# SPDX-License-Identifier: Apache-2.0
"""YAML: documents from texts, texts from documents, and texts with changed values."""

import io
import re
from collections.abc import Mapping
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedSeq
from ruamel.yaml.error import YAMLError
from ruamel.yaml.representer import SafeRepresenter

from impact_observer.errors import ModelError
from impact_observer.model.document import Value
from impact_observer.resources import MOST_BYTES

_NOT_YAML = (YAMLError, ValueError, LookupError, TypeError, AttributeError, RecursionError)
"""Exceptions of ruamel: its own errors, and others for values such as ``2020-13-45``."""
_MOST_REPEATED = 100_000
"""Most values that aliases may add, beside one for each character."""


def load_yaml(text: str) -> Value:
    """The document in a YAML text.

    Raises:
        ModelError: ``text`` is not YAML, or too long, also with its aliases written out; the error
            has no key.
    """
    if len(text) > MOST_BYTES:
        raise ModelError("", f"{len(text)} characters found; expected at most {MOST_BYTES}")
    try:
        document: Value = YAML(typ="safe", pure=True).load(text)
    except _NOT_YAML as error:
        mark = getattr(error, "problem_mark", None)
        where = f" at line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        problem = str(getattr(error, "problem", None) or error).splitlines()[0]
        raise ModelError("", f"is not YAML{where}: {problem}") from None
    left, values = len(text) + _MOST_REPEATED, [document]
    while values:
        found = values.pop()
        if isinstance(found, list | Mapping):
            values += found if isinstance(found, list) else [*found, *found.values()]
        if (left := left - 1) < 0:
            raise ModelError("", "aliases repeat its values too often, or contain themselves")
    return document


class _Representer(SafeRepresenter):
    """Writes text of several lines as a block."""

    def represent_str(self, data: str) -> Value:
        """A block scalar for text with a line end, otherwise the default."""
        style = "|" if "\n" in data else None
        return self.represent_scalar("tag:yaml.org,2002:str", data, style=style)


_Representer.add_representer(str, _Representer.represent_str)


def yaml_text(document: Mapping[str, Value]) -> str:
    """The YAML of a ``document``, keys in their order."""
    yaml = YAML(typ="safe", pure=True)
    yaml.Representer = _Representer
    yaml.default_flow_style = None
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    yaml.width = 99
    return _dumped(yaml, document)


def edited(text: str, changes: Mapping[tuple[str | int, ...], Value]) -> str:
    """The ``text`` of a model file with changed values; comments and layout stay.

    The keys of ``changes`` are paths in the file, such as ``("stops", 0, "limit")``. The index
    behind the last member of a list appends one. A deviation beside a changed value goes, and so
    does a key whose new value is None.
    """
    yaml, document = _round_trip(text)
    for (*path, last), found in changes.items():
        place, value = document, _with_rows(found)
        for part in path:
            place = place[part]
        if isinstance(place, list) and last == len(place):
            place.append(value)
            continue
        if value is None:
            place.pop(last, None)
            continue
        place[last] = value
        if last == "value":
            place.pop("deviation", None)
    return _dumped(yaml, document)


def _round_trip(text: str) -> tuple[YAML, Any]:
    """A YAML text with its comments and layout, and what writes them again."""
    yaml = YAML()
    yaml.width = 1_000_000  # ruamel breaks longer lines
    yaml.preserve_quotes = True
    if re.search(r"^ +- ", text, re.MULTILINE):
        yaml.indent(sequence=4, offset=2)
    return yaml, yaml.load(text)


def _dumped(yaml: YAML, document: Value) -> str:
    stream = io.StringIO()
    yaml.dump(document, stream)
    return stream.getvalue()


def _with_rows(value: Value) -> Value:
    """``value`` with each list of numbers in one line."""
    if isinstance(value, Mapping):
        return {key: _with_rows(each) for key, each in value.items()}
    if not isinstance(value, list):
        return value
    row = CommentedSeq(map(_with_rows, value))
    if not any(isinstance(each, list | Mapping) for each in value):
        row.fa.set_flow_style()
    return row
