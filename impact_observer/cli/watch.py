"""Watch a running plant and its observers in the terminal.

Estimates against the truth where somebody publishes it, V and the distance between replicas over
time, what became of the last events, rates and latencies. Keys: space freezes, q ends. Where the
output is no terminal it is one line a second.
"""

import argparse
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING

from impact_observer.cli.arguments import add_model, positive

if TYPE_CHECKING:
    from rich.console import Console

    from impact_observer.cli.watch_screen import ScreenStyle
    from impact_observer.ros.snapshot import Glance, ObserverGlance
    from impact_observer.ros.topic_listener import Listening

_RATE = 4.0
_LINES = 1.0
"""Lines a second where there is no terminal."""
_ONCE = 5.0
"""How long one look waits for what there is, s."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    add_model(
        parser, "to compute V with where no monitor tells it (default: as the plant publishes)"
    )
    parser.add_argument(
        "--observer",
        metavar="NAME",
        action="append",
        help="an observer node to show; may be given again (default: all that appear)",
    )
    parser.add_argument(
        "--rate", metavar="HZ", type=positive, help="pictures a second (default 4; 1 for lines)"
    )
    parser.add_argument(
        "--window", metavar="S", type=positive, default=60.0, help="of the charts (default 60)"
    )
    parser.add_argument("--duration", metavar="S", type=positive, help="end after S seconds")
    parser.add_argument(
        "--once",
        action="store_true",
        help="print one picture as soon as all is known, after 5 s (or --duration) at the latest",
    )
    parser.add_argument("--json", action="store_true", help="print the figures as lines of JSON")


def run(args: argparse.Namespace) -> int:
    """Run the subcommand."""
    return watch(
        args.model,
        args.observer,
        rate=args.rate,
        window=args.window,
        duration=args.duration,
        once=args.once,
        json=args.json,
    )


def watch(
    model: str | None = None,
    observers: Sequence[str] | None = None,
    *,
    rate: float | None = None,
    window: float = 60.0,
    duration: float | None = None,
    once: bool = False,
    json: bool = False,
) -> int:
    """Watch until q, Ctrl-C, SIGTERM or the end of ``duration``.

    Args:
        model: a model file or a sample's name; None for what the plant publishes.
        observers: names of observer nodes; None for all that appear.
        rate: pictures a second; None for 4, or 1 where there is no terminal.
        window: what charts cover, s.
        duration: how long, s; None for no end.
        once: whether to print one picture and end.
        json: whether to print JSON instead of pictures.

    Returns:
        0; 1 when nobody was heard and ``once`` was asked for.

    Raises:
        UsageError, ModelError: ROS is not here, or an argument cannot be used.
    """
    from rich.console import Console

    from impact_observer.model import read_model
    from impact_observer.ros.session import require_ros

    require_ros()
    from impact_observer.ros.topic_listener import Listening

    system = None if model is None else read_model(model).system
    listening = Listening(observers, system, seconds=window)
    console = Console(highlight=False, markup=False)
    if once:
        return _once(listening, console, duration or _ONCE, json=json)
    if console.is_terminal and not json:
        _live(listening, console, rate or _RATE, duration)
    else:
        _lines(listening, rate or _LINES, duration, json=json)
    return 0


def _live(listening: "Listening", console: "Console", rate: float, duration: float | None) -> None:
    """Pictures that replace each other; the terminal is as before afterwards."""
    from rich.live import Live

    from impact_observer.cli.keyboard import Keyboard
    from impact_observer.cli.watch_screen import line, screen
    from impact_observer.ros import watch_session

    frozen: list[Glance] = []
    last: list[Glance] = []
    with ExitStack() as stack:
        keyboard = stack.enter_context(Keyboard())
        live = stack.enter_context(Live(console=console, screen=True, auto_refresh=False))

        def show(glance: "Glance") -> None:
            last[:] = [glance]
            shown = frozen[0] if frozen else glance
            look = _look(console, keys=keyboard.there, frozen=bool(frozen))
            live.update(screen(shown, look), refresh=True)

        def keep_on() -> bool:
            for key in keyboard.pressed():
                if key in {"q", "Q"}:
                    return False
                if key == " ":
                    frozen[:] = [] if frozen else last
                    show(last[0])
            return True

        watch_session.watch(listening, show, rate=rate, keep_on=keep_on, duration=duration)
    console.print(line(last[0]), soft_wrap=True)


def _lines(listening: "Listening", rate: float, duration: float | None, *, json: bool) -> None:
    """A line a picture."""
    from impact_observer.ros import watch_session

    write = _written(json=json)
    watch_session.watch(
        listening,
        lambda glance: print(write(glance), flush=True),
        rate=rate,
        keep_on=lambda: True,
        duration=duration,
    )


def _once(listening: "Listening", console: "Console", patience: float, *, json: bool) -> int:
    """One picture, as soon as every observer that is there has told what it knows."""
    from impact_observer.cli.watch_screen import screen
    from impact_observer.ros import watch_session

    seen: list[Glance] = []

    def keep_on() -> bool:
        observers = seen[0].observers if seen else ()
        return not observers or not all(each.lines and _has_rate(each) for each in observers)

    def _has_rate(each: "ObserverGlance") -> bool:
        return any(flow.rate is not None for flow in each.flows)

    def show(glance: "Glance") -> None:
        seen[:] = [glance]

    watch_session.watch(listening, show, rate=_RATE, keep_on=keep_on, duration=patience)
    if json:
        print(_written(json=True)(seen[0]))
    else:
        console.print(screen(seen[0], _look(console, endless=True)))
    return int(seen[0].is_empty)


def _look(
    console: "Console", *, keys: bool = False, frozen: bool = False, endless: bool = False
) -> "ScreenStyle":
    """The room that there is now, and the characters that can be printed."""
    from impact_observer.cli.blocks import BLOCKS, PLAIN
    from impact_observer.cli.watch_screen import ScreenStyle

    levels = PLAIN if console.options.ascii_only else BLOCKS
    height = None if endless else console.size.height
    return ScreenStyle(console.size.width, height, keys=keys, frozen=frozen, levels=levels)


def _written(*, json: bool) -> "Callable[[Glance], str]":
    """How a glance becomes a line."""
    from dataclasses import asdict
    from json import dumps

    from impact_observer.cli.watch_screen import line

    return (lambda glance: dumps(asdict(glance))) if json else line
