# SPDX-License-Identifier: Apache-2.0
"""Play a bag to running nodes, each message when it is due.

In a terminal: space pauses and goes on, n or the right arrow sends the next message while paused,
up and down make it a tenth faster or slower, q ends.
"""

import argparse
import re
from pathlib import Path
from typing import TYPE_CHECKING

from impact_observer.cli.arguments import positive
from impact_observer.errors import UsageError

if TYPE_CHECKING:
    from impact_observer.cli.keyboard import Keyboard
    from impact_observer.io.play_schedule import Control
    from impact_observer.ros.player import Player

_DELAY = 5.0
_CLOCK_RATE = 100.0
"""Nodes that receive the bag need its time too, so /clock is published by default."""
_NAME = r"/?[A-Za-z_][A-Za-z0-9_]*(?:/[A-Za-z_][A-Za-z0-9_]*)*"
_REMAPPING = re.compile(f"({_NAME}):=({_NAME})")
_KEYS = {" ": "PAUSE", "n": "NEXT", "right": "NEXT", "up": "FASTER", "down": "SLOWER", "q": "QUIT"}
"""Keys, and names of :class:`~impact_observer.io.play_schedule.Control`."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    add = parser.add_argument
    # BAG comes first: behind --clock or --topics it would be taken for their value.
    parser.usage = (
        "%(prog)s BAG [--rate R] [--loop] [--start S] [--duration S] [--start-paused] "
        "[--topics TOPIC ...] [--remap FROM:=TO ...] [--qos FILE] [--clock [HZ] | --no-clock] "
        "[--delay S]"
    )
    add("bag", metavar="BAG", type=Path, help="a bag's folder, or a bare file")
    add(
        "--rate",
        metavar="R",
        type=float,
        default=1.0,
        help="speed relative to the recording (default: 1)",
    )
    add("--loop", action="store_true", help="start again at the end")
    add("--start", metavar="S", type=float, default=0.0, help="start S seconds into the bag")
    add("--duration", metavar="S", type=positive, help="play S seconds of the bag (default: all)")
    add("--start-paused", action="store_true", help="wait for the space bar, or n, to begin")
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
        "--qos",
        metavar="FILE",
        type=Path,
        help="qualities of service to offer, as ros2 bag play --qos-profile-overrides-path",
    )
    _add_clock_arguments(parser)
    add(
        "--delay",
        metavar="S",
        type=float,
        default=_DELAY,
        help="wait up to S seconds for a subscriber to the events (to every topic, if there are "
        f"none) before the first message (default: {_DELAY:g})",
    )


def _add_clock_arguments(parser: argparse.ArgumentParser) -> None:
    """Whether ``/clock`` is published, and its rate."""
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
        help="do not publish /clock: for a bag whose stamps are in the present",
    )


def remapping(text: str) -> tuple[str, str]:
    """``FROM:=TO`` as absolute names."""
    found = _REMAPPING.fullmatch(text)
    if not found:
        raise argparse.ArgumentTypeError(f"{text} found; expected FROM:=TO, names of topics")
    before, after = (f"/{name.lstrip('/')}" for name in found.groups())
    return before, after


def run(args: argparse.Namespace) -> int:
    """Play a bag and show how far it is."""
    from impact_observer.cli.keyboard import Keyboard
    from impact_observer.cli.progress import Progress
    from impact_observer.io.play_schedule import Playing
    from impact_observer.io.qos_overrides import read_overrides
    from impact_observer.ros.session import require_ros

    how = Playing(
        topics=args.topics,
        rate=args.rate,
        start=args.start,
        duration=args.duration,
        loop=args.loop,
        paused=args.start_paused,
        clock_rate=args.clock,
        names=dict(args.remap),
        profiles={} if args.qos is None else read_overrides(args.qos),
    )
    require_ros()
    from impact_observer.ros import player

    name = args.bag.resolve().name
    with Progress() as progress, Keyboard() as keyboard:
        if keyboard.available:
            progress.line("space pauses, n: next message, up, down: rate, q ends")
        elif how.paused:
            raise UsageError(
                "start-paused: needs a terminal on standard input, for the key that continues"
            )

        def show(now: "Player") -> None:
            if now.pace.paused:
                progress.show(f"{name}, paused at {now.elapsed:.3f} of {now.length:.1f} s")
            else:
                progress.step(f"{name} at {now.pace.rate:.3g}x", now.elapsed, now.length, "s")

        count = player.play(
            args.bag,
            how,
            delay=args.delay,
            on_progress=show,
            controls=lambda: controls_of(keyboard),
        )
        progress.line(f"{count} {'message' if count == 1 else 'messages'} played from {args.bag}")
    return 0


def controls_of(keyboard: "Keyboard") -> "list[Control]":
    """The controls of the keys pressed."""
    from impact_observer.io.play_schedule import Control

    return [Control[_KEYS[key]] for key in keyboard.pressed() if key in _KEYS]
