# SPDX-License-Identifier: Apache-2.0
"""A URDF of a model: one joint a coordinate, with its name, and the stops.

What moves along a line has prismatic joints. What turns (``unit: rad``) has revolute joints: each
coordinate is an arm, which stands upright at an angle of zero, and its stops are posts.

The joint states of plant or observer move the robot through robot_state_publisher. Springs and
bars are left out: no link of a URDF changes its length.
"""

from collections.abc import Iterable, Iterator
from xml.etree import ElementTree as ET

import numpy as np

from impact_observer.draw.scene.arrangement import Wall
from impact_observer.draw.scene.scene import Scene
from impact_observer.draw.scene.shapes import ROD_HEIGHT, ROWS, STOP_HEIGHT, Box, grounds, pads
from impact_observer.errors import UsageError
from impact_observer.model import Model
from impact_observer.plain_text import printable_lines

_BODY, _STOP = (0.40, 0.61, 0.78), (0.45, 0.45, 0.45)
_ROD = 0.06
"""Thickness of a bumper's rod, in heights of a body."""
_ARM, _POST, _PITCH = 0.1, 0.3, 2.5
"""Width of an arm, height of a post beside its end, and distance of two arms, in arm lengths."""
_FIXED = "_fixed"
"""Suffix of the name of a stop's joint."""
_LIMIT = {"lower": "-1e+09", "upper": "1e+09", "effort": "0", "velocity": "0"}
"""Limits of every joint. A URDF requires numbers; coordinates are limited by their stops."""


def model_urdf(
    model: Model, *, prefix: str = "", frame: str = "world", row: int = 0, amplitude: float = 0.0
) -> str:
    """The URDF of a model: of a robot its own, else that of its scene, as ``urdf_text`` makes it.

    Args:
        model: the model.
        prefix: before the names of all links but the first; not of a robot.
        frame: name of the first link; not of a robot.
        row: number of the viewer's row; not of a robot.
        amplitude: how far each coordinate may move, m; 0 to take it from the model.

    Raises:
        UsageError: a robot's URDF is to come from its topic, or a link has the first one's name.
    """
    if model.robot is not None:
        return model.robot.known_urdf.text
    start = () if model.position is None else [model.position]
    scene = Scene.of_system(model.system, start, amplitude)
    return urdf_text(scene, prefix=prefix, frame=frame, row=row)


def urdf_text(
    scene: Scene, *, prefix: str = "", frame: str = "world", row: int = 0, length: float = 1.0
) -> str:
    """A scene as the text of a URDF.

    Args:
        scene: positions of bodies and stops.
        prefix: before the names of all links but the first.
        frame: name of the first link.
        row: number of the viewer's row; rows go along -y.
        length: of the arms of what turns, m: a model does not have it.

    Raises:
        UsageError: a body's link would have the name of the first.
    """
    turns = scene.system.unit == "rad"
    height = length if turns else 2 * scene.half
    depth = _ARM * length if turns else height
    y = -row * ROWS * height
    robot = ET.Element("robot", name=f"{prefix}{scene.system.name}")
    _add_link(robot, frame, () if turns else grounds(scene), _STOP, size=(height, depth), y=y)
    used = {frame}
    for slot, name in enumerate(scene.names):
        child = f"{prefix}{name}"
        if child == frame:
            raise UsageError(f"frame {frame!r}: a coordinate has this name; give another one")
        used.add(child)
        boxes = [Box(-depth / 2, 0.0, depth, 1.0)] if turns else _body(scene, slot)
        _add_link(robot, child, boxes, _BODY, size=(height, depth))
        joint = _add_joint(robot, name, "revolute" if turns else "prismatic", (frame, child))
        _add_origin(joint, slot * _PITCH * length if turns else float(scene.homes[slot]), y)
        ET.SubElement(joint, "axis", xyz="0 1 0" if turns else "1 0 0")
        ET.SubElement(joint, "limit", _LIMIT)
    for child, wall in _walls(scene, prefix, used):
        if turns:
            left = depth / 2 if wall.side > 0 else -3 * depth / 2
            box, x = Box(left, 1.0 - _POST, depth, _POST), wall.slot * _PITCH * length
        else:
            left = -scene.thickness if wall.side < 0 else 0.0
            box, x = Box(left, 0.0, scene.thickness, STOP_HEIGHT), scene.face(wall)
        _add_link(robot, child, [box], _STOP, size=(height, depth))
        joint = _add_joint(robot, f"{child}{_FIXED}", "fixed", (frame, child))
        _add_origin(joint, x, y, pitch=wall.travel if turns else 0.0)
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


def _walls(scene: Scene, prefix: str, used: set[str]) -> Iterator[tuple[str, Wall]]:
    """Each wall, with the name of its link, which is put into ``used``."""
    for wall in scene.walls:
        name = f"{prefix}{scene.system.contact_names[wall.contact]}"
        while name in used or f"{name}{_FIXED}" in scene.names:
            name += "_stop"
        used.add(name)
        yield name, wall


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
    size: tuple[float, float],
    y: float = 0.0,
) -> None:
    """A link of boxes.

    Args:
        robot: gets the link.
        name: of the link.
        boxes: in the frame of the link.
        colour: red, green, blue.
        size: height of a body and depth of all boxes, m.
        y: of all boxes, m.
    """
    link, (height, depth) = ET.SubElement(robot, "link", name=name), size
    for box in boxes:
        visual = ET.SubElement(link, "visual")
        _add_origin(visual, box.left + box.width / 2, y, (box.bottom + box.height / 2) * height)
        sides = _numbers(box.width, depth, box.height * height)
        ET.SubElement(ET.SubElement(visual, "geometry"), "box", size=sides)
        material = ET.SubElement(visual, "material", name="_".join(f"{c:g}" for c in colour))
        ET.SubElement(material, "color", rgba=" ".join(f"{c:g}" for c in (*colour, 1.0)))


def _add_origin(
    element: ET.Element, x: float, y: float, z: float = 0.0, *, pitch: float = 0.0
) -> None:
    """Write position, m, and ``pitch``, rad, of an element in the frame of its parent."""
    rpy = f"0 {float(pitch)!r} 0" if pitch else "0 0 0"
    ET.SubElement(element, "origin", xyz=_numbers(x, y, z), rpy=rpy)


def _numbers(*values: float) -> str:
    """Numbers as a URDF lists them, with all their digits."""
    return " ".join(repr(float(value)) for value in values)
