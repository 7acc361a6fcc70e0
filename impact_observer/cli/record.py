"""Record topics of running nodes into a bag, until Ctrl-C."""

import argparse
from collections.abc import Sequence
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    parser.add_argument(
        "-o", "--output", metavar="BAG", type=Path, required=True, help="the folder to make"
    )
    parser.add_argument(
        "--topics",
        metavar="TOPIC",
        nargs="+",
        help="record these topics only (default: every topic that appears)",
    )
    parser.add_argument(
        "--use-sim-time",
        action="store_true",
        help="log times follow /clock",
    )
    parser.add_argument(
        "--duration", metavar="S", type=float, help="stop by itself after S seconds of wall time"
    )


def run(args: argparse.Namespace) -> int:
    """Run the subcommand."""
    return record(args.output, args.topics, use_sim_time=args.use_sim_time, duration=args.duration)


def record(
    output: Path,
    topics: Sequence[str] | None = None,
    *,
    use_sim_time: bool = False,
    duration: float | None = None,
) -> int:
    """Record a bag and say what is found.

    Args:
        output: the folder to make.
        topics: only these topics; None for every topic that appears.
        use_sim_time: whether log times follow ``/clock``.
        duration: how long, s of wall time; None for until Ctrl-C.

    Returns:
        0.

    Raises:
        UsageError: ROS is not here, something is at ``output`` already, or the duration is not
            positive.
        BagError: the bag cannot be written.
    """
    from impact_observer.cli.progress import Progress
    from impact_observer.nodes.session import require_ros

    require_ros()
    from impact_observer.nodes import recorder

    with Progress() as progress:
        counts = recorder.record(
            output,
            topics,
            use_sim_time=use_sim_time,
            duration=duration,
            on_topic=lambda topic, type_name: progress.line(f"recording {topic} [{type_name}]"),
            on_progress=lambda count: progress.show(f"{count} messages; Ctrl-C ends"),
        )
        for topic, count in counts.items():
            progress.line(f"{count:>9} {topic}")
        progress.line(f"{sum(counts.values()):>9} messages in {output}")
    return 0
