# SPDX-License-Identifier: Apache-2.0
"""Watch a running plant and its observers in the terminal, until Ctrl-C.

The screen shows estimates against the truth where a plant publishes the truth, V over time, the
verdicts on the last events, and warnings. Where the output is no terminal, one line a second is
printed.
"""

import argparse
import math
from typing import TYPE_CHECKING

from impact_observer.cli.arguments import add_model, add_observers, positive
from impact_observer.plain_text import say

if TYPE_CHECKING:
    from impact_observer.ros.watcher import View

_RATE = 4.0
_LINES = 1.0
"""Lines a second where the output is no terminal."""
_ONCE = 10.0
"""Longest time that ``--once`` waits for messages, s."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    add_model(parser, "for V (default: the model that the plant publishes)")
    add_observers(parser, "show only these, by name (default: all that appear)")
    parser.add_argument(
        "--rate", metavar="HZ", type=positive, help="updates a second (default 4; 1 for lines)"
    )
    parser.add_argument(
        "--window",
        metavar="S",
        type=positive,
        default=60.0,
        help="time that the chart of V covers (default 60)",
    )
    parser.add_argument("--duration", metavar="S", type=positive, help="end after S seconds")
    parser.add_argument(
        "--once",
        action="store_true",
        help="print one picture as soon as every topic has brought a message and every observer"
        " has an estimate, with truth and V where a plant is, after 10 s (or --duration) at the"
        " latest; exit code 1 if nothing was received",
    )
    parser.add_argument("--json", action="store_true", help="print the results as lines of JSON")


def run(args: argparse.Namespace) -> int:
    """Watch; the exit code is 1 with ``--once`` if no message arrived."""
    from dataclasses import asdict
    from json import dumps

    from rich.console import Console
    from rich.live import Live

    from impact_observer.model import read_model
    from impact_observer.robots.robot import simulated
    from impact_observer.ros.session import require_ros

    require_ros()
    from impact_observer.ros.watcher import Listener, line, screen, watch

    system = None if args.model is None else simulated(read_model(args.model))
    listener = Listener(args.observers, system, window=args.window)
    console = Console(highlight=False)

    def say_line(view: "View") -> None:
        say(dumps(asdict(view)) if args.json else line(view))

    if args.once:
        last = watch(
            listener, lambda _: None, rate=_RATE, duration=args.duration or _ONCE, once=True
        )
        if args.json:
            say_line(last)
        else:
            console.print(screen(last, console))
        return int(not listener.received)
    duration = args.duration or math.inf
    if args.json or not console.is_terminal:
        say_line(watch(listener, say_line, rate=args.rate or _LINES, duration=duration))
        return 0
    with Live(console=console, screen=True, auto_refresh=False) as live:

        def show(view: "View") -> None:
            live.update(screen(view, console, console.size.height), refresh=True)

        last = watch(listener, show, rate=args.rate or _RATE, duration=duration)
    say(line(last))
    return 0
