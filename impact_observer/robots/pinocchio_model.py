# SPDX-License-Identifier: Apache-2.0
"""The pinocchio model of a robot whose joints have one coordinate each."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TypeAlias
from xml.etree import ElementTree as ET

import numpy as np

from impact_observer.errors import UsageError
from impact_observer.model.robot_description import RobotDescription
from impact_observer.model.urdf_file import FIXED, UNITS_BY_TYPE

Pinocchio: TypeAlias = Any
"""The package, or an object of the package."""
_WIDE = {"lower": "-1e9", "upper": "1e9", "velocity": "1e9", "effort": "1e9"}
"""Limits of joints; they have no effect on the motion."""
_GEOMETRY = ("visual", "collision")
_OF_JOINTS = ("mimic", "limit", "safety_controller")


def imported_pinocchio() -> Pinocchio:
    """The package ``pinocchio``.

    Raises:
        UsageError: the package is not installed.
    """
    try:
        import pinocchio  # noqa: PLC0415 (most models are linear)
    except ImportError:
        raise UsageError(
            "pinocchio: not installed, and robots need it: pip install impact_observer[robots],"
            " or rosdep's key pinocchio (sudo apt install ros-jazzy-pinocchio)"
        ) from None
    return pinocchio


def pinocchio_model(robot: RobotDescription) -> Pinocchio:
    """The model of a ``robot`` without its held joints; each of its joints has one coordinate.

    Raises:
        UsageError: pinocchio is not installed, or the URDF has not come from its topic.
        ModelError: pinocchio does not take the URDF.
    """
    pin, urdf = imported_pinocchio(), robot.known_urdf
    said, reasons, model = list[str](), list[str](), None
    try:
        with _stderr_kept(said):
            model = _reduced_model(pin, robot)
    except (ValueError, RuntimeError, IndexError) as error:
        reasons = [str(error) or "no reason given"]
    # Where a number is none, the library prints so, and goes on without the inertia.
    reasons = [each.removeprefix("Error:") for each in said if each.startswith("Error:")] + reasons
    if model is None or reasons:
        words = "; ".join(" ".join(each.split()) for each in reasons)
        raise urdf.wrong(f"pinocchio cannot read it: {words}")
    return model


def _reduced_model(pin: Pinocchio, robot: RobotDescription) -> Pinocchio:
    """The model of ``pinocchio_model``; the library raises where it cannot read the URDF."""
    whole = pin.buildModelFromXML(_plain_text(robot))
    held = {name: value for name, value in robot.holds.items() if whole.existJointName(name)}
    position = pin.neutral(whole)
    for name, value in held.items():
        position[whole.joints[whole.getJointId(name)].idx_q] = value
    model = pin.buildReducedModel(whole, [whole.getJointId(name) for name in held], position)
    model.gravity.linear = robot.gravity
    model.armature = np.zeros(model.nv)
    for name, inertia in zip(robot.joints, robot.rotor_inertia.tolist(), strict=True):
        model.armature[model.joints[model.getJointId(name)].idx_v] = inertia
    return model


@contextmanager
def _stderr_kept(lines: list[str]) -> Iterator[None]:
    """Within the block, standard error goes to ``lines``: libraries print their own."""
    sys.stderr.flush()
    before = os.dup(2)
    with os.fdopen(os.memfd_create("stderr"), "w+b") as file:
        os.dup2(file.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(before, 2)
            os.close(before)
            file.seek(0)
            lines += file.read().decode(errors="replace").splitlines()


def _plain_text(robot: RobotDescription) -> str:
    """The URDF without geometry, in which a continuous joint is revolute: an angle each.

    Held joints with more than one coordinate are fixed.
    """
    root = robot.known_urdf.root()
    for link in root.iterfind("link"):
        for shape in [each for each in link if each.tag in _GEOMETRY]:
            link.remove(shape)
    for joint in root.iterfind("joint"):
        for part in [each for each in joint if each.tag in _OF_JOINTS]:
            joint.remove(part)
        kind = joint.get("type", "")
        if kind not in UNITS_BY_TYPE:
            joint.set("type", FIXED)
        else:
            joint.set("type", "revolute" if kind == "continuous" else kind)
            ET.SubElement(joint, "limit", _WIDE)
    return ET.tostring(root, encoding="unicode")
