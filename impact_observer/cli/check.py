"""Say whether an observer can use a bag, and what is wrong with it.

Each finding is one line: what it is of, what was found, what was expected, what to do. With an
error no observer can use the bag, and the exit code is 1; with a warning one can, but something
is lost or an option is needed. Of a bag that is damaged, --salvage writes a new one of all that
can still be read.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from impact_observer.cli.arguments import add_model

if TYPE_CHECKING:
    from impact_observer.check.bag_check import Report
    from impact_observer.check.findings import Finding

_STYLES = {"error": "bold red", "warning": "yellow", "note": "dim"}
_WIDTH = max(map(len, _STYLES))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    parser.add_argument("bag", metavar="BAG", type=Path, help="a bag's folder, or a bare file")
    add_model(parser)
    parser.add_argument(
        "--salvage", action="store_true", help="write a new bag of what can be read of this one"
    )
    parser.add_argument(
        "-o", "--output", metavar="BAG", type=Path, help="of --salvage: the folder to make"
    )
    parser.add_argument("--json", action="store_true", help="print the findings as JSON")


def run(args: argparse.Namespace) -> int:
    """Run the subcommand."""
    from impact_observer.errors import UsageError

    if args.salvage != (args.output is not None):
        raise UsageError(f"{args.bag}: --salvage and -o belong together; expected both or neither")
    if args.salvage:
        return rescue(args.bag, args.output, json=args.json)
    return check(args.bag, model=args.model, json=args.json)


def check(bag: Path, *, model: str | None = None, json: bool = False) -> int:
    """Print what is wrong with a bag.

    Args:
        bag: the bag, however broken.
        model: a model file or a sample's name; None for the model that the bag carries.
        json: whether to print JSON instead of text.

    Returns:
        0 where an observer can use the bag, else 1.

    Raises:
        UsageError: there is no bag.
        ModelError: the model is not valid.
    """
    from impact_observer.check.bag_check import check_bag
    from impact_observer.cli.progress import Progress
    from impact_observer.model import read_model

    system = None if model is None else read_model(model).system
    with Progress(sys.stderr) as progress:
        report = check_bag(
            bag, system, progress=lambda done, total: progress.step("check", done, total)
        )
    if json:
        _print_json(report)
    else:
        _print(report)
    return 0 if report.usable else 1


def rescue(bag: Path, output: Path, *, json: bool = False) -> int:
    """Write a new bag of what can be read of a damaged one, and print what that is.

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
    from impact_observer.check.findings import times
    from impact_observer.check.salvage import Salvage, salvage
    from impact_observer.cli.progress import Progress
    from impact_observer.io import BagReader
    from impact_observer.stamps import text

    source = Salvage(bag)
    with Progress(sys.stderr) as progress:
        losses = salvage(
            source, output, progress=lambda done, all_: progress.step("salvage", done, all_)
        )
    with BagReader(output) as reader:
        counts = {topic: info.count for topic, info in reader.topics.items()}
    if json:
        from json import dumps

        figures = {"path": str(bag), "output": str(output), "topics": counts, "losses": losses}
        print(dumps(figures, indent=2))
        return 0
    for loss in losses:
        print(f"lost: {loss}")
    for topic, count in counts.items():
        print(f"{topic}: {times(count, 'message')}, up to {text(source.last[topic])} s")
    print(
        f"{output}: {times(sum(counts.values()), 'message')}; now impact-observer check {output}"
    )
    return 0


def _print_json(report: "Report") -> None:
    from dataclasses import asdict
    from json import dumps

    figures = {
        "path": str(report.path),
        "usable": report.usable,
        "readable": report.readable,
        "topics": dict(sorted(report.counts.items())),
        "findings": [asdict(each) | {"line": each.line} for each in report.findings],
    }
    print(dumps(figures, indent=2))


def _print(report: "Report") -> None:
    """Print each finding as one line; on a terminal folded beside its severity."""
    if sys.stdout.isatty():
        _print_folded(report.findings)
    else:
        for each in report.findings:
            print(f"{each.severity:{_WIDTH}}  {each.line}")
    print(f"{report.path}: {_verdict(report)}")


def _print_folded(findings: "Sequence[Finding]") -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table.grid(padding=(0, 2))
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for each in findings:
        table.add_row(Text(each.severity, style=_STYLES[each.severity]), Text(each.line))
    Console(highlight=False).print(table)


def _verdict(report: "Report") -> str:
    """Whether the bag can be used, with how many findings of each severity."""
    from impact_observer.check.findings import SEVERITIES, times

    counts = {s: sum(f.severity == s for f in report.findings) for s in SEVERITIES}
    told = ", ".join(times(count, s) for s, count in counts.items() if count)
    usable = "an observer can use it" if report.usable else "no observer can use it"
    return f"{usable} ({told or 'nothing to remark'})"
