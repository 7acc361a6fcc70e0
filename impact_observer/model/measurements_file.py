# SPDX-License-Identifier: Apache-2.0
"""The file that declares what is measured beside the impacts."""

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path

from impact_observer.errors import ModelError, UsageError
from impact_observer.model.document import Section, Value, number
from impact_observer.model.measurement import KINDS, Measurement
from impact_observer.model.model_file import load_yaml
from impact_observer.resources import read_file_or_sample

_KEYS = tuple(each.name for each in fields(Measurement) if each.name != "origin")
_TEXTS = ("name", "topic", "joint", "quantity", "field", "gap", "stamp")
LEARN = "learn"
"""Instead of a deviation: it is to be learned from the innovations."""
MOST = 1000
"""Most sensors that a file may declare."""


def read_measurements(path: str | Path | None) -> tuple[Measurement, ...]:
    """The sensors that a file declares, or a sample by its name, such as ``encoder``.

    Without a name, None or empty, nothing is measured.

    Raises:
        UsageError: one line that names the file, the key and what is wanted.
    """
    if not path:
        return ()
    wanted = "a file of measurements, or a sample"
    found, text = read_file_or_sample(path, "config/measurements", wanted)
    return parse_measurements(text, str(found))


def parse_measurements(text: str, source: str) -> tuple[Measurement, ...]:
    """The sensors that the text of a file declares; ``source`` is what errors call it.

    Raises:
        UsageError: one line that names the source, the key and what is wanted.
    """
    try:
        document = load_yaml(text)
        if not isinstance(document, Mapping):
            raise ModelError("", "is no list of sensors: expected a YAML mapping: measurements")
        members = Section("", document, ("measurements",)).items("measurements")
        if not 0 < len(members) <= MOST:
            wanted = f"expected a list of 1 to {MOST} sensors"
            raise ModelError("measurements", f"{len(members) or 'nothing'} found; {wanted}")
        found = [_measurement(key, value, source) for key, value in members]
    except ModelError as error:
        raise UsageError(f"{source}: {error}") from None
    names = [each.name for each in found]
    for i, each in enumerate(found):
        if each.name in names[:i]:
            raise each.wrong("name", f"{each.name!r} is taken already; names must differ")
    return tuple(found)


def _measurement(key: str, value: Value, source: str) -> Measurement:
    """The sensor in one member of the list."""
    section = Section(key, value, _KEYS)
    section.value("deviation")
    keys = [each for each in _KEYS if each in section or each in {"name", "topic"}]
    given = {each: _value(section, each) for each in keys}
    return Measurement(**given, origin=f"{source}: {key}.")  # type: ignore[arg-type]


def _value(section: Section, key: str) -> object:
    """The value of a key, of the right type."""
    value = section.value(key)
    if key in _TEXTS:
        return section.text(key)
    if key in KINDS:
        where = section.key(key)
        if not isinstance(value, Mapping) or not value:
            wanted = "expected a coefficient by coordinate, such as {x1: 1}"
            raise ModelError(where, f"{value!r:.40} found; {wanted}")
        return tuple((str(k), number(f"{where}.{k}", each)) for k, each in value.items())
    if key == "deviation" and value == LEARN:
        return None
    if key == "deviation" and isinstance(value, str):
        raise ModelError(section.key(key), f"{value!r:.40} found; expected a number, or {LEARN}")
    return section.number(key)
