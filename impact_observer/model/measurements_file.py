# SPDX-License-Identifier: Apache-2.0
"""The file that declares the sensors of an observer."""

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
MOST = 1000
"""Largest number of sensors in a file."""


def read_measurements(path: str | Path | None) -> tuple[Measurement, ...]:
    """The sensors in a file, or in a sample file by its name, such as ``encoder``.

    Without a ``path`` (None or empty) the result has no sensors.

    Raises:
        UsageError: one line that names the file, the key and the expected value.
    """
    if not path:
        return ()
    wanted = "a file of measurements, or a sample"
    file, text = read_file_or_sample(path, "config/measurements", wanted)
    return parse_measurements(text, str(file))


def parse_measurements(text: str, source: str) -> tuple[Measurement, ...]:
    """The sensors in the ``text`` of a file; ``source`` is the name of the file in errors.

    Raises:
        UsageError: one line that names the source, the key and the expected value.
    """
    try:
        document = load_yaml(text)
        if not isinstance(document, Mapping):
            raise ModelError("", "is no list of sensors: expected a YAML mapping: measurements")
        members = Section("", document, ("measurements",)).items("measurements")
        if not 0 < len(members) <= MOST:
            wanted = f"expected a list of 1 to {MOST} sensors"
            raise ModelError("measurements", f"{len(members) or 'nothing'} found; {wanted}")
        sensors = [_measurement(key, value, source) for key, value in members]
    except ModelError as error:
        raise UsageError(f"{source}: {error}") from None
    names = [each.name for each in sensors]
    for i, each in enumerate(sensors):
        if each.name in names[:i]:
            raise each.wrong("name", f"{each.name!r} is taken already; names must differ")
    return tuple(sensors)


def _measurement(key: str, value: Value, source: str) -> Measurement:
    """The sensor in one member of the list."""
    section = Section(key, value, _KEYS)
    section.value("deviation")
    keys = [each for each in _KEYS if each in section or each in {"name", "topic"}]
    given = {each: _value(section, each) for each in keys}
    return Measurement(**given, origin=f"{source}: {key}.")  # type: ignore[arg-type]


def _value(section: Section, key: str) -> object:
    """The value of a key, with the type of the field of ``Measurement``."""
    value = section.value(key)
    if key in _TEXTS:
        return section.text(key)
    if key in KINDS:
        where = section.key(key)
        if not isinstance(value, Mapping) or not value:
            wanted = "expected a coefficient by coordinate, such as {x1: 1}"
            raise ModelError(where, f"{value!r:.40} found; {wanted}")
        return tuple((str(k), number(f"{where}.{k}", each)) for k, each in value.items())
    if key == "deviation" and value == "learn":
        wanted = "learn went in 0.4.0; impact_observer 0.3.0 has it; expected a number"
        raise ModelError(section.key(key), wanted)
    return section.number(key)
