# SPDX-License-Identifier: Apache-2.0
"""Compare the estimates in bags with the truth: V(t), errors, settling times, a picture.

With --laws, other observers are run on the bags' own impacts and compared as well. With --figure
a model is simulated instead, and observed with kinematic and geometric, or with the laws of
--laws, as in Figure 2 of Baumann and Leine (ENOC 2014). The two sides of an impact are never
mixed: samples at which the truth has jumped and the estimate has not, or the other way round, are
counted separately.
"""

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from impact_observer.cli.arguments import (
    PART,
    add_observer_arguments,
    add_shared,
    installed_laws,
    observer_options,
)
from impact_observer.cli.progress import Progress
from impact_observer.errors import UsageError
from impact_observer.output_files import PICTURES
from impact_observer.plain_text import printable, say

if TYPE_CHECKING:
    from impact_observer.compare.bag_comparison import BagComparison
    from impact_observer.options import Options

_MOST_LINES = 3
"""Most contacts that are warned of because the model does not have them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    parser.add_argument("bags", metavar="BAG", nargs="*", type=Path, help="bags with truth")
    parser.add_argument(
        "--figure",
        metavar="MODEL",
        help="simulate this model, a file or a sample, for --duration (default 30 s) instead",
    )
    parser.add_argument(
        "--laws",
        metavar="LAW,...",
        help="run observers with these laws on each bag, or with all that are installed",
    )
    add_observer_arguments(parser, ("initial_state",))
    add_shared(parser, "model", "plot", *PART, "json", plot="V over time: PNG, SVG or PDF")
    parser.set_defaults(outputs={"plot": PICTURES})


def run(args: argparse.Namespace) -> int:
    """Compare bags, print the metrics, and write the files that are asked for."""
    from impact_observer.compare.bag_comparison import labelled_by_law
    from impact_observer.compare.distance_picture import distance_picture
    from impact_observer.compare.error_tables import print_tables
    from impact_observer.compare.metrics import metrics_of
    from impact_observer.draw.pictures import save

    _check_source(args)
    options = _options(args)
    if args.figure is not None:
        results = [(Path(args.figure), _simulate(options, args))]
    else:
        results = [(bag, _compare_one(bag, options, args)) for bag in args.bags]
    labelled = labelled_by_law(results)
    for line in islice(_unknown_contacts(results), _MOST_LINES):
        say(f"warning: {line}", file=sys.stderr if args.json else sys.stdout)
    if args.json:
        say(json.dumps({law: metrics_of(each) for law, each in labelled.items()}, indent=2))
    else:
        print_tables(labelled)
    if args.plot is not None:
        save(distance_picture(labelled, results), args.plot)
        if not args.json:
            say(f"picture: {args.plot}")
    return 0


def _check_source(args: argparse.Namespace) -> None:
    """Raise unless bags or a model are named, and nothing of bags beside a model.

    Raises:
        UsageError: neither or both are named, or an option does not fit.
    """
    if args.figure is None:
        if not args.bags:
            raise UsageError("no bag named; expected BAG... or --figure MODEL")
        return
    of_bags = ("bags", "model", "start")
    if given := [name for name in of_bags if getattr(args, name)]:
        raise UsageError(f"--figure {args.figure}: simulates, and {given[0]} is of bags; omit one")


def _simulate(options: "Sequence[Options]", args: argparse.Namespace) -> "BagComparison":
    """Simulate a model, and observe the run with each of the ``options``."""
    from impact_observer.compare.simulated_comparison import compare_simulated
    from impact_observer.model import read_model

    model = read_model(args.figure)
    duration = 30.0 if args.duration is None else args.duration
    with Progress() as progress:
        return compare_simulated(
            model,
            options,
            duration,
            progress=progress.step,
        )


def _options(args: argparse.Namespace) -> "Sequence[Options]":
    """The options of each law that is run; none without ``--laws``."""
    from impact_observer.compare.simulated_comparison import INITIAL, LAWS
    from impact_observer.observer import options_of_laws

    given = observer_options(args, "")
    if args.figure is not None:
        laws = installed_laws(LAWS if args.laws is None else args.laws)
        start = INITIAL if args.initial_state is None else args.initial_state
        return options_of_laws(replace(given, initial_state=start, clock_error=0.0), laws)
    laws = () if args.laws is None else installed_laws(args.laws)
    if not laws and given != observer_options(argparse.Namespace(), ""):
        raise UsageError("laws: none named, but how to run observers; name some with --laws")
    return options_of_laws(given, laws)


def _unknown_contacts(results: "Sequence[tuple[Path, BagComparison]]") -> Iterator[str]:
    """Contacts with impacts that the model does not have."""
    for bag, result in results:
        for name in result.impacts:
            if name not in result.system.contact_names:
                yield f"{bag}: {name} has impacts, and {result.system.name} no such contact"


def _compare_one(
    bag: Path, options: "Sequence[Options]", args: argparse.Namespace
) -> "BagComparison":
    """Compare one bag, and run observers with these ``options`` on the bag."""
    from impact_observer.cli.observe import fitted_to
    from impact_observer.compare.bag_comparison import compare_bag
    from impact_observer.io.bag_part import read_part
    from impact_observer.io.reader import BagReader
    from impact_observer.io.recordings import model_of
    from impact_observer.model.multibody import multibody_of
    from impact_observer.observer import make_observer

    with BagReader(bag) as reader, Progress() as progress:
        progress.show(f"{bag}: reading")
        read = model_of(reader, args.model)
        truth = reader.truth_topic()
        tell = partial(say, file=sys.stderr if args.json else sys.stdout)
        read_part(reader, args.start, args.duration, [truth] if truth else [], tell=tell)
        if options and read.robot is not None:
            raise UsageError(
                f"--laws {args.laws}: {read.robot.name} in {bag} is a robot, whose observers need"
                " measurements; expected the bag that observe --measurements FILE makes"
            )
        # The ensemble is left out: no estimate depends on the ensemble.
        observers = [make_observer(read, replace(each, ensemble=1)) for each in options]
        result = compare_bag(
            reader,
            multibody_of(read),
            observers,
            progress=lambda what, done, total: progress.step(f"{bag}: {what}", done, total),
        )
    fitted = fitted_to(read, [each.last_event for each in observers])
    for line in (*read.doubts, *fitted) if observers else ():
        tell(f"warning: {printable(f'{bag}: {line}')}")
    return result
