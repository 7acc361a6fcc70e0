# SPDX-License-Identifier: Apache-2.0
"""Restitution that falls as a power of the speed of approach, as that of metals that yield."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from msgspec import Meta

from impact_observer.model.document import Keys, Positive, Share, converted
from impact_observer.model.rebounds.rebound_law import (
    ReboundLaw,
    ReboundParameter,
)
from impact_observer.states import Vector

LIMIT = 0.95
"""Default of the largest restitution; below 1, so that slow impacts come to rest."""
LEAST_EXPONENT = -0.999
"""Least exponent of a power law; at -1 all impacts would have the same speed afterwards."""


class _Numbers(Keys, frozen=True):
    """Numbers of a power law in a model file."""

    value: Share
    speed: Positive
    exponent: Annotated[float, Meta(ge=LEAST_EXPONENT, le=0.0)]
    limit: Annotated[float, Meta(ge=0.0, lt=1.0)] = LIMIT


@dataclass(frozen=True, slots=True)
class PowerLaw(ReboundLaw):
    """``r = eps(v) gamma``, ``v = |gamma|``, ``eps = min(limit, value (v / speed)^exponent)``.

    The slope of ``r`` always lies in [-1, 1].

    Attributes:
        value: restitution at ``speed``, in [0, 1].
        speed: positive, m/s.
        exponent: in [``LEAST_EXPONENT``, 0].
        limit: largest restitution, in [0, 1).
    """

    units: ClassVar[Mapping[str, str]] = {"restitution": "", "restitution-exponent": ""}

    value: float
    speed: float
    exponent: float
    limit: float = LIMIT

    @classmethod
    def read(cls, key: str, restitution: float | Mapping[str, float]) -> "PowerLaw":
        """The law of a restitution of several numbers."""
        numbers = converted(restitution, _Numbers, key)
        return cls(numbers.value, numbers.speed, numbers.exponent, numbers.limit)

    @property
    def written(self) -> dict[str, float]:
        """All numbers by name."""
        return {name: float(getattr(self, name)) for name in _Numbers.__struct_fields__}

    @property
    def nominal(self) -> float:
        """The restitution at ``speed``."""
        return self.value

    def restitution_at(self, speed: Vector) -> Vector:
        """``eps`` at speeds ``v`` >= 0, m/s, of any shape."""
        return np.minimum(self.limit, self._unlimited(speed))

    def slope(self, gamma: Vector) -> Vector:
        """``dr/dgamma``: the limit, or that of the power."""
        unlimited = self._unlimited(np.abs(gamma))
        power = (1 + self.exponent) * unlimited
        return np.where(unlimited >= self.limit, self.limit, power)

    def _unlimited(self, speed: Vector) -> Vector:
        if not self.value:
            return np.zeros(np.shape(speed))
        with np.errstate(divide="ignore", over="ignore"):  # the limit replaces an infinite value
            return np.asarray(self.value * (np.asarray(speed) / self.speed) ** self.exponent)

    @property
    def parameters(self) -> tuple[ReboundParameter, ...]:
        """Value and exponent."""
        value, exponent = ("restitution", "value"), ("restitution", "exponent")
        return (
            ReboundParameter("restitution", self.value, 0.0, 1.0, 1.0, value),
            ReboundParameter(
                "restitution-exponent", self.exponent, LEAST_EXPONENT, 0.0, 1.0, exponent
            ),
        )

    def with_values(self, values: Sequence[float]) -> "PowerLaw":
        """The law with another value and exponent."""
        value, exponent = values
        return PowerLaw(value, self.speed, exponent, self.limit)

    def sensitivity(self, gamma: Vector) -> Vector:
        """``dr`` by value and exponent; zero where the limit holds."""
        gamma = np.asarray(gamma)
        unlimited = self._unlimited(np.abs(gamma))
        is_powered = (unlimited < self.limit) & (gamma != 0)
        ratio = np.where(is_powered, np.abs(gamma), self.speed) / self.speed
        by = np.stack([ratio**self.exponent, unlimited * np.log(ratio)], axis=-1)
        return np.where(is_powered[..., None], by * gamma[..., None], 0.0)
