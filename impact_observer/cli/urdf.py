# SPDX-License-Identifier: Apache-2.0
"""A URDF of a model: one prismatic or revolute joint a coordinate, with its name, and the stops.

The joint states of plant or observer move the robot through robot_state_publisher. Springs, and
contacts that are neither a wall nor a bumper, are left out: no link of a URDF changes its length.
"""

import argparse
import sys
from pathlib import Path

from impact_observer.cli.arguments import add_force, not_negative, positive, seed
from impact_observer.errors import UsageError
from impact_observer.plain_text import say

_MOST = {"amplitude": 1e6, "row": 1000, "length": 1e6}
"""Largest amplitude, m, the same as the viewer's, the last row, and the longest arm, m."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    add = parser.add_argument
    add("model", metavar="MODEL", help="a model file, or a sample: two_mass, ...")
    add("-o", "--output", metavar="FILE", type=Path, help="the file (default: standard output)")
    add_force(parser, "output")
    add("--prefix", metavar="P", default="", help="before the names of all links but the first")
    add("--frame", metavar="NAME", default="world", help="the first link (default world)")
    add("--row", metavar="N", type=seed, default=0, help="number of the viewer's row (default 0)")
    amplitude = (
        "largest displacement of a body, by which they are spaced, m (default: the model's)"
    )
    add("--amplitude", metavar="M", type=not_negative, default=0.0, help=amplitude)
    length = "drawn length of the arms of what turns, m (default 1)"
    add("--length", metavar="M", type=positive, default=1.0, help=length)


def run(args: argparse.Namespace) -> int:
    """Run the subcommand."""
    return urdf(
        args.model,
        args.output,
        prefix=args.prefix,
        frame=args.frame,
        row=args.row,
        amplitude=args.amplitude,
        length=args.length,
    )


def urdf(
    model: str | Path,
    output: Path | None,
    *,
    prefix: str = "",
    frame: str = "world",
    row: int = 0,
    amplitude: float = 0.0,
    length: float = 1.0,
) -> int:
    """Write the URDF of a model.

    Args:
        model: a model file or a sample's name.
        output: the file; None for standard output.
        prefix: before the names of all links but the first.
        frame: name of the first link.
        row: number of the viewer's row.
        amplitude: how far each coordinate may move, m; 0 to take it from the model.
        length: of the arms of what turns, m.

    Returns:
        0.

    Raises:
        UsageError, ModelError: the model cannot be read, a number is too large, or the file
            may not be written.
        OutputError: the disk is full or gone.
    """
    from impact_observer.draw.scene.scene import Scene
    from impact_observer.draw.urdf_text import urdf_text
    from impact_observer.model import read_model
    from impact_observer.output_files import replacing

    for name, value in (("amplitude", amplitude), ("row", row), ("length", length)):
        if value > _MOST[name]:
            raise UsageError(f"--{name} {value:g}: expected at most {_MOST[name]:g}")
    read = read_model(model)
    start = () if read.position is None else [read.position]
    scene = Scene.of_system(read.system, start, amplitude)
    text = urdf_text(scene, prefix=prefix, frame=frame, row=row, length=length)
    if output is None:
        say(text.removesuffix("\n"))
    else:
        with replacing(output) as temporary:
            temporary.write_text(text, encoding="utf-8")
    between = len(scene.bumpers) if read.system.unit == "rad" else 0
    left_out = [f"{between} stops between two arms are not drawn"] if between else []
    for line in (*scene.omitted, *left_out):
        say(f"{read.system.name}: {line}", file=sys.stderr)
    return 0
