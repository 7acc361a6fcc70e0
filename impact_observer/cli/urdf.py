"""A URDF of a model: one prismatic joint a coordinate, with its name, and the stops.

So the joint states of plant or observer move it, through robot_state_publisher. Springs, and
contacts that are neither a wall nor a bumper, are not in it: no link of a URDF can be either.
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

from impact_observer.cli.arguments import not_negative, seed
from impact_observer.errors import UsageError

if TYPE_CHECKING:
    from impact_observer.draw.scene.scene import Scene
    from impact_observer.draw.scene.shapes import Box

_BODY, _STOP = (0.40, 0.61, 0.78), (0.45, 0.45, 0.45)
_FIXED = "_fixed"
"""What follows a stop's name in that of its joint."""
_FARTHEST, _MOST_ROWS = 1e6, 1000
"""How far a body may be taken to move, m, as in the viewer, and the last row."""
_LIMIT = 1e9
"""What a joint is limited to: a URDF wants a number, our coordinates end at their stops."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    parser.add_argument("model", metavar="MODEL", help="a model file, or a sample: two_mass, ...")
    parser.add_argument(
        "-o", "--output", metavar="FILE", type=Path, help="where to (default: standard output)"
    )
    parser.add_argument(
        "--prefix", metavar="P", default="", help="before the names of all links but the first"
    )
    parser.add_argument(
        "--frame", metavar="NAME", default="world", help="the first link (default world)"
    )
    parser.add_argument(
        "--row", metavar="N", type=seed, default=0, help="which row of the viewer (default 0)"
    )
    parser.add_argument(
        "--reach",
        metavar="M",
        type=not_negative,
        default=0.0,
        help="how far a body moves, to space them, m; 0 for the model's (default)",
    )


def run(args: argparse.Namespace) -> int:
    """Run the subcommand."""
    return urdf(
        args.model,
        args.output,
        prefix=args.prefix,
        frame=args.frame,
        row=args.row,
        reach=args.reach,
    )


def urdf(
    model: str | Path,
    output: Path | None,
    *,
    prefix: str = "",
    frame: str = "world",
    row: int = 0,
    reach: float = 0.0,
) -> int:
    """Write the URDF of a model.

    Args:
        model: a model file or a sample's name.
        output: where to; None for standard output.
        prefix: before the names of all links but the first.
        frame: name of the first link.
        row: how many rows of the viewer it stands aside.
        reach: how far each coordinate is taken to move, m; 0 for what the model says.

    Returns:
        0.

    Raises:
        UsageError, ModelError: the model is none, a number is too large, or the file cannot be
            written.
    """
    from impact_observer.draw.scene.scene import Scene
    from impact_observer.model import read_model

    for name, value, most in (("reach", reach, _FARTHEST), ("row", row, _MOST_ROWS)):
        if value > most:
            raise UsageError(f"--{name} {value:g}: expected at most {most:g}")
    read = read_model(model)
    known = () if read.position is None else [read.position]
    scene = Scene.of(read.system, known, reach)
    text = described(scene, prefix=prefix, frame=frame, row=row)
    if output is None:
        print(text, end="")
    else:
        try:
            output.write_text(text, encoding="utf-8")
        except OSError as error:
            raise UsageError(f"{output}: cannot be written: {error.strerror}") from None
    for line in scene.omitted:
        print(f"{read.system.name}: {line}", file=sys.stderr)
    return 0


def described(scene: "Scene", *, prefix: str = "", frame: str = "world", row: int = 0) -> str:
    """A scene as the text of a URDF.

    Args:
        scene: what to describe.
        prefix: before the names of all links but the first.
        frame: name of the first link.
        row: how many rows of the viewer it stands aside.

    Raises:
        UsageError: a body's link would have the name of the first.
    """
    from impact_observer.draw.scene.shapes import ROWS, grounds

    unit = 2 * scene.half
    aside = -row * ROWS * unit
    robot = ET.Element("robot", name=f"{prefix}{scene.system.name}")
    ground = ET.SubElement(robot, "link", name=frame)
    for box in grounds(scene):
        _add_box(ground, box, (0.0, aside, unit), _STOP)
    taken = {frame}
    for slot, name in enumerate(scene.names):
        child = f"{prefix}{name}"
        if child == frame:
            raise UsageError(f"frame {frame!r}: a coordinate has this name; give another one")
        taken.add(child)
        link = ET.SubElement(robot, "link", name=child)
        for box in _body(scene, slot):
            _add_box(link, box, (0.0, 0.0, unit), _BODY)
        joint = _add_joint(robot, name, "prismatic", (frame, child))
        _place(joint, float(scene.homes[slot]), aside)
        ET.SubElement(joint, "axis", xyz="1 0 0")
        limit = {"lower": f"{-_LIMIT:g}", "upper": f"{_LIMIT:g}", "effort": "0", "velocity": "0"}
        ET.SubElement(joint, "limit", limit)
    for child, face, box in _stops(scene, prefix, taken):
        link = ET.SubElement(robot, "link", name=child)
        _add_box(link, box, (0.0, 0.0, unit), _STOP)
        _place(_add_joint(robot, f"{child}{_FIXED}", "fixed", (frame, child)), face, aside)
    ET.indent(robot)
    return ET.tostring(robot, encoding="unicode", xml_declaration=True) + "\n"


def _body(scene: "Scene", slot: int) -> "Iterator[Box]":
    """A body about its middle, with the rods of its bumpers."""
    import numpy as np

    from impact_observer.draw.scene.shapes import ROD_HEIGHT, Box, pads

    yield Box(-scene.half, 0.0, 2 * scene.half, 1.0)
    home, thin = float(scene.homes[slot]), 0.06
    ends = pads(scene, scene.frame(np.zeros(scene.system.n)))
    for bumper, (_, pad) in zip(scene.bumpers, ends, strict=True):
        if bumper.slot == slot:
            yield Box(scene.half, ROD_HEIGHT - thin / 2, bumper.length, thin)
            yield pad._replace(left=pad.left - home)


def _stops(scene: "Scene", prefix: str, taken: set[str]) -> "Iterator[tuple[str, float, Box]]":
    """Name of the link, face and shape of each wall, seen from its face."""
    from impact_observer.draw.scene.shapes import STOP_HEIGHT, Box

    for wall in scene.walls:
        name = f"{prefix}{scene.system.contact_names[wall.contact]}"
        while name in taken or f"{name}{_FIXED}" in scene.names:
            name += "_stop"
        taken.add(name)
        left = -scene.thickness if wall.side < 0 else 0.0
        yield name, wall.face, Box(left, 0.0, scene.thickness, STOP_HEIGHT)


def _add_joint(robot: ET.Element, name: str, kind: str, links: tuple[str, str]) -> ET.Element:
    """A joint from one link to another."""
    joint = ET.SubElement(robot, "joint", name=name, type=kind)
    ET.SubElement(joint, "parent", link=links[0])
    ET.SubElement(joint, "child", link=links[1])
    return joint


def _place(element: ET.Element, *xyz: float) -> None:
    """Where something is, seen from its parent: what is missing of x, y, z is 0."""
    numbers = " ".join(repr(float(each)) for each in (*xyz, 0.0, 0.0)[:3])
    ET.SubElement(element, "origin", xyz=numbers, rpy="0 0 0")


def _add_box(
    link: ET.Element, box: "Box", where: tuple[float, float, float], colour: tuple[float, ...]
) -> None:
    """A box as deep as a body is wide.

    Args:
        link: that it belongs to.
        box: its shape.
        where: x and y that it is moved by, and a body's height, m.
        colour: red, green, blue.
    """
    x, y, unit = where
    visual = ET.SubElement(link, "visual")
    middle = (box.bottom + box.height / 2) * unit
    _place(visual, x + box.left + box.width / 2, y, middle)
    size = " ".join(repr(float(each)) for each in (box.width, unit, box.height * unit))
    ET.SubElement(ET.SubElement(visual, "geometry"), "box", size=size)
    material = ET.SubElement(visual, "material", name="_".join(f"{each:g}" for each in colour))
    ET.SubElement(material, "color", rgba=" ".join(f"{each:g}" for each in (*colour, 1.0)))
