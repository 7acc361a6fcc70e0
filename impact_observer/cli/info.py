# SPDX-License-Identifier: Apache-2.0
"""Say what a bag holds: topics, impacts, model, observers."""

import argparse
import json as json_module
from dataclasses import asdict
from pathlib import Path

from impact_observer.plain_text import say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    parser.add_argument("bag", metavar="BAG", type=Path, help="a bag's folder, or a bare file")
    parser.add_argument("--json", action="store_true", help="print the results as JSON")


def run(args: argparse.Namespace) -> int:
    """Run the subcommand."""
    return info(args.bag, json=args.json)


def info(bag: Path, *, json: bool = False) -> int:
    """Print what a bag holds.

    Args:
        bag: the bag.
        json: whether to print JSON instead of text.

    Returns:
        0.

    Raises:
        UsageError: there is no bag.
        BagError: the bag is damaged.
    """
    from impact_observer.check.bag_summary import print_summary, summarize

    summary = summarize(bag)
    if json:
        say(json_module.dumps(asdict(summary), indent=2, default=str))
    else:
        print_summary(summary)
    return 0
