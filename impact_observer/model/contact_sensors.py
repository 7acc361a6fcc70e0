# SPDX-License-Identifier: Apache-2.0
"""What is left of the errors of the sensors of single contacts."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Literal, NamedTuple, TypeAlias

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from impact_observer.errors import ModelError
from impact_observer.model.document import Keys, Share, Value
from impact_observer.model.free_parameters import LATENCY
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.states import Matrix, Vector

KEY = "sensors"


class ContactSensor(Keys, frozen=True):
    """What is left of the errors of a contact's sensor; None for the error of all contacts.

    Attributes:
        clock_error: standard deviation of the stamps, s.
        missed: probability that an impact is not detected.
        latency: by which the stamps are late, s; negative for early stamps.
    """

    clock_error: Share | None = None
    missed: Share | None = None
    latency: Annotated[float, Meta(ge=-10.0, le=10.0)] | None = None

    def given(self) -> dict[str, float]:
        """The values that are set, by name."""
        named = msgspec.structs.asdict(self)
        return {name: float(value) for name, value in named.items() if value is not None}


ContactSensors: TypeAlias = Mapping[str, ContactSensor | None]
"""Sensors by the names of contacts with errors of their own; None for no sensor."""
NO_SENSORS: ContactSensors = {}
"""All contacts have the same errors."""


def contact_sensors(
    given: Mapping[str, ContactSensor | Literal["none"]], contacts: Sequence[str]
) -> ContactSensors:
    """The sensors in a model file with these ``contacts``.

    Raises:
        ModelError: an unknown contact.
    """
    for name in given:
        if name not in contacts:
            wanted = ", ".join(contacts) or "none, as it has no contacts"
            raise ModelError(f"{KEY}.{name}", f"is no contact; expected one of {wanted}")
    own = {name: given[name] for name in contacts if name in given}
    return {name: None if each == "none" else each for name, each in own.items()}


def written_sensors(sensors: ContactSensors) -> dict[str, Value]:
    """The value of the key ``sensors`` in a model file."""
    return {name: "none" if each is None else each.given() for name, each in sensors.items()}


class ContactErrors(NamedTuple):
    """Errors of the sensors of m contacts, as arrays.

    Attributes:
        clock: standard deviations of stamps, shape (m,), s; NaN where that of all contacts holds.
        missed: probabilities that an impact is not detected, shape (m,); 1 without a sensor.
        latency: by which stamps are late, shape (m,), s.
    """

    clock: Vector
    missed: Vector
    latency: Vector

    @classmethod
    def of(
        cls, sensors: ContactSensors, contacts: tuple[str, ...], missed: float
    ) -> "ContactErrors":
        """The errors that a model declares; of all other contacts ``missed`` is declared."""
        m = len(contacts)
        errors = cls(np.full(m, np.nan), np.full(m, missed), np.zeros(m))
        parts = {"clock_error": errors.clock, "missed": errors.missed, "latency": errors.latency}
        for name, sensor in sensors.items():
            for key, value in ({"missed": 1.0} if sensor is None else sensor.given()).items():
                parts[key][contacts.index(name)] = value
        return errors

    @property
    def has_sensor(self) -> NDArray[np.bool_]:
        """Which contacts have a sensor, shape (m,)."""
        return self.missed < 1

    def late(self, family: ParametricFamily, theta: Vector) -> tuple[Vector, Matrix]:
        """By how much stamps of each contact are late, (m,), and its derivatives, (m, p)."""
        contacts = family.system.contact_names
        slopes = np.zeros((len(contacts), family.size))
        for j, name in enumerate(family.names):
            kind, _, contact = name.partition(".")
            if kind == LATENCY:
                slopes[contacts.index(contact), j] = 1.0
        return self.latency + slopes @ theta, slopes
