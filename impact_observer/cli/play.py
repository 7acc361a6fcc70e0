# SPDX-License-Identifier: Apache-2.0
"""Play a bag to running nodes, each message when it is due, until the end or Ctrl-C."""

import argparse
import re
from pathlib import Path
from typing import TYPE_CHECKING

from impact_observer.cli.arguments import positive

if TYPE_CHECKING:
    from impact_observer.ros.player import Player

_DELAY = 5.0
_NAME = r"/?[A-Za-z_][A-Za-z0-9_]*(?:/[A-Za-z_][A-Za-z0-9_]*)*"
_REMAPPING = re.compile(f"({_NAME}):=({_NAME})")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    # BAG comes first: behind --topics the bag would be taken for a topic.
    parser.usage = (
        "%(prog)s BAG [--rate R] [--start S] [--duration S] [--loop] [--topics TOPIC ...] "
        "[--remap FROM:=TO ...] [--no-clock] [--delay S]"
    )
    add = parser.add_argument
    add("bag", metavar="BAG", type=Path, help="a bag's folder, or a bare file")
    add(
        "--rate",
        metavar="R",
        type=float,
        default=1.0,
        help="speed relative to the recording (default: 1)",
    )
    add("--start", metavar="S", type=float, default=0.0, help="start S seconds into the bag")
    add("--duration", metavar="S", type=positive, help="play S seconds of the bag (default: all)")
    add("--loop", action="store_true", help="start again at the end")
    add("--topics", metavar="TOPIC", nargs="+", help="play these topics only (default: all)")
    add(
        "--remap",
        metavar="FROM:=TO",
        nargs="+",
        type=remapping,
        default=[],
        help="publish topics by other names",
    )
    add(
        "--no-clock",
        dest="clock",
        action="store_false",
        help="do not publish the bag's time on /clock: another clock runs already",
    )
    add(
        "--delay",
        metavar="S",
        type=float,
        default=_DELAY,
        help="wait up to S seconds for a subscriber to the events (without events: to every"
        f" topic) before the first message (default: {_DELAY:g})",
    )


def remapping(text: str) -> tuple[str, str]:
    """``FROM:=TO`` as absolute names."""
    from impact_observer.io.interfaces import absolute

    names = _REMAPPING.fullmatch(text)
    if not names:
        raise argparse.ArgumentTypeError(f"{text} found; expected FROM:=TO, names of topics")
    before, after = map(absolute, names.groups())
    return before, after


def run(args: argparse.Namespace) -> int:
    """Play a bag and show how far the bag is played."""
    from impact_observer.cli.progress import Progress
    from impact_observer.io.interfaces import absolute
    from impact_observer.ros.session import require_ros

    require_ros()
    from impact_observer.ros import player

    how = player.Playing(
        topics=None if args.topics is None else [*map(absolute, args.topics)],
        rate=args.rate,
        start=args.start,
        duration=args.duration,
        loop=args.loop,
        clock=args.clock,
        names=dict(args.remap),
    )
    name = args.bag.resolve().name
    with Progress() as progress:

        def show(now: "Player") -> None:
            progress.step(f"playing {name}", now.elapsed, now.length)

        count = player.play(args.bag, how, delay=args.delay, on_progress=show)
        progress.line(f"{count} {'message' if count == 1 else 'messages'} played from {args.bag}")
    return 0
