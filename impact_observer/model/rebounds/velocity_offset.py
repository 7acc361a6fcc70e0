# SPDX-License-Identifier: Apache-2.0
"""A stop that drives the contact point at a prescribed normal speed: a belt, rotor or plate.

Newton's law acts on the speed relative to the driven surface, ``gamma+ - v = -eps (gamma- - v)``,
while the place of the stop stays. In the difference of two solutions ``v`` cancels.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from impact_observer.errors import ModelError
from impact_observer.model.document import Section, Value, finite
from impact_observer.model.rebounds.rebound_law import (
    ReboundLaw,
    ReboundParameter,
    ReboundRemark,
    checked_restitution,
)
from impact_observer.states import Vector


@dataclass(frozen=True, slots=True)
class VelocityOffset(ReboundLaw):
    """``r = eps gamma - (1 + eps) v``.

    Attributes:
        restitution: ``eps``, in [0, 1].
        offset: ``v`` >= 0, the speed of the driven surface towards the free side, m/s.
    """

    keys: ClassVar[tuple[str, ...]] = ("velocity_offset",)
    units: ClassVar[Mapping[str, str]] = {"restitution": "", "velocity-offset": "m/s"}
    is_affine: ClassVar[bool] = True

    restitution: float
    offset: float

    @classmethod
    def read(cls, contact: Section) -> "VelocityOffset | None":
        """The law of a ``contact`` with the key ``velocity_offset``.

        Raises:
            ModelError: the restitution depends on the speed, or a value is not a number.
        """
        if "velocity_offset" not in contact:
            return None
        if isinstance(contact.value("restitution"), Mapping):
            raise ModelError(
                contact.key("restitution"),
                "depends on the speed; expected a number beside velocity_offset: both together"
                " are not proved",
            )
        return cls(contact.number("restitution"), contact.number("velocity_offset"))

    def checked(self, key: str) -> "VelocityOffset":
        """The same law with checked numbers."""
        eps = checked_restitution(f"{key}.restitution", self.restitution)
        key = f"{key}.velocity_offset"
        offset = float(finite(key, self.offset, (), "a number, m/s"))
        if offset < 0.0:
            wanted = "a number not below zero, m/s: the stop drives towards the free side"
            raise ModelError(key, f"is {offset:g}; expected {wanted}")
        return VelocityOffset(eps, offset)

    @property
    def document(self) -> dict[str, Value]:
        """The keys ``restitution`` and ``velocity_offset``."""
        return {"restitution": self.restitution, "velocity_offset": self.offset}

    @property
    def text(self) -> str:
        """Coefficient and offset."""
        return f"{self.restitution:g} about {self.offset:g} m/s"

    @property
    def nominal(self) -> float:
        """``eps``."""
        return self.restitution

    @property
    def drives(self) -> bool:
        """Whether the surface moves."""
        return self.offset > 0.0

    def restitution_at(self, speed: Vector) -> Vector:
        """``eps`` at speeds of any shape."""
        return np.full(np.shape(speed), self.restitution)

    def rebound(self, gamma: Vector) -> Vector:
        """``r`` at contact speeds of any shape, m/s."""
        return np.asarray(self.restitution * gamma - (1.0 + self.restitution) * self.offset)

    def slope(self, gamma: float) -> float:
        """``eps``."""
        del gamma
        return self.restitution

    def speed_before(self, after: float) -> float:
        """``gamma-`` of an impact that led to the contact speed ``after``, m/s."""
        return self.offset + ReboundLaw.speed_before(self, after - self.offset)

    @property
    def parameters(self) -> tuple[ReboundParameter, ...]:
        """Coefficient and offset."""
        eps, v = self.restitution, self.offset
        return (
            ReboundParameter("restitution", eps, 0.0, 1.0, 1.0, ("restitution",)),
            ReboundParameter("velocity-offset", v, 0.0, math.inf, v or 1.0, ("velocity_offset",)),
        )

    def with_values(self, values: Sequence[float]) -> "VelocityOffset":
        """The law with another coefficient and offset."""
        eps, v = values
        return VelocityOffset(eps, v)

    def sensitivity(self, gamma: float) -> tuple[float, ...]:
        """``dr/deps = gamma - v`` and ``dr/dv = -(1 + eps)``."""
        return gamma - self.offset, -(1.0 + self.restitution)

    def remark(self, contact: str) -> ReboundRemark | None:
        """What the drive means to an observer."""
        if not self.drives:
            return None
        return ReboundRemark(
            "note",
            f"{contact} drives what it hits at {self.offset:g} m/s: impacts add energy, and no"
            f" body comes to rest there. Two solutions with the same impacts differ as if"
            f" {contact} stood still.",
        )
