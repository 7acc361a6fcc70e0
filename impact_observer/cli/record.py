"""Record topics of running nodes into a bag, until Ctrl-C."""

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from impact_observer.ros.recorder import RecordedTopics


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    parser.add_argument(
        "-o", "--output", metavar="BAG", type=Path, required=True, help="the folder to create"
    )
    parser.add_argument(
        "--topics",
        metavar="TOPIC",
        nargs="+",
        help="record these topics only (default: every topic that appears)",
    )
    parser.add_argument(
        "--exclude",
        metavar="TOPIC",
        nargs="+",
        default=[],
        help="leave these out; quoted, a * stands for anything: '/camera/*'",
    )
    parser.add_argument(
        "--use-sim-time",
        action="store_true",
        help="log times follow /clock",
    )
    parser.add_argument(
        "--duration", metavar="S", type=float, help="stop by itself after S seconds of wall time"
    )
    parser.add_argument(
        "--compression",
        choices=("none", "zstd"),
        default="none",
        help="of what is written (default: none)",
    )


def run(args: argparse.Namespace) -> int:
    """Run the subcommand."""
    return record(
        args.output,
        args.topics,
        exclude=args.exclude,
        use_sim_time=args.use_sim_time,
        duration=args.duration,
        compressed=args.compression != "none",
    )


def record(
    output: Path,
    topics: Sequence[str] | None = None,
    *,
    exclude: Sequence[str] = (),
    use_sim_time: bool = False,
    duration: float | None = None,
    compressed: bool = False,
) -> int:
    """Record a bag and print what is found.

    Args:
        output: the folder to create.
        topics: only these topics; None for every topic that appears.
        exclude: none of these; ``*`` in a name stands for anything.
        use_sim_time: whether log times follow ``/clock``.
        duration: how long, s of wall time; None for until Ctrl-C.
        compressed: whether what is written is compressed.

    Returns:
        0.

    Raises:
        UsageError: ROS is not installed, ``output`` exists already, or the duration is not
            positive.
        BagError: the bag cannot be written.
    """
    from impact_observer.cli.progress import Progress
    from impact_observer.ros.session import require_ros

    require_ros()
    from impact_observer.ros import recorder

    with Progress() as progress:

        def show(count: int, passed: float) -> None:
            if duration is None:
                progress.show(f"{count} messages in {passed:.0f} s; Ctrl-C ends")
            else:
                progress.step("recording", passed, duration, "s")

        recorded = recorder.record(
            output,
            topics,
            exclude=exclude,
            use_sim_time=use_sim_time,
            duration=duration,
            compressed=compressed,
            on_topic=lambda topic, type_name: progress.line(f"recording {topic} [{type_name}]"),
            on_progress=show,
        )
        for line in _counts(recorded):
            progress.line(line)
        count = sum(recorded.counts.values())
        progress.line(f"{count:>9} {'message' if count == 1 else 'messages'} in {output}")
    return 0


def _counts(recorded: "RecordedTopics") -> Iterator[str]:
    """Lines with the count of each topic."""
    for topic, count in recorded.counts.items():
        yield f"{count:>9} {topic}{'' if count else ': no messages'}"
    for topic in recorded.missing:
        yield f"{0:>9} {topic}: never appeared"
