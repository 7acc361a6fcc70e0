# SPDX-License-Identifier: Apache-2.0
"""What is left of the errors of the sensors of single contacts."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Literal

import msgspec

from impact_observer.errors import ModelError
from impact_observer.model.document import converted
from impact_observer.model.schema import SensorKeys

KEY = "sensors"


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
            if sensor is not None:
                converted(dict(sensor.given()), SensorKeys, f"{KEY}.{contact}")

    @property
    def document(self) -> dict[str, object]:
        """The value of the key ``sensors``."""
        return {
            contact: "none" if sensor is None else dict(sensor.given())
            for contact, sensor in self.by_contact
        }


NO_SENSORS = ContactSensors()
"""All contacts have the same errors."""


def contact_sensors(
    sensors: Mapping[str, SensorKeys | Literal["none"]], contacts: Sequence[str]
) -> ContactSensors:
    """The sensors in a model file with these ``contacts``.

    Raises:
        ModelError: an unknown contact.
    """
    for name in sensors:
        if name not in contacts:
            wanted = ", ".join(contacts) or "none, as it has no contacts"
            raise ModelError(f"{KEY}.{name}", f"is no contact; expected one of {wanted}")
    own = {name: sensors[name] for name in contacts if name in sensors}
    return ContactSensors(tuple((name, _sensor(each)) for name, each in own.items()))


def _sensor(given: SensorKeys | Literal["none"]) -> ContactSensor | None:
    return None if given == "none" else ContactSensor(**msgspec.to_builtins(given))
