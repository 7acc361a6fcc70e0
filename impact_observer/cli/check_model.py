# SPDX-License-Identifier: Apache-2.0
"""Say what a model means for an observer: modes, contacts, and whether an impact can raise V."""

import argparse
import json as json_module
from pathlib import Path

from impact_observer.plain_text import say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    parser.add_argument("model", metavar="FILE", help="a model file, or a sample: two_mass, ...")
    parser.add_argument("--json", action="store_true", help="print the results as JSON")


def run(args: argparse.Namespace) -> int:
    """Run the subcommand."""
    return check(args.model, json=args.json)


def check(model: str | Path, *, json: bool = False) -> int:
    """Check a model and print the result.

    Args:
        model: a model file or a sample's name.
        json: print JSON instead of tables and words.

    Returns:
        0, also where there are warnings: the model is valid.

    Raises:
        UsageError, ModelError: the model cannot be read, or is not valid.
    """
    from impact_observer.check.model_check import check_model
    from impact_observer.check.model_report import for_json, print_check
    from impact_observer.check.robot_report import check_robot, print_robot, robot_json
    from impact_observer.model import read_model

    read = read_model(model)
    if read.misfit and not json:
        say(f"warning: {read.misfit}")
    if read.robot is not None:
        robot = check_robot(read)
        if json:
            say(json_module.dumps(robot_json(robot), indent=2))
        else:
            print_robot(robot)
        return 0
    checked = check_model(read)
    if json:
        say(json_module.dumps(for_json(checked), indent=2))
    else:
        print_check(checked)
    return 0
