# SPDX-License-Identifier: Apache-2.0
"""How the motion and the impacts of a robot depend on its uncertain parameters.

Names are those of ``RobotDescription.parameters``: ``damping.elbow``, ``rotor-inertia.elbow``,
``restitution.wall``.
"""

from collections.abc import Sequence

import numpy as np

from impact_observer.events import Contacts
from impact_observer.model.robot_description import DAMPING, RESTITUTION, ROTOR_INERTIA
from impact_observer.robots.robot import Robot
from impact_observer.states import Matrix, Vector


def rates_by_parameters(
    robot: Robot, x: Vector, tau: Vector, names: Sequence[str], closed: Contacts = ()
) -> Matrix:
    """Derivatives of ``Robot.rates`` by parameters, shape (2n, p), SI units."""
    n = robot.n
    acceleration = robot.acceleration(x[:n], x[n:], tau, closed)
    drags = torques_by_parameters(robot, x[n:], acceleration, names)
    return np.vstack([np.zeros_like(drags), robot.mobility_matrix(x[:n], closed) @ drags])


def torques_by_parameters(
    robot: Robot, u: Vector, acceleration: Vector, names: Sequence[str]
) -> Matrix:
    """What a unit of each parameter adds to the torques in motion, shape (n, p), SI units."""
    found = np.zeros((robot.n, len(names)))
    drags = {DAMPING: u, ROTOR_INERTIA: acceleration}
    for k, name in enumerate(names):
        kind, _, member = name.partition(".")
        if kind in drags:
            j = robot.coordinates.index(member)
            found[j, k] = -drags[kind][j]
    return found


def jump_by_parameters(robot: Robot, x: Vector, pushed: Contacts, names: Sequence[str]) -> Matrix:
    """Derivatives of ``Robot.jumped`` by parameters, shape (2n, p), SI units."""
    n, found = robot.n, np.zeros((2 * robot.n, len(names)))
    change = (robot.jumped(x, pushed) - x)[n:]
    free = robot.inverse_mass(x[:n])
    by_restitution = robot.jump_by_restitution(x, pushed)
    for k, name in enumerate(names):
        kind, _, member = name.partition(".")
        if kind == RESTITUTION and robot.contact_names.index(member) in pushed:
            found[:, k] = by_restitution[:, pushed.index(robot.contact_names.index(member))]
        elif kind == ROTOR_INERTIA:
            j = robot.coordinates.index(member)
            # the contact speeds after the impact do not depend on the masses
            found[n:, k] = -robot.stopped(x[:n], free[:, j] * change[j], pushed)
    return found
