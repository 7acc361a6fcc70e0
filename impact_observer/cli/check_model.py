# SPDX-License-Identifier: Apache-2.0
"""Say what a model means for an observer: modes, contacts, and whether an impact can raise V.

With a bag also which part of the initial state its impacts determine, before anyone trusts an
estimate.
"""

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

from impact_observer.cli.arguments import add_observer_arguments, add_shared
from impact_observer.draw.reports import counted, print_facts
from impact_observer.errors import BagError, UsageError
from impact_observer.options import Options
from impact_observer.plain_text import say

if TYPE_CHECKING:
    from impact_observer.batch.determined import Determined
    from impact_observer.model import Model

_OF_BAGS = ("measurements", "initial_deviation")
"""Options that need a bag."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    add = parser.add_argument
    add_shared(parser, "rig")
    add("bag", metavar="BAG", nargs="?", type=Path, help="a bag with impacts of this model")
    add_shared(parser, "measurements", "json")
    add_observer_arguments(parser, ("initial_deviation",))


def run(args: argparse.Namespace) -> int:
    """Check a model, and ask what the impacts in a bag determine."""
    from impact_observer.batch.determined import determined_json, determined_lines
    from impact_observer.model import read_model

    if args.bag is None and (given := [name for name in _OF_BAGS if getattr(args, name)]):
        raise UsageError(f"{given[0]}: given without a BAG, whose impacts it is about")
    read = read_model(args.model)
    results = _checked(read, as_json=args.json)
    if args.bag is not None:
        found = _determined(read, args)
        results["impacts"] = determined_json(found)
        if not args.json:
            say("")
            print_facts((each.kind, each.text) for each in determined_lines(found))
    if args.json:
        say(json.dumps(results, indent=2))
    return 0


def _checked(read: "Model", *, as_json: bool) -> dict[str, object]:
    """The check of a model for ``--json``; otherwise it is printed."""
    from impact_observer.check.model_check import check_model
    from impact_observer.check.model_report import for_json, print_values
    from impact_observer.model import System
    from impact_observer.model.multibody import report_on

    if read.misfit and not as_json:
        say(f"warning: {read.misfit}")
    is_linear = isinstance(read.subject, System)
    values = for_json(check_model(read)) if is_linear else report_on(read)
    if not as_json:
        what = "joint" if "joints" in values else "coordinate"
        sizes = f"{counted(values['n'], what)}, {counted(values['m'], 'contact')}"
        print_values(values, sizes)
    return values


def _determined(read: "Model", args: argparse.Namespace) -> "Determined":
    """What the impacts in a bag say of the state at their start."""
    from impact_observer.batch.determined import determined
    from impact_observer.io.measured_samples import samples_in
    from impact_observer.io.reader import BagReader
    from impact_observer.io.recordings import events_in
    from impact_observer.model.measurement import read_measurements
    from impact_observer.observer.uncertainty import deviation_of

    system, declared = read.system, read_measurements(args.measurements)
    deviation = deviation_of(args.initial_deviation or Options.initial_deviation, system)
    with BagReader(args.bag) as reader:
        events, recorded = events_in(reader), samples_in(reader, declared)
        for problem in () if args.json else recorded.problems:
            say(f"warning: {problem}")
        try:
            return determined(
                system, events, deviation, measurements=declared, samples=recorded.samples
            )
        except BagError as error:
            raise type(error)(f"{args.bag}: {error}") from None
