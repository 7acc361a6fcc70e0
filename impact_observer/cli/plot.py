# SPDX-License-Identifier: Apache-2.0
"""Draw coordinates, velocities, gaps, deviations, and impacts of a bag over time.

No truth is needed. The file's ending chooses the format: a PNG, SVG or PDF, or a page (.html) to
zoom in, which needs plotly to be made and no network to be read. A band is two standard deviations
wide on either side.
"""

import argparse
from pathlib import Path

from impact_observer.cli.arguments import (
    add_force,
    add_measurements,
    add_model,
    add_namespace,
    add_observers,
    add_part,
    names,
    positive,
)
from impact_observer.errors import UsageError
from impact_observer.plain_text import say

PICTURES, PAGES = (".png", ".svg", ".pdf"), (".html", ".htm")
MOST_PANELS = 80
WIDTHS = (2.0, 60.0)
"""Least and largest width of a picture, inches."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    add = parser.add_argument
    add("bag", metavar="BAG", type=Path, help="a bag with estimates or truth")
    file = "a PNG, SVG, PDF or HTML"
    add("-o", "--output", metavar="FILE", type=Path, required=True, help=file)
    add_force(parser, "output")
    select = (
        "positions, velocities, gaps; a coordinate for its position and velocity, a contact for"
        " its gap; or single quantities q_NAME, u_NAME, g_NAME (default: positions and velocities"
        " of the coordinates that move most, at most eight)"
    )
    add("--select", metavar="WHAT,...", type=names, help=select)
    add_part(parser)
    width = "of a picture, inches (default 10); one column of panels below 6.5"
    add("--width", metavar="INCHES", type=positive, default=10.0, help=width)
    add_namespace(parser)
    add_observers(parser, "draw only observers of these names (default: all in the bag)")
    add_model(parser)
    add_measurements(parser)


def run(args: argparse.Namespace) -> int:
    """Draw a bag; without a model, in the bag or named, there are no gaps."""
    from impact_observer.cli.progress import Progress
    from impact_observer.draw.pictures import save
    from impact_observer.draw.plot.page import check_plotly, write_page
    from impact_observer.draw.plot.picture import recording_picture
    from impact_observer.draw.plot.series import read_recording, topics_drawn
    from impact_observer.io.bag_part import read_part
    from impact_observer.io.reader import BagReader
    from impact_observer.io.recordings import model_of
    from impact_observer.model.measurements_file import read_measurements
    from impact_observer.output_files import check_output
    from impact_observer.robots.robot import simulated

    check_output(args.output, (*PICTURES, *PAGES))
    is_page = args.output.suffix.lower() in PAGES
    if is_page:
        check_plotly(args.output)
    low, high = WIDTHS
    if not low <= args.width <= high:
        raise UsageError(f"--width {args.width:g}: expected {low:g} to {high:g} inches")
    with BagReader(args.bag, args.namespace) as reader, Progress() as progress:
        read_part(reader, args.start, args.duration, topics_drawn(reader, args.observers))
        known = args.model is not None or reader.model_text() is not None
        recording = read_recording(
            reader,
            simulated(model_of(reader, args.model)) if known else None,
            select=args.select,
            observers=args.observers,
            measurements=read_measurements(args.measurements),
            progress=lambda done, total: progress.step(f"reading {args.bag}", done, total),
            warn=lambda line: progress.line(f"warning: {line}"),
        )
        if len(recording.quantities) > MOST_PANELS:
            raise UsageError(
                f"{len(recording.quantities)} panels: too many to read; name at most"
                f" {MOST_PANELS} quantities with --select"
            )
        progress.show(f"drawing {args.output}")
        if is_page:
            write_page(recording, args.output)
        else:
            about = f"{recording.name}: {args.bag.name}".removeprefix(": ")
            save(recording_picture(recording, width=args.width), args.output, about=about)
    say(f"picture: {args.output}, {recording.start:.3f} to {recording.end:.3f} s of {args.bag}")
    return 0
