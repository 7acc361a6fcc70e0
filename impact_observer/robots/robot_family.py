# SPDX-License-Identifier: Apache-2.0
"""A robot and those of its parameters that are uncertain, which the filter considers."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from impact_observer.model import Model, System
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.model.robot_description import RESTITUTION
from impact_observer.robots.robot import Robot, robot_of
from impact_observer.states import Vector


@dataclass(frozen=True, slots=True)
class RobotParameter:
    """A restitution, a damping or a rotor inertia of a robot.

    Attributes:
        name: such as ``restitution.wall``.
        value: nominal value, as in the model.
        unit: SI unit; empty for a ratio.
    """

    name: str
    value: float
    unit: str

    @property
    def kind(self) -> str:
        """The first part of the name."""
        return self.name.partition(".")[0]

    @property
    def moves(self) -> bool:
        """Whether the motion between impacts depends on the parameter."""
        return self.kind != RESTITUTION

    @property
    def low(self) -> float:
        """Least value allowed."""
        return 0.0

    @property
    def high(self) -> float:
        """Largest value allowed."""
        return math.inf if self.moves else 1.0

    @property
    def size(self) -> float:
        """Scale of the parameter."""
        return self.value if self.moves and self.value else 1.0

    @property
    def deviation_range(self) -> tuple[float, float]:
        """Least and largest standard deviation, in the unit of the value."""
        return 1e-12, 1e9 if self.moves else 1.0


@dataclass(frozen=True, slots=True, eq=False)
class RobotFamily(ParametricFamily):
    """A robot and those of its parameters that are uncertain.

    Attributes:
        system: the robot with the values of the model.
        parameters: first those that change the motion between impacts.
    """

    system: Robot  # type: ignore[assignment]
    parameters: tuple[RobotParameter, ...] = ()  # type: ignore[assignment]

    def __post_init__(self) -> None:
        """Derive nothing: a robot has no coefficients."""

    @classmethod
    def named(cls, robot: Robot, names: Sequence[str]) -> "RobotFamily":
        """The family of the parameters of these ``names``."""
        model = robot.description
        found = [
            RobotParameter(name, model.parameters[name], model.unit_of_parameter(name))
            for name in names
        ]
        return cls(robot, tuple(sorted(found, key=lambda each: not each.moves)))

    def system_at(self, values: Vector) -> Robot:  # type: ignore[override]
        """The robot with other ``values``, shape (p,)."""
        known = dict(zip(self.names, values.tolist(), strict=True))
        return self.system.with_parameters(known)


def parametric_robots(model: Model, names: Sequence[str]) -> RobotFamily:
    """The family of the robot of a ``model`` with the parameters of these ``names``.

    Raises:
        UsageError, ModelError: as ``robot_of``.
    """
    return RobotFamily.named(robot_of(model), names)


def family_of(system: System | Robot) -> ParametricFamily:
    """The family of a linear system or a robot without parameters."""
    return RobotFamily(system) if isinstance(system, Robot) else ParametricFamily(system, ())
