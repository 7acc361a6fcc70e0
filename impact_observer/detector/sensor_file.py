# SPDX-License-Identifier: Apache-2.0
"""The file that declares the sensors of a rig."""

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path

from impact_observer.detector.source import Source
from impact_observer.errors import ModelError, UsageError
from impact_observer.model.document import Section, Value
from impact_observer.model.model_file import load_yaml
from impact_observer.resources import read_file_or_sample

_KEYS = tuple(each.name for each in fields(Source) if each.name != "origin")
_TEXTS = ("contact", "topic", "kind", "field", "direction", "instant", "stamp")


def read_sources(path: str | Path) -> tuple[Source, ...]:
    """Returns the sensors that a file or a sample such as ``switch`` declares.

    Raises:
        UsageError: one line that names the file, the key and what is wanted.
    """
    file, text = read_file_or_sample(path, "config/detector", "a file of sensors, or a sample")
    return parse_sources(text, str(file))


def parse_sources(text: str, name: str) -> tuple[Source, ...]:
    """Returns the sensors that the text of a file declares.

    Args:
        text: the YAML.
        name: the name of the file in errors.

    Raises:
        UsageError: one line that names the file, the key and what is wanted.
    """
    try:
        document = load_yaml(text)
        if not isinstance(document, Mapping):
            raise ModelError("", "is no list of sensors: expected a YAML mapping with sources")
        sources = sources_in(Section("", document, ("sources",)), name)
        if not sources:
            raise ModelError("sources", "is missing or empty; expected a list of sensors")
    except ModelError as error:
        raise UsageError(f"{name}: {error}") from None
    return sources


def sources_in(section: Section, name: str) -> tuple[Source, ...]:
    """Returns the sensors under the key ``sources``, none without the key.

    Raises:
        ModelError, UsageError: one line that names the key and what is wanted.
    """
    if "sources" not in section:
        return ()
    sources = tuple(_source(key, value, name) for key, value in section.items("sources"))
    first: dict[str, Source] = {}
    for source in sources:
        if (other := first.setdefault(source.contact, source)) is not source:
            both = f"{other.topic} and {source.topic}"
            raise source.wrong(
                "contact", f"{source.contact!r} has two sensors, {both}; expected one a contact"
            )
    return sources


def _source(key: str, value: Value, name: str) -> Source:
    """Returns the sensor in one member of the list."""
    section = Section(key, value, _KEYS)
    keys = [each for each in _KEYS if each in section or each in {"contact", "topic"}]
    given = {each: _value(section, each) for each in keys}
    return Source(**given, origin=f"{name}: {key}.")  # type: ignore[arg-type]


def _value(section: Section, key: str) -> object:
    """Returns the value of a key, of the right type."""
    if key in _TEXTS:
        return section.text(key)
    if key == "inverted":
        value = section.value(key)
        if not isinstance(value, bool):
            raise ModelError(section.key(key), f"{value!r} found; expected true or false")
        return value
    return section.number(key)
