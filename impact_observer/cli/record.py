# SPDX-License-Identifier: Apache-2.0
"""Record topics of running nodes into a bag, until Ctrl-C."""

import argparse
from collections.abc import Iterator
from typing import TYPE_CHECKING

from impact_observer.cli.arguments import add_bag_output

if TYPE_CHECKING:
    from impact_observer.ros.recorder import RecordedTopics


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    add = parser.add_argument
    add_bag_output(parser)
    add(
        "--topics",
        metavar="TOPIC",
        nargs="+",
        help="record these topics only (default: every topic that appears)",
    )
    add("--use-sim-time", action="store_true", help="log times follow /clock")
    add("--duration", metavar="S", type=float, help="stop by itself after S seconds of wall time")
    add(
        "--compression",
        choices=("none", "zstd"),
        default="none",
        help="of what is written (default: none)",
    )


def run(args: argparse.Namespace) -> int:
    """Record a bag and print what is in it."""
    from impact_observer.cli.progress import Progress
    from impact_observer.ros.session import require_ros

    require_ros()
    from impact_observer.ros import recorder

    with Progress() as progress:

        def show(count: int, passed: float) -> None:
            if args.duration is None:
                progress.show(f"{count} messages in {passed:.0f} s; Ctrl-C ends")
            else:
                progress.step("recording", passed, args.duration)

        recorded = recorder.record(
            args.output,
            args.topics,
            use_sim_time=args.use_sim_time,
            duration=args.duration,
            compressed=args.compression != "none",
            flush=args.flush,
            on_topic=lambda topic, type_name: progress.line(f"recording {topic} [{type_name}]"),
            on_progress=show,
        )
        for line in _counts(recorded):
            progress.line(line)
        count = sum(recorded.counts.values())
        progress.line(
            f"{count:>9} {'message' if count == 1 else 'messages'} in {args.output};"
            f" impact-observer check {args.output} says whether an observer can use it"
        )
    return 0


def _counts(recorded: "RecordedTopics") -> Iterator[str]:
    """Lines with the count of each topic."""
    for topic, count in recorded.counts.items():
        yield f"{count:>9} {topic}{'' if count else ': no messages'}"
    for topic in recorded.missing:
        yield f"{0:>9} {topic}: never appeared"
