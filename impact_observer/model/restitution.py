# SPDX-License-Identifier: Apache-2.0
"""Restitution that depends on the speed of approach: a power law, or a table.

An impact of one contact, ``gamma+ = -eps(|gamma-|) gamma-``, does not raise the distance of two
solutions if ``v -> eps(v) v`` has a slope in [-1, 1] (``docs/theory/method.md``).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np

from impact_observer.errors import ModelError
from impact_observer.model.document import Section, Value, finite
from impact_observer.states import Vector

LIMIT = 0.95
"""Default of the largest restitution; below 1, so that slow impacts come to rest."""
LEAST_EXPONENT = -0.999
"""Least exponent of a power law; at -1 all impacts would have the same speed afterwards."""
_SLOPE = 1e-12
"""Largest excess of a slope over 1 that counts as rounding."""


@dataclass(frozen=True, slots=True)
class PowerLaw:
    """``eps = min(limit, value (v / speed)^exponent)``.

    Attributes:
        value: restitution at ``speed``, in [0, 1].
        speed: positive, m/s.
        exponent: in [``LEAST_EXPONENT``, 0].
        limit: largest restitution, in [0, 1).
    """

    value: float
    speed: float
    exponent: float
    limit: float = LIMIT

    @property
    def nominal(self) -> float:
        """The restitution at ``speed``."""
        return self.value

    @property
    def nominal_slope(self) -> float:
        """The slope of ``eps(v) v`` at ``speed``."""
        return (1 + self.exponent) * self.value

    @property
    def is_nonexpansive(self) -> bool:
        """True: the slope of ``eps(v) v`` always lies in [-1, 1]."""
        return True

    def restitution_at(self, speed: Vector) -> Vector:
        """``eps`` at speeds ``v`` >= 0, m/s, of any shape."""
        return np.minimum(self.limit, self._unlimited(speed))

    def slope(self, speed: float) -> float:
        """``d(eps v)/dv`` at one speed, m/s."""
        unlimited = float(self._unlimited(np.array(speed)))
        return self.limit if unlimited >= self.limit else (1 + self.exponent) * unlimited

    def sensitivity(self, speed: float) -> tuple[float, float]:
        """``d(eps)/d(value)`` and ``d(eps)/d(exponent)`` at one speed, m/s."""
        unlimited = float(self._unlimited(np.array(speed)))
        if unlimited >= self.limit or not speed > 0:
            return 0.0, 0.0
        ratio = speed / self.speed
        return float(ratio**self.exponent), unlimited * float(np.log(ratio))

    def _unlimited(self, speed: Vector) -> Vector:
        if not self.value:
            return np.zeros(np.shape(speed))
        with np.errstate(divide="ignore", over="ignore"):  # the limit replaces an infinite value
            return np.asarray(self.value * (speed / self.speed) ** self.exponent)

    def checked(self, key: str) -> "PowerLaw":
        """The same law with checked numbers.

        Raises:
            ModelError: a number is wrong; the error names the ``key`` of the model file.
        """
        numbers = {
            name: float(finite(f"{key}.{name}", getattr(self, name), (), "a number"))
            for name in ("value", "speed", "exponent", "limit")
        }
        within = {
            "value": (0.0 <= numbers["value"] <= 1.0, "a number in [0, 1]"),
            "speed": (numbers["speed"] > 0.0, "a positive number, m/s"),
            "exponent": (
                LEAST_EXPONENT <= numbers["exponent"] <= 0.0,
                f"a number in [{LEAST_EXPONENT:g}, 0]",
            ),
            "limit": (0.0 <= numbers["limit"] < 1.0, "a number in [0, 1)"),
        }
        for name, (holds, wanted) in within.items():
            if not holds:
                raise ModelError(f"{key}.{name}", f"is {numbers[name]:g}; expected {wanted}")
        return PowerLaw(**numbers)

    @property
    def text(self) -> str:
        """The curve in a few words."""
        return f"{self.value:g} (v/{self.speed:g})^{self.exponent:g}, at most {self.limit:g}"

    @property
    def document(self) -> dict[str, Value]:
        """The value of ``restitution`` in a model file."""
        return {name: getattr(self, name) for name in ("value", "speed", "exponent", "limit")}


@dataclass(frozen=True, eq=False)
class RestitutionTable:
    """``eps`` linear between given speeds, constant outside.

    Attributes:
        speeds: ascending, not negative, shape (k,), m/s.
        values: in [0, 1], shape (k,).
    """

    speeds: Vector
    values: Vector

    @property
    def nominal(self) -> float:
        """The mean of the values."""
        return float(np.mean(self.values))

    @property
    def nominal_slope(self) -> float:
        """The mean of the values: the slope of ``eps(v) v`` where ``eps`` is constant."""
        return self.nominal

    @cached_property
    def is_nonexpansive(self) -> bool:
        """Whether the slope of ``eps(v) v`` lies in [-1, 1] at all speeds."""
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

    def slope(self, speed: float) -> float:
        """``d(eps v)/dv`` at one speed, m/s; the right-hand slope at a kink."""
        eps = float(np.interp(speed, self.speeds, self.values))
        k = int(np.searchsorted(self.speeds, speed, side="right"))
        if not 0 < k < self.speeds.size:
            return eps
        rise = (self.values[k] - self.values[k - 1]) / (self.speeds[k] - self.speeds[k - 1])
        return eps + float(rise) * speed

    def checked(self, key: str) -> "RestitutionTable":
        """The same table with checked numbers.

        Raises:
            ModelError: a number is wrong; the error names the ``key`` of the model file.
        """
        count = np.size(self.speeds)
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
    def text(self) -> str:
        """The curve in a few words."""
        ends = f"{self.values[0]:g} to {self.values[-1]:g}"
        return f"{ends} from {self.speeds[0]:g} to {self.speeds[-1]:g} m/s"

    @property
    def document(self) -> dict[str, Value]:
        """The value of ``restitution`` in a model file."""
        return {"speeds": self.speeds.tolist(), "values": self.values.tolist()}


Curve: TypeAlias = PowerLaw | RestitutionTable
"""The restitution of a contact as a function of the speed of approach."""


def read_restitution(section: Section) -> tuple[float, Curve | None]:
    """The ``restitution`` of a contact in a model file: a number, or a nominal value and a curve.

    Raises:
        ModelError: a value is wrong; the error names the key and the expected value.
    """
    value, key = section.value("restitution"), section.key("restitution")
    if not isinstance(value, Mapping):
        return section.number("restitution"), None
    curve: Curve
    if "speeds" in value or "values" in value:
        table = Section(key, value, ("speeds", "values"))
        table.value("speeds")
        count = len(table.items("speeds"))
        curve = RestitutionTable(table.vector("speeds", count), table.vector("values", count))
    else:
        law = Section(key, value, ("value", "speed", "exponent", "limit"))
        value, speed, exponent = (law.number(name) for name in ("value", "speed", "exponent"))
        curve = PowerLaw(value, speed, exponent, law.number("limit", LIMIT))
    curve = curve.checked(key)
    return curve.nominal, curve
