# SPDX-License-Identifier: Apache-2.0
"""Watch a running plant and its observers in the terminal.

Estimates against the truth where a plant publishes it, V and the distance between replicas over
time, the verdicts on the last events, rates and latencies. Keys: space freezes, q ends. Where the
output is no terminal, one line a second is printed.
"""

import argparse
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING

from impact_observer.cli.arguments import add_model, add_observers, positive
from impact_observer.plain_text import say

if TYPE_CHECKING:
    from rich.console import Console

    from impact_observer.ros.watch.screen import ScreenStyle
    from impact_observer.ros.watch.snapshot import ObserverSnapshot, Snapshot
    from impact_observer.ros.watch.topic_listener import TopicListener

_RATE = 4.0
_LINES = 1.0
"""Lines a second where there is no terminal."""
_ONCE = 5.0
"""How long ``--once`` waits for the observers, s."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    add_model(parser, "for V where there is no monitor (default: the plant's model)")
    add_observers(parser, "show only these, by name (default: all that appear)")
    parser.add_argument(
        "--rate", metavar="HZ", type=positive, help="updates a second (default 4; 1 for lines)"
    )
    parser.add_argument(
        "--window",
        metavar="S",
        type=positive,
        default=60.0,
        help="time that the charts cover (default 60)",
    )
    parser.add_argument("--duration", metavar="S", type=positive, help="end after S seconds")
    parser.add_argument(
        "--once",
        action="store_true",
        help="print one screen as soon as it is complete, after 5 s (or --duration) at the latest",
    )
    parser.add_argument("--json", action="store_true", help="print the results as lines of JSON")


def run(args: argparse.Namespace) -> int:
    """Run the subcommand."""
    return watch(
        args.model,
        args.observers,
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
        rate: updates a second; None for 4, or 1 where there is no terminal.
        window: time that the charts cover, s.
        duration: how long, s; None for no end.
        once: whether to print one screen and end.
        json: whether to print JSON.

    Returns:
        0; 1 when ``once`` is set and no message arrived.

    Raises:
        UsageError, ModelError: ROS is not here, or an argument cannot be used.
    """
    from impact_observer.draw.text_tables import LiteralConsole
    from impact_observer.model import read_model
    from impact_observer.ros.session import require_ros

    require_ros()
    from impact_observer.ros.watch.topic_listener import TopicListener

    system = None if model is None else read_model(model).system
    listener = TopicListener(observers, system, seconds=window)
    console = LiteralConsole(highlight=False, markup=False)
    if once:
        return _once(listener, console, duration or _ONCE, json=json)
    if console.is_terminal and not json:
        _live(listener, console, rate or _RATE, duration)
    else:
        _lines(listener, rate or _LINES, duration, json=json)
    return 0


def _live(
    listener: "TopicListener", console: "Console", rate: float, duration: float | None
) -> None:
    """A screen that is updated; the terminal is restored afterwards."""
    from rich.live import Live

    from impact_observer.cli.keyboard import Keyboard
    from impact_observer.ros.watch import watch_session
    from impact_observer.ros.watch.screen import line, screen

    frozen: list[Snapshot] = []
    last: list[Snapshot] = []
    with ExitStack() as stack:
        keyboard = stack.enter_context(Keyboard())
        live = stack.enter_context(Live(console=console, screen=True, auto_refresh=False))

        def show(snapshot: "Snapshot") -> None:
            last[:] = [snapshot]
            shown = frozen[0] if frozen else snapshot
            style = _style(console, keys=keyboard.available, frozen=bool(frozen))
            live.update(screen(shown, style), refresh=True)

        def keep_on() -> bool:
            for key in keyboard.pressed():
                if key in {"q", "Q"}:
                    return False
                if key == " ":
                    frozen[:] = [] if frozen else last
                    show(last[0])
            return True

        watch_session.watch(listener, show, rate=rate, keep_on=keep_on, duration=duration)
    console.print(line(last[0]), soft_wrap=True)


def _lines(listener: "TopicListener", rate: float, duration: float | None, *, json: bool) -> None:
    """One line per update."""
    from impact_observer.ros.watch import watch_session

    write = _formatter(json=json)
    watch_session.watch(
        listener,
        lambda snapshot: say(write(snapshot)),
        rate=rate,
        keep_on=lambda: True,
        duration=duration,
    )


def _once(listener: "TopicListener", console: "Console", timeout: float, *, json: bool) -> int:
    """One screen, as soon as every observer has an estimate and a rate."""
    from impact_observer.ros.watch import watch_session
    from impact_observer.ros.watch.screen import screen

    seen: list[Snapshot] = []

    def keep_on() -> bool:
        observers = seen[0].observers if seen else ()
        return not observers or not all(each.lines and _has_rate(each) for each in observers)

    def _has_rate(each: "ObserverSnapshot") -> bool:
        return any(flow.rate is not None for flow in each.flows)

    def show(snapshot: "Snapshot") -> None:
        seen[:] = [snapshot]

    watch_session.watch(listener, show, rate=_RATE, keep_on=keep_on, duration=timeout)
    if json:
        say(_formatter(json=True)(seen[0]))
    else:
        console.print(screen(seen[0], _style(console, endless=True)))
    return int(seen[0].is_empty)


def _style(
    console: "Console", *, keys: bool = False, frozen: bool = False, endless: bool = False
) -> "ScreenStyle":
    """The terminal's present size, and the characters that it prints."""
    from impact_observer.ros.watch.charts import ASCII_BLOCKS, BLOCKS
    from impact_observer.ros.watch.screen import ScreenStyle

    levels = ASCII_BLOCKS if console.options.ascii_only else BLOCKS
    height = None if endless else console.size.height
    return ScreenStyle(console.size.width, height, keys=keys, frozen=frozen, levels=levels)


def _formatter(*, json: bool) -> "Callable[[Snapshot], str]":
    """A function from a snapshot to a line."""
    from dataclasses import asdict
    from json import dumps

    from impact_observer.ros.watch.screen import line

    return (lambda snapshot: dumps(asdict(snapshot))) if json else line
