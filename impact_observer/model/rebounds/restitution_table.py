# SPDX-License-Identifier: Apache-2.0
"""Restitution that depends on the speed of approach by a table."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from impact_observer.errors import ModelError
from impact_observer.model.document import Section, Value, finite
from impact_observer.model.rebounds.rebound_law import ReboundLaw, ReboundRemark, never_raises
from impact_observer.states import Vector

_SLOPE = 1e-12
"""Largest excess of a slope over 1 that counts as rounding."""


@dataclass(frozen=True, slots=True, eq=False)
class RestitutionTable(ReboundLaw):
    """``r = eps(|gamma|) gamma``, ``eps`` linear between given speeds, constant outside.

    Attributes:
        speeds: ascending, not negative, shape (k,), m/s.
        values: in [0, 1], shape (k,).
    """

    speeds: Vector
    values: Vector

    @classmethod
    def read(cls, contact: Section) -> "RestitutionTable | None":
        """The law of a ``contact`` of which the restitution has ``speeds`` or ``values``."""
        value = contact.value("restitution")
        if not isinstance(value, Mapping) or not ({"speeds", "values"} & value.keys()):
            return None
        table = Section(contact.key("restitution"), value, ("speeds", "values"))
        table.value("speeds")
        count = len(table.items("speeds"))
        return cls(table.vector("speeds", count), table.vector("values", count))

    def checked(self, key: str) -> "RestitutionTable":
        """The same table with checked numbers."""
        key, count = f"{key}.restitution", np.size(self.speeds)
        speeds = finite(f"{key}.speeds", self.speeds, (count,), "a list of numbers, m/s")
        values = finite(f"{key}.values", self.values, (count,), f"{count} numbers, one a speed")
        if count < 2 or speeds[0] < 0 or np.any(np.diff(speeds) <= 0):
            wanted = "at least two numbers, ascending and not negative, m/s"
            raise ModelError(f"{key}.speeds", f"are {speeds.tolist()}; expected {wanted}")
        for i in np.flatnonzero((values < 0) | (values > 1)):
            problem = f"is {values[i]:g}; expected a number in [0, 1]"
            raise ModelError(f"{key}.values[{i}]", problem)
        return RestitutionTable(speeds, values)

    @property
    def document(self) -> dict[str, Value]:
        """The key ``restitution`` with the table."""
        table = {"speeds": self.speeds.tolist(), "values": self.values.tolist()}
        return {"restitution": table}

    @property
    def text(self) -> str:
        """The ends of the table."""
        ends = f"{self.values[0]:g} to {self.values[-1]:g}"
        return f"{ends} from {self.speeds[0]:g} to {self.speeds[-1]:g} m/s"

    @property
    def nominal(self) -> float:
        """The mean of the values."""
        return float(np.mean(self.values))

    @property
    def is_nonexpansive(self) -> bool:
        """Whether the slope of ``r`` lies in [-1, 1] at all speeds."""
        steep = np.diff(self.values) / np.diff(self.speeds)
        ends = np.concatenate(
            [
                self.values[:-1] + steep * self.speeds[:-1],
                self.values[1:] + steep * self.speeds[1:],
            ]
        )
        return bool(np.all(np.abs(ends) <= 1 + _SLOPE))

    def restitution_at(self, speed: Vector) -> Vector:
        """``eps`` at speeds ``v`` >= 0, m/s, of any shape."""
        return np.asarray(np.interp(speed, self.speeds, self.values))

    def slope(self, gamma: float) -> float:
        """``dr/dgamma`` at one contact speed, m/s; at a kink that of higher speeds."""
        speed = abs(gamma)
        eps = float(np.interp(speed, self.speeds, self.values))
        k = int(np.searchsorted(self.speeds, speed, side="right"))
        if not 0 < k < self.speeds.size:
            return eps
        rise = (self.values[k] - self.values[k - 1]) / (self.speeds[k] - self.speeds[k - 1])
        return eps + float(rise) * speed

    def remark(self, contact: str) -> ReboundRemark:
        """Whether an impact of the contact alone can raise V."""
        if self.is_nonexpansive:
            return never_raises(contact)
        return ReboundRemark(
            "warning",
            f"Restitution of {contact}: eps(v) v has a slope outside [-1, 1], so an impact of"
            f" {contact} alone can raise V, and no bound is certified. Give a table that changes"
            " less steeply with the speed.",
        )
