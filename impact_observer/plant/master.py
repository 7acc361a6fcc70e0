# SPDX-License-Identifier: Apache-2.0
"""A plant, and the choice of the integrator."""

from typing import TypeAlias

from impact_observer.errors import UsageError
from impact_observer.integrators import DEFAULT_STEP, EVENT_DRIVEN, INTEGRATORS, MOREAU
from impact_observer.model import System
from impact_observer.model.live_signals import LiveSignals
from impact_observer.plant.event_driven import Plant
from impact_observer.plant.robot_plant import RobotPlant
from impact_observer.plant.time_stepping import TimeSteppingPlant
from impact_observer.robots.robot import Robot
from impact_observer.states import Vector

Master: TypeAlias = Plant | TimeSteppingPlant | RobotPlant
"""A plant of a linear system by either integrator, or of a robot."""


def make_plant(
    system: System | Robot,
    position: Vector,
    velocity: Vector,
    *,
    epoch: int,
    integrator: str = EVENT_DRIVEN,
    step: float = DEFAULT_STEP,
    live: LiveSignals | None = None,
) -> Master:
    """A plant at ``epoch`` (ns), from ``position`` and ``velocity``, shape (n,) each.

    ``live`` are the live signals of ``system``, if any.
    ``integrator`` is one of ``INTEGRATORS``; ``step`` is the length of the steps of ``moreau``, s.

    Raises:
        UsageError: a state or step that cannot be used, or an unknown integrator.
        ImpactLawError: contacts are closed at the start and their impact has no solution.
    """
    if isinstance(system, Robot):
        if integrator != EVENT_DRIVEN:
            raise UsageError(
                f"integrator: {integrator} found, which takes no robots; expected {EVENT_DRIVEN}"
            )
        return RobotPlant(system, position, velocity, epoch=epoch)
    if integrator == EVENT_DRIVEN:
        return Plant(system, position, velocity, epoch=epoch, live=live)
    if integrator == MOREAU:
        return TimeSteppingPlant(system, position, velocity, epoch=epoch, step=step)
    raise UsageError(f"integrator: {integrator!r} found; expected {' or '.join(INTEGRATORS)}")
