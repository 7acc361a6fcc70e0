# SPDX-License-Identifier: Apache-2.0
"""A plant of a linear system or of a robot."""

from typing import TypeAlias

from impact_observer.model import System
from impact_observer.model.live_signals import LiveSignals
from impact_observer.plant.event_driven import Plant
from impact_observer.plant.robot_plant import RobotPlant
from impact_observer.robots.robot import Robot
from impact_observer.states import Vector

Master: TypeAlias = Plant | RobotPlant
"""A plant of a linear system or of a robot."""


def make_plant(
    system: System | Robot,
    position: Vector,
    velocity: Vector,
    *,
    epoch: int,
    live: LiveSignals | None = None,
) -> Master:
    """A plant at ``epoch`` (ns), from ``position`` and ``velocity``, shape (n,) each.

    ``live`` are the live signals of ``system``, if any.

    Raises:
        UsageError: a state that cannot be used.
        ImpactLawError: contacts are closed at the start and their impact has no solution.
    """
    if isinstance(system, Robot):
        return RobotPlant(system, position, velocity, epoch=epoch)
    return Plant(system, position, velocity, epoch=epoch, live=live)
