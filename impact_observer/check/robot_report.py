# SPDX-License-Identifier: Apache-2.0
"""What a model of a robot is, as text with tables, and as values for ``--json``."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from impact_observer.check.link_inertias import inertia_remarks
from impact_observer.draw.reports import TextTable, counted, listed, print_facts, print_table
from impact_observer.model import Model
from impact_observer.model.robot_description import RobotDescription
from impact_observer.plain_text import say
from impact_observer.robots.robot import Robot, robot_of
from impact_observer.states import Vector


class RobotCheck(NamedTuple):
    """A checked model of a robot.

    Attributes:
        model: the model.
        robot: the robot.
        position: coordinates of the start, or zeros without one, shape (n,).
    """

    model: Model
    robot: Robot
    position: Vector

    @property
    def description(self) -> RobotDescription:
        """The contents of the model file."""
        return self.robot.description

    @property
    def has_start(self) -> bool:
        """Whether the model has an initial state."""
        return self.model.position is not None


def check_robot(model: Model) -> RobotCheck:
    """Check the ``model`` of a robot.

    Raises:
        UsageError: pinocchio is not installed.
        ModelError: the robot cannot move, or its start is inside a plane.
    """
    robot = robot_of(model)
    return RobotCheck(
        model, robot, np.zeros(robot.n) if model.position is None else model.position
    )


def robot_json(checked: RobotCheck) -> dict[str, object]:
    """The values of ``--json``: SI units, None for no limit."""
    robot, description = checked.robot, checked.description
    rows = zip(
        robot.coordinates,
        robot.units,
        *(
            [value if math.isfinite(value) else None for value in each.tolist()]
            for each in (robot.lower, robot.upper, robot.fastest, robot.strongest)
        ),
        robot.damping.tolist(),
        description.rotor_inertia.tolist(),
        strict=True,
    )
    keys = ("name", "unit", "lower", "upper", "velocity", "effort", "damping", "rotor_inertia")
    return {
        "name": robot.name,
        "robot": True,
        "urdf": description.origin,
        "n": robot.n,
        "m": robot.m,
        "joints": [dict(zip(keys, row, strict=True)) for row in rows],
        "held": description.holds,
        "contacts": [
            {
                "name": each.name,
                "frame": each.frame,
                "normal": each.normal.tolist(),
                "offset": each.offset,
                **each.rebound.document,
                "contact_time": each.contact_time,
                "gap": gap,
                "effective_mass": mass if math.isfinite(mass) else None,
            }
            for each, gap, mass in zip(
                description.contacts, *_at(checked.position, robot), strict=True
            )
        ],
        "deviations": [each._asdict() for each in _declared(checked.model, description)],
        "findings": [{"kind": kind, "text": text} for kind, text in _findings(checked)],
    }


def print_robot(checked: RobotCheck) -> None:
    """Print what the robot is, and remarks."""
    robot, description = checked.robot, checked.description
    say(
        f"{robot.name}: a robot (urdf: {description.origin}), {counted(robot.n, 'joint')},"
        f" {counted(robot.m, 'contact')}; SI units"
    )
    joints = [
        (name, unit, *map(_number, numbers))
        for name, unit, *numbers in zip(
            robot.coordinates,
            robot.units,
            *(each.tolist() for each in (robot.lower, robot.upper, robot.fastest)),
            robot.damping.tolist(),
            description.rotor_inertia.tolist(),
            strict=True,
        )
    ]
    say("")
    headings = ("joint", "unit", "from", "to", "speed up to", "damping", "rotor inertia")
    print_table(TextTable(headings, joints))
    if robot.m:
        contacts = [
            (
                *(each.name, each.frame, " ".join(f"{x:g}" for x in each.normal)),
                *(f"{each.offset:g}", each.rebound.text, f"{each.contact_time:g}"),
                *(f"{gap:.4g}", _number(mass)),
            )
            for each, gap, mass in zip(
                description.contacts, *_at(checked.position, robot), strict=True
            )
        ]
        start = "start" if checked.has_start else "zero"
        names = (
            *("contact", "frame", "normal", "offset [m]", "restitution", "lasts [s]"),
            *(f"gap at {start} [m]", "eff. mass [kg]"),
        )
        say("")
        print_table(TextTable(names, contacts))
    if declared := [*_declared(checked.model, description)]:
        rows = [(d.name, f"{d.value:.6g}", f"{d.deviation:.3g}", d.unit) for d in declared]
        say("")
        print_table(TextTable(("parameter", "value", "deviation", "unit"), rows))
    say("")
    print_facts(_findings(checked))


class _Declared(NamedTuple):
    """A parameter with a deviation."""

    name: str
    value: float
    deviation: float
    unit: str


def _declared(model: Model, description: RobotDescription) -> Iterator[_Declared]:
    if model.uncertainty is None:
        return
    for name, deviation in model.uncertainty.deviation_by_name.items():
        unit = description.unit_of_parameter(name)
        yield _Declared(name, description.parameters[name], deviation, unit)


def _number(value: float) -> str:
    return f"{value:.4g}" if math.isfinite(value) else ""


def _at(q: Vector, robot: Robot) -> tuple[list[float], list[float]]:
    """Gaps, m, and effective masses, kg, of the contacts."""
    with np.errstate(divide="ignore"):
        return robot.gaps(q).tolist(), (1.0 / robot.mobility(q)).tolist()


def _torques(robot: Robot) -> Iterator[tuple[str, str]]:
    """Kinds and texts of remarks on torques that an observer does not know."""
    description, forcing = robot.description, robot.forcing
    driven = forcing.depends_on_time or forcing.constant.any()
    is_sure = driven and description.forces is None
    for kind, text in description.torque_remarks:
        yield kind if is_sure else "note", f"{text[0].upper()}{text[1:]}."


def _findings(checked: RobotCheck) -> Iterator[tuple[str, str]]:
    """Kinds and texts of remarks."""
    robot, description = checked.robot, checked.description
    base = description.known_urdf.root_link
    yield "note", f"The root {base} counts as fixed. Contacts have no friction."
    if held := description.held_in_words:
        yield "note", f"{held[0].upper()}{held[1:]}."
    if turning := [each.name for each in description.urdf_joints if each.type == "continuous"]:
        yield "note", f"Angles count on beyond a turn; encoders of {listed(turning)} need not."
    for i in robot.beyond_limits(checked.position) if checked.has_start else ():
        limits = f"{robot.lower[i]:g} to {robot.upper[i]:g} {robot.units[i]}"
        start = f"The start of {robot.coordinates[i]} is {checked.position[i]:g}"
        yield "warning", f"{start}, outside its limits {limits}, which are no contacts."
    bounded = np.isfinite(robot.lower) | np.isfinite(robot.upper)
    if limited := [robot.coordinates[i] for i in np.flatnonzero(bounded)]:
        limits = f"The URDF has limits of {listed(limited)}, which the model does not use"
        yield "note", f"{limits}: give a contact where the robot hits one."
    yield from inertia_remarks(robot, checked.position)
    yield from _torques(robot)
    known = [math.isfinite(speed) and speed > 0 for speed in robot.fastest.tolist()]
    if slow := [
        name for name, is_known in zip(robot.coordinates, known, strict=True) if not is_known
    ]:
        limits = f"The URDF has no velocity limit of {listed(slow)}"
        yield "note", f"{limits}, so nothing says how fast it may be at first."
    if not robot.m:
        yield "note", "Without contacts nothing is hit."
    elif not robot.is_nonexpansive(checked.position, tuple(range(robot.m))):
        raises = "An impact of all contacts at once could raise V where the robot starts"
        yield "warning", f"{raises}: give them a common restitution."
    unproved = "that V never rises, which modes the impacts show, and how long estimates take"
    yield "note", f"Not proved, as the model is not linear: {unproved}."
    yield "note", "Impacts alone do not tell the state of a robot: encoders are needed."
