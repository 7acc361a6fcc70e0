# SPDX-License-Identifier: Apache-2.0
"""Say what a bag holds, and what stops or spoils an observer that uses the bag.

First come the model, impacts, observers and topics. Each finding is one line: the thing, what was
found, what was expected, what to do. With an error no observer can use the bag, and the exit code
is 1; with a warning one can, but something is lost or an option is needed.
"""

import argparse
import json

from impact_observer.cli.arguments import add_shared
from impact_observer.cli.progress import Progress
from impact_observer.plain_text import say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    add_shared(parser, "bag", "model", "json")


def run(args: argparse.Namespace) -> int:
    """Print what a bag holds and what is wrong with it."""
    from impact_observer.check.bag_check import check_bag
    from impact_observer.model import read_model

    model = None if args.model is None else read_model(args.model)
    with Progress() as progress:
        report = check_bag(
            args.bag, model, progress=lambda done, total: progress.step("check", done, total)
        )
    if args.json:
        say(json.dumps(report.for_json(), indent=2, default=str))
    else:
        report.print()
    return 0 if report.usable else 1
