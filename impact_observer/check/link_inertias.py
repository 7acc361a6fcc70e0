# SPDX-License-Identifier: Apache-2.0
"""Inertias in the URDF of a robot that are missing, or that no body has."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from impact_observer.draw.reports import listed
from impact_observer.model.robot_description import RobotDescription
from impact_observer.robots.robot import Robot
from impact_observer.states import Matrix, Vector

_PRINTED = 1e-3
"""Share of the largest moment of inertia by which printed digits may break a rule of inertias."""
_SINGULAR = 1e-8
"""Least eigenvalue of a mass matrix with a unit diagonal: below, accelerations are rounding."""
_TRIED = 100
"""Positions at which the mass matrix is looked at, beside the start."""


class _Inertia(NamedTuple):
    """The inertial of a link: mass, kg, and moments of inertia, shape (3, 3), kg m^2."""

    mass: float
    moments: Matrix


def inertia_remarks(robot: Robot, start: Vector) -> Iterator[tuple[str, str]]:
    """Kinds and texts of remarks on the inertias of a ``robot``, which starts at ``start``."""
    description = robot.description
    inertias, origin = _inertias(description), description.origin
    bodies = _links_by_joint(description)
    moved = [name for links in bodies.values() for name in links]
    without = [name for name in moved if name not in inertias]
    for joint, links in bodies.items():
        if all(name in without for name in links):
            text = f"No mass in {origin}: {listed(links)}, which {joint} moves"
            yield (
                "warning",
                f"{text}; give an inertial, or the motion of {joint} is not the robot's.",
            )
            without = [name for name in without if name not in links]
    if without:
        yield "note", f"Without an inertial, so counted as points of others: {listed(without)}."
    known = {name: inertias[name] for name in moved if name in inertias}
    if bad := [name for name, each in known.items() if not _is_possible(each)]:
        wanted = "a mass above 0, and moments of which none is above the sum of the others"
        yield (
            "warning",
            f"No body has the inertia of {listed(bad)} in {origin}; expected {wanted}.",
        )
    if points := [k for k, each in known.items() if k not in bad and not each.moments.any()]:
        yield "note", f"Moments of inertia are zero, so a point mass: {listed(points)}."
    if (q := _singular_at(robot, start)) is not None:
        place = ", ".join(f"{k} {x:.3g}" for k, x in zip(robot.coordinates, q, strict=True))
        text = f"The mass matrix is singular but for rounding at {place}"
        yield "warning", f"{text}; expected an inertia of each link, or rotor_inertia."


def _inertias(description: RobotDescription) -> dict[str, _Inertia]:
    """The inertials of links, by name; none of a link whose mass is zero."""
    found = {}
    for link in description.known_urdf.root().iterfind("link/inertial/.."):
        mass, inertia = link.find("inertial/mass"), link.find("inertial/inertia")
        value = 0.0 if mass is None else float(mass.get("value", 0))
        given = {} if inertia is None else inertia.attrib
        xx, xy, xz, yy, yz, zz = (
            float(given.get(f"i{axes}", 0)) for axes in ("xx", "xy", "xz", "yy", "yz", "zz")
        )
        moments = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        if value or moments.any():
            found[link.get("name", "")] = _Inertia(value, moments)
    return found


def _links_by_joint(description: RobotDescription) -> dict[str, list[str]]:
    """The links that are one body behind each joint of the state, by that joint."""
    above = {each.child: each for each in description.known_urdf.joints.values()}
    found: dict[str, list[str]] = {name: [] for name in description.joints}
    for link in description.known_urdf.links:
        joint = above.get(link)
        while joint is not None and joint.name not in found:
            joint = above.get(joint.parent)
        if joint is not None:
            found[joint.name].append(link)
    return found


def _is_possible(inertia: _Inertia) -> bool:
    """Whether some body has this ``inertia``."""
    moments = np.linalg.eigvalsh(inertia.moments)
    rounding = _PRINTED * float(np.abs(moments).max())
    within = moments[0] >= -rounding and moments[2] <= moments[0] + moments[1] + rounding
    return bool(within) and inertia.mass > 0


def _singular_at(robot: Robot, start: Vector) -> Vector | None:
    """Coordinates within the limits at which no velocities follow from momenta; None for none."""
    low, high = (np.clip(each, -np.pi, np.pi) for each in (robot.lower, robot.upper))
    drawn = np.random.default_rng(0).uniform(low, np.maximum(low, high), (_TRIED, robot.n))
    for q in (start, *drawn):
        M = robot.mass(q)
        size = np.sqrt(np.abs(np.diag(M)))
        if np.linalg.eigvalsh(M / np.outer(size, size))[0] < _SINGULAR:
            return np.asarray(q)
    return None
