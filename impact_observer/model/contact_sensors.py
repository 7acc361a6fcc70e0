# SPDX-License-Identifier: Apache-2.0
"""The key ``sensors`` of a model file: what is left of the errors of each contact's sensor."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields

from impact_observer.errors import ModelError
from impact_observer.model.document import Section

KEY, NO_SENSOR = "sensors", "none"
_RANGES = {
    "clock_error": (0.0, 1.0, "0 to 1 s"),
    "missed": (0.0, 1.0, "a probability"),
    "latency": (-10.0, 10.0, "-10 to 10 s"),
}


@dataclass(frozen=True, slots=True)
class ContactSensor:
    """What is left of the errors of a contact's sensor; None for the errors of all contacts.

    Attributes:
        clock_error: standard deviation of the stamps, s.
        missed: probability that an impact is not detected.
        latency: by which the stamps are late, s; negative for early stamps.
    """

    clock_error: float | None = None
    missed: float | None = None
    latency: float | None = None

    def given(self) -> Iterator[tuple[str, float]]:
        """The values that are not None, by name."""
        for each in fields(self):
            if (value := getattr(self, each.name)) is not None:
                yield each.name, value


@dataclass(frozen=True, slots=True)
class ContactSensors:
    """The sensors of contacts that have other errors than all contacts.

    Attributes:
        by_contact: names of contacts, each with its sensor; None for a contact without a sensor.

    Raises:
        ModelError: a value is out of its range; the error names the key.
    """

    by_contact: tuple[tuple[str, ContactSensor | None], ...] = ()

    def __post_init__(self) -> None:
        """Check all values."""
        for contact, sensor in self.by_contact:
            for name, value in () if sensor is None else sensor.given():
                low, high, wanted = _RANGES[name]
                if not (math.isfinite(value) and low <= value <= high):
                    raise ModelError(
                        f"{KEY}.{contact}.{name}", f"{value:g} found; expected {wanted}"
                    )

    @property
    def document(self) -> dict[str, object]:
        """The value of the key ``sensors``."""
        return {
            contact: NO_SENSOR if sensor is None else dict(sensor.given())
            for contact, sensor in self.by_contact
        }


NO_SENSORS = ContactSensors()
"""All contacts have the same errors."""


def read_contact_sensors(section: Section, contacts: tuple[str, ...]) -> ContactSensors:
    """The sensors in a model file with these ``contacts``.

    Raises:
        ModelError: an unknown contact or key, or a wrong value; the error names the key.
    """
    if KEY not in section:
        return NO_SENSORS
    sensors = Section(KEY, section.value(KEY), contacts)
    return ContactSensors(
        tuple((name, _sensor(sensors, name)) for name in contacts if name in sensors)
    )


def _sensor(sensors: Section, contact: str) -> ContactSensor | None:
    value, key = sensors.value(contact), sensors.key(contact)
    if value == NO_SENSOR:
        return None
    if not isinstance(value, Mapping):
        raise ModelError(
            key, f"{value!r:.40} found; expected {NO_SENSOR}, or keys: {', '.join(_RANGES)}"
        )
    sensor = Section(key, value, tuple(_RANGES))
    return ContactSensor(**{name: sensor.number(name) for name in value})
