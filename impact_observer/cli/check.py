# SPDX-License-Identifier: Apache-2.0
"""Say what a bag holds, whether an observer can use the bag, and what is wrong with it.

First come the model, impacts, observers and topics of a bag that can be read. Each finding is one
line: the thing, what was found, what was expected, what to do. With an error no observer can use
the bag, and the exit code is 1; with a warning one can, but something is lost or an option is
needed. --salvage writes a new bag of all that can be read of a damaged one.
"""

import argparse
import json as json_module
from dataclasses import asdict
from pathlib import Path

from impact_observer.cli.arguments import add_model
from impact_observer.plain_text import say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    parser.add_argument("bag", metavar="BAG", type=Path, help="a bag's folder, or a bare file")
    add_model(parser)
    parser.add_argument(
        "--salvage", action="store_true", help="write a new bag of what can be read of this one"
    )
    parser.add_argument(
        "-o", "--output", metavar="BAG", type=Path, help="with --salvage: the folder to make"
    )
    parser.add_argument("--json", action="store_true", help="print the findings as JSON")


def run(args: argparse.Namespace) -> int:
    """Run the subcommand."""
    from impact_observer.errors import UsageError

    if args.salvage != (args.output is not None):
        raise UsageError(f"{args.bag}: --salvage and -o belong together; expected both or neither")
    if args.salvage:
        return salvage_bag(args.bag, args.output, json=args.json)
    return check(args.bag, model=args.model, json=args.json)


def check(bag: Path, *, model: str | None = None, json: bool = False) -> int:
    """Print what a bag holds and what is wrong with it.

    Args:
        bag: the bag, damaged or not.
        model: a model file or a sample's name; None for the model in the bag.
        json: whether to print JSON instead of text.

    Returns:
        0 where an observer can use the bag, else 1.

    Raises:
        UsageError: there is no bag.
        ModelError: the model is not valid.
    """
    from impact_observer.check.bag_check import check_bag
    from impact_observer.check.bag_summary import print_summary, summarize
    from impact_observer.cli.progress import Progress
    from impact_observer.errors import BagError
    from impact_observer.model import read_model

    system = None if model is None else read_model(model).system
    with Progress() as progress:
        progress.show(f"reading {bag}")
        try:
            summary = summarize(bag)
        except BagError:
            summary = None  # the findings say why
        report = check_bag(
            bag, system, progress=lambda done, total: progress.step("check", done, total)
        )
    if json:
        content = None if summary is None else asdict(summary)
        say(json_module.dumps({**report.for_json(), "content": content}, indent=2, default=str))
    else:
        if summary is not None:
            print_summary(summary)
            say("")
        report.print()
    return 0 if report.usable else 1


def salvage_bag(bag: Path, output: Path, *, json: bool = False) -> int:
    """Write a new bag of what can be read of a damaged one, and print what it contains.

    Args:
        bag: the damaged bag.
        output: the bag to make.
        json: whether to print JSON instead of text.

    Returns:
        0.

    Raises:
        UsageError: there is no bag, or something is at ``output`` already.
        BagError: nothing can be read, or the new bag cannot be written.
    """
    from impact_observer.check.salvage import Salvage, salvage
    from impact_observer.cli.progress import Progress
    from impact_observer.draw.reports import counted
    from impact_observer.io import BagReader
    from impact_observer.stamps import text

    source = Salvage(bag)
    with Progress() as progress:
        losses = salvage(
            source, output, progress=lambda done, total: progress.step("salvage", done, total)
        )
    with BagReader(output) as reader:
        counts = {topic: info.count for topic, info in reader.topics.items()}
    if json:
        result = {"path": str(bag), "output": str(output), "topics": counts, "losses": losses}
        say(json_module.dumps(result, indent=2))
        return 0
    for loss in losses:
        say(f"lost: {loss}")
    for topic, count in counts.items():
        say(f"{topic}: {counted(count, 'message')}, up to {text(source.last[topic])} s")
    total = counted(sum(counts.values()), "message")
    say(f"{output}: {total}; now impact-observer check {output}")
    return 0
