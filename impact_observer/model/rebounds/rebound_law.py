# SPDX-License-Identifier: Apache-2.0
"""What every rebound law of one contact says of itself.

A contact that is hit with the speed ``gamma- < 0`` rebounds with ``gamma+ = -r(gamma-)``; speeds
are positive where the gap opens. Of several contacts at once Newton's law asks
``0 <= gamma+ + r(gamma-)  _|_  Lambda >= 0``.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from impact_observer.states import Vector


class ReboundParameter(NamedTuple):
    """A number of a rebound law that may be estimated.

    Attributes:
        kind: first part of the parameter's name, such as ``restitution``.
        value: as in the model.
        low: least value allowed.
        high: largest value allowed.
        size: an error that makes the model useless.
        place: path of the value in the contact of a model file.
    """

    kind: str
    value: float
    low: float
    high: float
    size: float
    place: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ReboundLaw(ABC):
    """The rebound of one contact, ``gamma+ = -r(gamma-)``.

    Attributes:
        units: kinds of the parameters that may be estimated, with SI units; empty for a ratio.
        is_plain: whether ``r = eps gamma`` with a constant ``eps``.
        is_affine: whether the slope of ``r`` is constant.
    """

    units: ClassVar[Mapping[str, str]] = {}
    is_plain: ClassVar[bool] = False
    is_affine: ClassVar[bool] = False

    @classmethod
    @abstractmethod
    def read(cls, key: str, restitution: float | Mapping[str, float]) -> "ReboundLaw | None":
        """The law of a ``restitution`` at the ``key`` of a model file; None for another law's.

        Raises:
            ModelError: a value is wrong; the error names the key and the expected value.
        """

    @property
    @abstractmethod
    def written(self) -> float | dict[str, float]:
        """The restitution of a contact in a model file from which ``read`` makes this law."""

    @property
    @abstractmethod
    def nominal(self) -> float:
        """A usual coefficient of restitution, where no speed is known."""

    def checked(self, key: str) -> "ReboundLaw":
        """The same law with checked numbers; ``key`` is the contact's in the model file.

        Raises:
            ModelError: a number is wrong.
        """
        law = self.read(f"{key}.restitution", self.written)
        assert law is not None, "it reads what it writes"
        return law

    @property
    def is_nonexpansive(self) -> bool:
        """Whether the slope of ``r`` lies in [-1, 1]: then an impact alone never raises V."""
        return True

    @abstractmethod
    def restitution_at(self, speed: Vector) -> Vector:
        """The coefficient of restitution at speeds >= 0, m/s, of any shape."""

    def rebound(self, gamma: Vector) -> Vector:
        """``r`` at contact speeds of any shape, m/s."""
        return np.asarray(self.restitution_at(np.abs(gamma)) * gamma)

    @abstractmethod
    def slope(self, gamma: Vector) -> Vector:
        """``dr/dgamma`` at contact speeds of any shape, m/s."""

    @property
    @abstractmethod
    def parameters(self) -> tuple[ReboundParameter, ...]:
        """The numbers that may be estimated, in the order of ``units``."""

    @abstractmethod
    def with_values(self, values: Sequence[float]) -> "ReboundLaw":
        """The law with other ``values`` of its parameters, unchecked."""

    @abstractmethod
    def sensitivity(self, gamma: Vector) -> Vector:
        """``dr`` by each parameter, the last axis, at contact speeds of any shape, m/s."""
