"""Play a bag to running nodes, each message when it is due."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from impact_observer.nodes.player import Player

_DELAY = 5.0
_CLOCK_RATE = 100.0
"""Nodes that hear the bag want its time too, so /clock is published unless told otherwise."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    # BAG comes first: behind --clock or --topics it would be taken for their value.
    parser.usage = (
        "%(prog)s BAG [--rate R] [--loop] [--start S] [--topics TOPIC ...] "
        "[--clock [HZ] | --no-clock] [--delay S]"
    )
    parser.add_argument("bag", metavar="BAG", type=Path, help="a bag's folder, or a bare file")
    parser.add_argument(
        "--rate", metavar="R", type=float, default=1.0, help="times as fast (default: 1)"
    )
    parser.add_argument("--loop", action="store_true", help="begin again at the end")
    parser.add_argument(
        "--start", metavar="S", type=float, default=0.0, help="begin S seconds into the bag"
    )
    parser.add_argument(
        "--topics", metavar="TOPIC", nargs="+", help="play these topics only (default: all)"
    )
    clock = parser.add_mutually_exclusive_group()
    clock.add_argument(
        "--clock",
        metavar="HZ",
        nargs="?",
        type=float,
        const=_CLOCK_RATE,
        default=_CLOCK_RATE,
        help="publish the bag's time on /clock, at every message and HZ times a second "
        f"(default: {_CLOCK_RATE:g})",
    )
    clock.add_argument(
        "--no-clock",
        dest="clock",
        action="store_const",
        const=None,
        help="leave /clock alone: for a bag whose stamps are the present",
    )
    parser.add_argument(
        "--delay",
        metavar="S",
        type=float,
        default=_DELAY,
        help="wait up to S seconds for a subscriber to the events (to every topic, if there are "
        f"none) before the first message (default: {_DELAY:g})",
    )


def run(args: argparse.Namespace) -> int:
    """Run the subcommand."""
    return play(
        args.bag,
        args.topics,
        rate=args.rate,
        loop=args.loop,
        start=args.start,
        clock_rate=args.clock,
        delay=args.delay,
    )


def play(
    bag: Path,
    topics: Sequence[str] | None = None,
    *,
    rate: float = 1.0,
    loop: bool = False,
    start: float = 0.0,
    clock_rate: float | None = None,
    delay: float = _DELAY,
) -> int:
    """Play a bag and show how far it is.

    Args:
        bag: the bag.
        topics: only these absolute names; None for all.
        rate: seconds of the bag a second of the wall clock.
        loop: whether to begin again at the end, until Ctrl-C.
        start: where to begin, s after the bag's start.
        clock_rate: ticks of ``/clock``, Hz of wall time; None for no clock.
        delay: longest wait for subscribers before the first message, s.

    Returns:
        0.

    Raises:
        UsageError: ROS or the bag is not here, or an argument does not fit the bag.
        BagError: the bag is damaged.
    """
    from impact_observer.cli.progress import Progress
    from impact_observer.nodes.session import require_ros

    require_ros()
    from impact_observer.nodes import player

    with Progress() as progress:

        def show(now: "Player") -> None:
            progress.show(
                f"{now.elapsed:.1f} of {now.length:.1f} s at {rate:g}x, {now.count} messages"
            )

        count = player.play(
            bag,
            topics,
            rate=rate,
            loop=loop,
            start=start,
            clock_rate=clock_rate,
            delay=delay,
            on_progress=show,
        )
        progress.line(f"{count} messages played from {bag}")
    return 0
