# SPDX-License-Identifier: Apache-2.0
"""Newton's law with a constant coefficient: ``r = eps gamma``."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from impact_observer.model.document import Share, converted
from impact_observer.model.rebounds.rebound_law import ReboundLaw, ReboundParameter
from impact_observer.states import Vector


@dataclass(frozen=True, slots=True)
class ConstantRestitution(ReboundLaw):
    """``r = eps gamma``.

    Attributes:
        restitution: ``eps``, in [0, 1].
    """

    units: ClassVar[Mapping[str, str]] = {"restitution": ""}
    is_plain: ClassVar[bool] = True
    is_affine: ClassVar[bool] = True

    restitution: float

    @classmethod
    def read(
        cls, key: str, restitution: float | Mapping[str, float]
    ) -> "ConstantRestitution | None":
        """The law of a restitution that is a number."""
        if isinstance(restitution, Mapping):
            return None
        return cls(converted(restitution, Share, key))

    @property
    def written(self) -> float:
        """``eps``."""
        return float(self.restitution)

    @property
    def nominal(self) -> float:
        """``eps``."""
        return self.restitution

    def restitution_at(self, speed: Vector) -> Vector:
        """``eps`` at speeds of any shape."""
        return np.full(np.shape(speed), self.restitution)

    def slope(self, gamma: Vector) -> Vector:
        """``eps``."""
        return self.restitution_at(gamma)

    @property
    def parameters(self) -> tuple[ReboundParameter, ...]:
        """The coefficient."""
        place = ("restitution",)
        return (ReboundParameter("restitution", self.restitution, 0.0, 1.0, 1.0, place),)

    def with_values(self, values: Sequence[float]) -> "ConstantRestitution":
        """The law with another coefficient."""
        return ConstantRestitution(*values)

    def sensitivity(self, gamma: Vector) -> Vector:
        """``dr/deps = gamma``."""
        return np.asarray(gamma)[..., None]
