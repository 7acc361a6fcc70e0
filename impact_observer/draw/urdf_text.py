# SPDX-License-Identifier: Apache-2.0
"""A URDF of a model: one prismatic joint a coordinate, with its name, and the stops.

The joint states of plant or observer move the robot through robot_state_publisher. Springs and
bars are left out: no link of a URDF changes its length.
"""

from collections.abc import Iterable, Iterator
from xml.etree import ElementTree as ET

import numpy as np

from impact_observer.draw.scene.scene import Scene
from impact_observer.draw.scene.shapes import ROD_HEIGHT, ROWS, STOP_HEIGHT, Box, grounds, pads
from impact_observer.errors import UsageError
from impact_observer.plain_text import printable_lines

_BODY, _STOP = (0.40, 0.61, 0.78), (0.45, 0.45, 0.45)
_ROD = 0.06
"""Thickness of a bumper's rod, in heights of a body."""
_FIXED = "_fixed"
"""Suffix of the name of a stop's joint."""
_LIMIT = {"lower": "-1e+09", "upper": "1e+09", "effort": "0", "velocity": "0"}
"""Limits of every joint. A URDF requires numbers; coordinates are limited by their stops."""


def urdf_text(scene: Scene, *, prefix: str = "", frame: str = "world", row: int = 0) -> str:
    """A scene as the text of a URDF.

    Args:
        scene: positions of bodies and stops.
        prefix: before the names of all links but the first.
        frame: name of the first link.
        row: number of the viewer's row; rows go along -y.

    Raises:
        UsageError: a body's link would have the name of the first.
    """
    height = 2 * scene.half
    y = -row * ROWS * height
    robot = ET.Element("robot", name=f"{prefix}{scene.system.name}")
    _add_link(robot, frame, grounds(scene), _STOP, height=height, y=y)
    used = {frame}
    for slot, name in enumerate(scene.names):
        child = f"{prefix}{name}"
        if child == frame:
            raise UsageError(f"frame {frame!r}: a coordinate has this name; give another one")
        used.add(child)
        _add_link(robot, child, _body(scene, slot), _BODY, height=height)
        joint = _add_joint(robot, name, "prismatic", (frame, child))
        _add_origin(joint, float(scene.homes[slot]), y)
        ET.SubElement(joint, "axis", xyz="1 0 0")
        ET.SubElement(joint, "limit", _LIMIT)
    for child, face, box in _walls(scene, prefix, used):
        _add_link(robot, child, [box], _STOP, height=height)
        _add_origin(_add_joint(robot, f"{child}{_FIXED}", "fixed", (frame, child)), face, y)
    ET.indent(robot)
    return printable_lines(ET.tostring(robot, encoding="unicode", xml_declaration=True)) + "\n"


def _body(scene: Scene, slot: int) -> Iterator[Box]:
    """The boxes of a body and of its bumpers' rods, from the body's middle."""
    yield Box(-scene.half, 0.0, 2 * scene.half, 1.0)
    home = float(scene.homes[slot])
    ends = pads(scene, scene.frame(np.zeros(scene.system.n)))
    for bumper, (_, pad) in zip(scene.bumpers, ends, strict=True):
        if bumper.slot == slot:
            yield Box(scene.half, ROD_HEIGHT - _ROD / 2, scene.rod(bumper), _ROD)
            yield pad._replace(left=pad.left - home)


def _walls(scene: Scene, prefix: str, used: set[str]) -> Iterator[tuple[str, float, Box]]:
    """Name of the link, position of the face, and box in the frame of the face, of each wall."""
    for wall in scene.walls:
        name = f"{prefix}{scene.system.contact_names[wall.contact]}"
        while name in used or f"{name}{_FIXED}" in scene.names:
            name += "_stop"
        used.add(name)
        left = -scene.thickness if wall.side < 0 else 0.0
        yield name, scene.face(wall), Box(left, 0.0, scene.thickness, STOP_HEIGHT)


def _add_joint(robot: ET.Element, name: str, kind: str, links: tuple[str, str]) -> ET.Element:
    joint = ET.SubElement(robot, "joint", name=name, type=kind)
    ET.SubElement(joint, "parent", link=links[0])
    ET.SubElement(joint, "child", link=links[1])
    return joint


def _add_link(
    robot: ET.Element,
    name: str,
    boxes: Iterable[Box],
    colour: tuple[float, ...],
    *,
    height: float,
    y: float = 0.0,
) -> None:
    """A link of boxes, each as deep as a body is wide.

    Args:
        robot: gets the link.
        name: of the link.
        boxes: in the frame of the link.
        colour: red, green, blue.
        height: of a body, m.
        y: of all boxes, m.
    """
    link = ET.SubElement(robot, "link", name=name)
    for box in boxes:
        visual = ET.SubElement(link, "visual")
        _add_origin(visual, box.left + box.width / 2, y, (box.bottom + box.height / 2) * height)
        size = _numbers(box.width, height, box.height * height)
        ET.SubElement(ET.SubElement(visual, "geometry"), "box", size=size)
        material = ET.SubElement(visual, "material", name="_".join(f"{c:g}" for c in colour))
        ET.SubElement(material, "color", rgba=" ".join(f"{c:g}" for c in (*colour, 1.0)))


def _add_origin(element: ET.Element, x: float, y: float, z: float = 0.0) -> None:
    """Write the position of an element in the frame of its parent, m."""
    ET.SubElement(element, "origin", xyz=_numbers(x, y, z), rpy="0 0 0")


def _numbers(*values: float) -> str:
    """Numbers as a URDF lists them, with all their digits."""
    return " ".join(repr(float(value)) for value in values)
