# SPDX-License-Identifier: Apache-2.0
"""Draw coordinates and velocities of a bag over time, with deviations, impacts and verdicts.

No truth is needed. A band is two standard deviations wide on either side.
"""

import argparse
from contextlib import suppress

from impact_observer.cli.arguments import PART, add_shared, names
from impact_observer.cli.progress import Progress
from impact_observer.errors import ModelError, UnfitBagError
from impact_observer.output_files import PICTURES
from impact_observer.plain_text import say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    add_shared(parser, "bag", *PART, "file", file="the picture: a PNG, SVG or PDF")
    parser.set_defaults(outputs={"output": PICTURES})
    select = "coordinates that are drawn (default: those that move most, at most eight)"
    parser.add_argument("--select", metavar="NAME,...", type=names, help=select)


def run(args: argparse.Namespace) -> int:
    """Draw a bag."""
    from impact_observer.draw.motion_picture import chosen_coordinates, motion_picture
    from impact_observer.draw.pictures import save
    from impact_observer.draw.recorded_motion import read_motion
    from impact_observer.io.bag_part import read_part
    from impact_observer.io.reader import BagReader
    from impact_observer.io.recordings import model_of

    with BagReader(args.bag) as reader, Progress() as progress:
        read_part(reader, args.start, args.duration, reader.state_topics())
        motion = read_motion(
            reader,
            lambda done, total: progress.step(f"reading {args.bag}", done, total),
        )
        chosen = chosen_coordinates(motion, args.select)
        progress.show(f"drawing {args.output}")
        save(motion_picture(motion, chosen), args.output, about=args.bag.name)
        with suppress(UnfitBagError, ModelError):
            if misfit := model_of(reader).misfit:
                say(f"warning: {misfit}")
    begin, end = motion.ends
    say(f"picture: {args.output}, {begin:.3f} to {end:.3f} s of {args.bag}")
    if left := len(motion.coordinates) - len(chosen) if args.select is None else 0:
        say(f"{left} coordinates that move less are not drawn; --select chooses")
    return 0
