# SPDX-License-Identifier: Apache-2.0
"""Record topics of running nodes into a bag, until Ctrl-C."""

import argparse
import math

from impact_observer.cli.arguments import add_shared, positive
from impact_observer.cli.progress import Progress
from impact_observer.draw.reports import counted


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    add_shared(parser, "output", "topics")
    stop = "stop by itself after S seconds of wall time"
    parser.add_argument("--duration", metavar="S", type=positive, help=stop)


def run(args: argparse.Namespace) -> int:
    """Record a bag and print what is in it."""
    from impact_observer.ros.session import require_ros

    require_ros()
    from impact_observer.ros.recorder import record

    with Progress() as progress:

        def show(count: int, passed: float) -> None:
            if args.duration is None:
                progress.show(f"{count} messages in {passed:.0f} s; Ctrl-C ends")
            else:
                progress.step("recording", passed, args.duration)

        counts = record(
            args.output,
            args.topics,
            duration=args.duration or math.inf,
            on_topic=lambda topic, type_name: progress.line(f"recording {topic} [{type_name}]"),
            on_progress=show,
        )
        for topic, count in counts.items():
            why = {None: ": never appeared", 0: ": no messages"}.get(count, "")
            progress.line(f"{count or 0:>9} {topic}{why}")
        total = counted(sum(filter(None, counts.values())), "message")
        progress.line(
            f"{total} in {args.output}; impact-observer check {args.output} says whether an"
            " observer can use it"
        )
    return 0
