# SPDX-License-Identifier: Apache-2.0
"""Watch a running plant and its observers in the terminal, until Ctrl-C.

The table shows estimates with their deviations, the last impacts with their verdicts, and where a
plant publishes the truth also the truth and V. Where the output is no terminal, the last table is
printed at the end.
"""

import argparse
import math
from typing import TYPE_CHECKING

from impact_observer.cli.arguments import add_shared, positive

if TYPE_CHECKING:
    from impact_observer.ros.watcher import View


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    add_shared(parser, "model", model="for V (default: the model that the plant publishes)")
    parser.add_argument("--duration", metavar="S", type=positive, help="end after S seconds")


def run(args: argparse.Namespace) -> int:
    """Watch; the exit code is 1 if no observer was there until the end of --duration."""
    from rich.console import Console
    from rich.live import Live

    from impact_observer.model import read_model
    from impact_observer.model.multibody import multibody_of
    from impact_observer.ros.session import require_ros

    require_ros()
    from impact_observer.ros.watcher import Listener, table, watch

    listener = Listener(None if args.model is None else multibody_of(read_model(args.model)))
    duration = math.inf if args.duration is None else args.duration
    with Live(console=Console(highlight=False), auto_refresh=False) as live:

        def show(view: "View") -> None:
            live.update(table(view), refresh=True)

        last = watch(listener, show, duration)
    return int(args.duration is not None and not last["observers"])
