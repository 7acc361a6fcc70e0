# SPDX-License-Identifier: Apache-2.0
"""Robots: rigid bodies of a URDF with contacts against planes. Needs the extra ``robots``."""

from impact_observer.robots.robot import Robot
from impact_observer.robots.robot import robot_of as multibody
from impact_observer.robots.robot_family import parametric_robots as family
from impact_observer.robots.robot_mechanism import RobotMechanism
from impact_observer.robots.robot_parameters import jump_by_parameters, rates_by_parameters
from impact_observer.robots.robot_report import robot_json as report
from impact_observer.robots.velocity_observer import VelocityObserver

__all__ = [
    "Robot",
    "RobotMechanism",
    "VelocityObserver",
    "family",
    "jump_by_parameters",
    "multibody",
    "rates_by_parameters",
    "report",
]
