# SPDX-License-Identifier: Apache-2.0
"""The guard functions of a flight of a linear system or a robot."""

from impact_observer.events import Contacts
from impact_observer.filter.forecast import Flight
from impact_observer.filter.moving_system import MovingSystem
from impact_observer.filter.robot_guards import RobotGuards
from impact_observer.filter.robot_motion import RobotMotion
from impact_observer.model import System
from impact_observer.robots.robot import Robot


def flight_of(system: System | Robot, moving: MovingSystem, t: float, closed: Contacts) -> Flight:
    """A flight of ``system`` from ``t``, s since the epoch, with ``closed`` contacts."""
    if isinstance(system, Robot):
        assert isinstance(moving, RobotMotion), "of the robot"
        return RobotGuards(system, moving, t, closed)
    return Flight(system, moving, t, closed)
