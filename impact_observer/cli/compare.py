# SPDX-License-Identifier: Apache-2.0
"""Compare the estimates in bags with the truth: V(t), errors, settling times, a picture, a report.

With --laws, other observers are run on the bags' own impacts and compared as well. The two sides
of an impact are never mixed: samples at which the truth has jumped and the estimate has not, or
the other way round, are counted separately.
"""

import argparse
import json as json_module
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from impact_observer.cli.arguments import (
    add_model,
    add_namespace,
    add_observer_arguments,
    add_observers,
    not_negative,
    observer_options,
    positive,
)
from impact_observer.compare.comparison import SETTLED
from impact_observer.errors import UsageError
from impact_observer.plain_text import say

if TYPE_CHECKING:
    from impact_observer.compare.bag_comparison import BagComparison
    from impact_observer.options import Options

_MOST_LINES = 5
"""Contacts with a line of their own that are not the model's."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    parser.add_argument("bags", metavar="BAG", nargs="+", type=Path, help="bags with truth")
    parser.add_argument(
        "--laws",
        metavar="LAW,...",
        help="run observers with these laws on each bag, or with all that are installed",
    )
    add_observer_arguments(parser)
    add_model(parser, "a model file or a sample (default: the one in each bag)")
    add_namespace(parser)
    add_observers(
        parser,
        "compare only these, of the bag: names of observers, or topics of JointState or"
        " ObserverState (default: all observers)",
    )
    parser.add_argument(
        "--truth", metavar="TOPIC", help="of the true states (default: the plant's joint states)"
    )
    parser.add_argument(
        "--plot", metavar="FILE", type=Path, help="write V over time to a PNG, SVG or PDF"
    )
    parser.add_argument(
        "--report",
        metavar="FILE.html",
        type=Path,
        help="write metrics and pictures to one page that needs no network",
    )
    parser.add_argument(
        "--csv", metavar="FILE", type=Path, help="write the metrics, a line an estimate"
    )
    parser.add_argument(
        "--settled",
        metavar="RATIO",
        type=positive,
        default=SETTLED,
        help=f"V/V0 below which an estimate has settled (default {SETTLED:g})",
    )
    parser.add_argument(
        "--from",
        metavar="S",
        dest="since",
        type=not_negative,
        help="leave out what is earlier than S seconds after the epoch, such as a wrong start"
        " (default: all samples count)",
    )
    parser.add_argument("--json", action="store_true", help="print the metrics as JSON")


def run(args: argparse.Namespace) -> int:
    """Run the subcommand."""
    from impact_observer.observer import options_of_laws

    laws = () if args.laws is None else laws_in(args.laws)
    options = options_of_laws(observer_options(args, ""), laws)
    if not options and observer_options(args, "") != observer_options(argparse.Namespace(), ""):
        raise UsageError("laws: none named, but how to run observers; name some with --laws")
    return compare(
        args.bags,
        model=args.model,
        observers=options,
        truth=args.truth,
        estimates=args.observers,
        settled=args.settled,
        since=args.since,
        namespace=args.namespace,
        plot=args.plot,
        report=args.report,
        csv=args.csv,
        json=args.json,
    )


def laws_in(text: str) -> tuple[str, ...]:
    """Read ``LAW,LAW,...`` or ``all``: names of installed laws, each once.

    Raises:
        UsageError: no law is named, or one that is not installed.
    """
    from impact_observer.observer import law_named, law_names

    if not text:
        raise UsageError("laws: none named; expected LAW,LAW,... or all")
    names = law_names() if text == "all" else [name.strip() for name in text.split(",")]
    for name in names:
        law_named(name)
    return tuple(dict.fromkeys(names))


def compare(
    bags: Sequence[Path],
    *,
    model: str | None = None,
    observers: "Sequence[Options]" = (),
    truth: str | None = None,
    estimates: Sequence[str] | None = None,
    settled: float = SETTLED,
    since: float | None = None,
    namespace: str = "",
    plot: Path | None = None,
    report: Path | None = None,
    csv: Path | None = None,
    json: bool = False,
) -> int:
    """Compare bags, print the metrics, and write the files that are asked for.

    The arguments are the options. ``observers`` are run on each bag, one a law, without their
    ensemble: no estimate depends on it. Files that exist are replaced.

    Returns:
        0.

    Raises:
        UsageError, ModelError: the arguments cannot be used.
        BagError: a bag cannot be read, or has nothing to compare.
        ImpactLawError, DynamicsError: an observer cannot follow the events of a bag.
    """
    from impact_observer.compare.bag_comparison import labelled_by_law
    from impact_observer.compare.error_pictures import distance_picture
    from impact_observer.compare.error_tables import print_tables, write_csv
    from impact_observer.compare.metrics import metrics_of
    from impact_observer.compare.report import write_report
    from impact_observer.draw.output import check_output
    from impact_observer.draw.pictures import save

    if plot is not None:
        check_output(plot)
    if report is not None:
        check_output(report, (".html", ".htm"))
    if csv is not None:
        check_output(csv, (".csv",))
    how = {"truth": truth, "estimates": estimates, "settled": settled, "since": since}
    results = [(bag, _compare_one(bag, namespace, model, observers, how)) for bag in bags]
    labelled = labelled_by_law(results)
    _warn_of_unknown_contacts(results, sys.stderr if json else sys.stdout)
    if json:
        say(json_module.dumps({k: metrics_of(v) for k, v in labelled.items()}, indent=2))
    else:
        print_tables(labelled)
    if csv is not None:
        write_csv(labelled, csv)
    if plot is not None:
        save(distance_picture(labelled, results), plot)
    if report is not None:
        write_report(report, labelled, results)
    for what, path in (("metrics", csv), ("picture", plot), ("report", report)):
        if path is not None and not json:
            say(f"{what}: {path}")
    return 0


def _warn_of_unknown_contacts(
    results: "Sequence[tuple[Path, BagComparison]]", lines: TextIO
) -> None:
    """Print a line for each contact that has impacts and is none of the model's."""
    from impact_observer.draw.reports import counted, listed

    for bag, result in results:
        own = result.system.contact_names
        for name in [each for each in result.impacts if each not in own][:_MOST_LINES]:
            found = f"{bag}: {counted(result.impacts[name].size, 'impact')} of {name}, a contact"
            found += f" that the model {result.system.name} does not have"
            say(f"warning: {found}; expected one of {listed(own, joint=' or ')}", file=lines)


def _compare_one(
    bag: Path,
    namespace: str,
    model: str | None,
    observers: "Sequence[Options]",
    how: dict[str, Any],
) -> "BagComparison":
    """Compare one bag, with a progress bar on a terminal."""
    from impact_observer.cli.progress import Progress
    from impact_observer.compare.bag_comparison import compare_bag
    from impact_observer.io.reader import BagReader
    from impact_observer.io.recordings import model_of
    from impact_observer.observer import make_observer

    with BagReader(bag, namespace) as reader, Progress() as progress:
        progress.show(f"{bag}: reading")
        read = model_of(reader, model)
        alone = [replace(each, ensemble=1) for each in observers]
        made = [make_observer(read.system, each, read.elements) for each in alone]

        def show(what: str, done: int, total: int) -> None:
            progress.step(f"{bag}: {what}", done, total)

        return compare_bag(reader, read.system, made, progress=show, **how)
