# SPDX-License-Identifier: Apache-2.0
"""Play a bag to running nodes, each message when it is due, until the end or Ctrl-C."""

import argparse

from impact_observer.cli.arguments import add_shared, positive
from impact_observer.cli.progress import Progress
from impact_observer.draw.reports import counted


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    # BAG comes first: behind --topics the bag would be taken for a topic.
    parser.usage = "%(prog)s BAG [--rate R] [--loop] [--topics TOPIC ...]"
    add = parser.add_argument
    add_shared(parser, "bag", "topics")
    add(
        "--rate",
        metavar="R",
        type=positive,
        default=1.0,
        help="speed relative to the recording (default: 1)",
    )
    add("--loop", action="store_true", help="start again at the end")


def run(args: argparse.Namespace) -> int:
    """Play a bag and show how far the bag is played."""
    from impact_observer.io.interfaces import absolute
    from impact_observer.ros.session import require_ros

    require_ros()
    from impact_observer.ros.player import play

    topics = None if args.topics is None else [*map(absolute, args.topics)]
    what = f"playing {args.bag.resolve().name}"
    with Progress() as progress:
        count = play(
            args.bag,
            topics,
            rate=args.rate,
            loop=args.loop,
            on_progress=lambda elapsed, length: progress.step(what, elapsed, length),
        )
        progress.line(f"{counted(count, 'message')} played from {args.bag}")
    return 0
