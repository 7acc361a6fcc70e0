# SPDX-License-Identifier: Apache-2.0
"""The file that declares the sensors of an observer."""

from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import UNSET, Meta, UnsetType

from impact_observer.errors import ModelError, UsageError
from impact_observer.model.document import Keys, Name, Number, converted
from impact_observer.model.measurement import KINDS, Measurement
from impact_observer.model.yaml_text import load_yaml
from impact_observer.resources import read_file_or_sample

MOST = 1000
"""Largest number of sensors in a file."""


class _Sensor(Keys, frozen=True, kw_only=True):
    """The keys of a sensor; what they mean says ``Measurement``, which checks them."""

    name: Name
    topic: Name
    joint: Name = ""
    quantity: Name = ""
    field: Name = ""
    position: dict[str, Number] | UnsetType = UNSET
    velocity: dict[str, Number] | UnsetType = UNSET
    acceleration: dict[str, Number] | UnsetType = UNSET
    gap: Name = ""
    offset: Number = 0.0
    deviation: Number
    delay: Number = 0.0
    blanking: Number = 0.0
    gate: Number = 5.0
    timeout: Number = 1.0
    stamp: Name | None = None


class _Sensors(Keys, frozen=True, kw_only=True):
    measurements: Annotated[tuple[_Sensor, ...], Meta(min_length=1, max_length=MOST)]


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
        given = converted(load_yaml(text), _Sensors).measurements
    except ModelError as error:
        raise UsageError(f"{source}: {error}") from None
    sensors = []
    for i, each in enumerate(given):
        keys = msgspec.structs.asdict(each)
        keys |= {kind: tuple((keys[kind] or {}).items()) for kind in KINDS}
        sensors.append(Measurement(**keys, origin=f"{source}: measurements[{i}]."))
        if each.name in [other.name for other in given[:i]]:
            raise sensors[i].wrong("name", f"{each.name!r} is taken already; names must differ")
    return tuple(sensors)
