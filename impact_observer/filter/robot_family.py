# SPDX-License-Identifier: Apache-2.0
"""A robot and those of its restitutions that are uncertain, which the filter considers."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from impact_observer.model import System
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.model.robot_description import RESTITUTION
from impact_observer.robots.robot import Robot
from impact_observer.states import Vector


@dataclass(frozen=True, slots=True)
class RestitutionParameter:
    """The restitution of a contact of a robot.

    Attributes:
        name: such as ``restitution.wall``.
        contact: index of the contact.
        value: nominal value, as in the model.
    """

    name: str
    contact: int
    value: float
    low: ClassVar[float] = 0.0
    high: ClassVar[float] = 1.0
    size: ClassVar[float] = 1.0
    unit: ClassVar[str] = ""
    moves: ClassVar[bool] = False
    deviation_range: ClassVar[tuple[float, float]] = (1e-12, 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class RobotFamily(ParametricFamily):
    """A robot and those of its restitutions that are uncertain.

    Attributes:
        system: the robot with the values of the model.
        parameters: the restitutions.
    """

    system: Robot  # type: ignore[assignment]
    parameters: tuple[RestitutionParameter, ...] = ()  # type: ignore[assignment]

    def __post_init__(self) -> None:
        """Derive nothing: a robot has no coefficients."""

    @classmethod
    def named(cls, robot: Robot, names: Sequence[str]) -> "RobotFamily":
        """The family of those of the ``names`` that are restitutions."""
        known, contacts = robot.description.parameters, robot.contact_names
        own = {f"{RESTITUTION}.{contact}": i for i, contact in enumerate(contacts)}
        return cls(
            robot,
            tuple(RestitutionParameter(k, own[k], known[k]) for k in names if k in own),
        )

    def robot_at(self, values: Vector) -> Robot:
        """The robot with other ``values``, shape (p,)."""
        known = dict(zip(self.names, values.tolist(), strict=True))
        return self.system.with_restitutions(known)


def family_of(system: System | Robot) -> ParametricFamily:
    """The family of a linear system or a robot without parameters."""
    return RobotFamily(system) if isinstance(system, Robot) else ParametricFamily(system, ())
