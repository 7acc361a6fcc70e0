# SPDX-License-Identifier: Apache-2.0
"""What a model of a robot is, as values for ``--json``."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from impact_observer.model import Model
from impact_observer.robots.robot import Robot, robot_of
from impact_observer.states import Vector


def robot_json(model: Model) -> dict[str, Any]:
    """The values of ``--json``: SI units, None for no limit.

    Raises:
        UsageError: pinocchio is not installed.
        ModelError: the robot cannot move, or its start is inside a plane.
    """
    robot = robot_of(model)
    description, q = robot.description, model.position
    q = np.zeros(robot.n) if q is None else q
    limits = (robot.lower, robot.upper, robot.fastest, robot.strongest)
    columns = (robot.coordinates, robot.units, *limits, robot.damping, description.rotor_inertia)
    keys = ("name", "unit", "lower", "upper", "velocity", "effort", "damping", "rotor_inertia")
    with np.errstate(divide="ignore"):
        masses = 1.0 / robot.mobility(q)
    at = zip(description.contacts, robot.gaps(q).tolist(), masses.tolist(), strict=True)
    known = model.uncertainty.deviation_by_name if model.uncertainty else {}
    return {
        "name": robot.name,
        "robot": True,
        "urdf": description.origin,
        "n": robot.n,
        "m": robot.m,
        "joints": [
            {key: _finite(value) for key, value in zip(keys, row, strict=True)}
            for row in zip(*columns, strict=True)
        ],
        "held": description.holds,
        "contacts": [
            {
                "name": each.name,
                "frame": each.frame,
                "normal": each.normal.tolist(),
                "offset": each.offset,
                "restitution": each.rebound.written,
                "gap": gap,
                "effective_mass": _finite(mass),
            }
            for each, gap, mass in at
        ],
        "deviations": [
            {
                "name": name,
                "value": description.parameters[name],
                "deviation": deviation,
                "unit": description.unit_of_parameter(name),
            }
            for name, deviation in known.items()
        ],
        "findings": [
            {"kind": kind, "text": text}
            for kind, text in _findings(robot, None if model.position is None else q)
        ],
    }


def _finite(value: Any) -> Any:  # noqa: ANN401 (a number or a text)
    """Numbers as Python has them; None for an infinite one."""
    if isinstance(value, str):
        return value
    return float(value) if math.isfinite(value) else None


def _findings(robot: Robot, start: Vector | None) -> Iterator[tuple[str, str]]:
    """Kinds and texts of remarks; ``start`` are the coordinates of the start, if it is known."""
    description, forcing = robot.description, robot.forcing
    base = description.known_urdf.root_link
    yield "note", f"The root {base} counts as fixed. Contacts have no friction."
    if held := description.held_in_words:
        yield "note", f"{held[0].upper()}{held[1:]}."
    if turning := [each.name for each in description.urdf_joints if each.type == "continuous"]:
        yield "note", f"Angles count on beyond a turn; encoders of {', '.join(turning)} need not."
    for i in () if start is None else robot.beyond_limits(start):
        limits = f"{robot.lower[i]:g} to {robot.upper[i]:g} {robot.units[i]}"
        found = f"The start of {robot.coordinates[i]} is {start[i]:g}" if start is not None else ""
        yield "warning", f"{found}, outside its limits {limits}, which are no contacts."
    bounded = np.flatnonzero(np.isfinite(robot.lower) | np.isfinite(robot.upper))
    if limited := [robot.coordinates[i] for i in bounded]:
        limits = f"The URDF has limits of {', '.join(limited)}, which the model does not use"
        yield "note", f"{limits}: give a contact where the robot hits one."
    is_driven = forcing.depends_on_time or forcing.constant.any()
    for kind, text in description.torque_remarks:
        is_sure = is_driven and description.forces is None
        yield kind if is_sure else "note", f"{text[0].upper()}{text[1:]}."
    known = np.isfinite(robot.fastest) & (robot.fastest > 0)
    if slow := [robot.coordinates[i] for i in np.flatnonzero(~known)]:
        limits = f"The URDF has no velocity limit of {', '.join(slow)}"
        yield "note", f"{limits}, so nothing says how fast it may be at first."
    q = np.zeros(robot.n) if start is None else start
    if not robot.m:
        yield "note", "Without contacts nothing is hit."
    elif not robot.is_nonexpansive(q, tuple(range(robot.m))):
        raises = "An impact of all contacts at once could raise V where the robot starts"
        yield "warning", f"{raises}: give them a common restitution."
    yield "note", "Impacts alone do not tell the state of a robot: encoders are needed."
