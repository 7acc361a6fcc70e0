# SPDX-License-Identifier: Apache-2.0
"""What is declared of the errors of each contact's sensor, as arrays."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_observer.model.contact_sensors import ContactSensors
from impact_observer.model.free_parameters import LATENCY
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.states import Matrix, Vector


class ContactErrors(NamedTuple):
    """Errors of the sensors of m contacts.

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
        m, own = len(contacts), dict(sensors.by_contact)
        errors = cls(np.full(m, np.nan), np.full(m, missed), np.zeros(m))
        for i, name in enumerate(contacts):
            if name in own and (sensor := own[name]) is None:
                errors.missed[i] = 1.0
            elif name in own and sensor is not None:
                for key, part in zip(("clock_error", "missed", "latency"), errors, strict=True):
                    if (value := getattr(sensor, key)) is not None:
                        part[i] = value
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
