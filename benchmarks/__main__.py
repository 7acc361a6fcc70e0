# SPDX-License-Identifier: Apache-2.0
"""Benchmarks: ``./dev bench``.

    ./dev bench speed                     rows of a group: speed, accuracy, honesty or fits
    ./dev bench 'filter*' --rounds 3      rows by name or pattern
    ./dev bench --plants FOLDER           rows of honesty for recordings made elsewhere
    ./dev bench --list                    all rows
    ./dev bench beside FOLDER NAME...     this checkout and another one take turns
    ./dev bench walk                      which functions of the package an event calls
    ./dev bench reliability               plant, observer, detector, monitor, recorder under attack
    ./dev bench mutants                   which changed operators and constants the tests find

Medians of the rounds are printed. A ratio is the figure of this checkout over that of the other
one in the same round, so that a slow spell of the machine hits both. Times are processor time,
but those of ``topic``.
"""

import argparse
import json
import statistics
import sys
from collections.abc import Sequence
from fnmatch import fnmatch
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory

from rich import box
from rich.console import Console
from rich.table import Table

from benchmarks import accuracy, fits, honesty, speed
from benchmarks.checkout import HERE, Checkout, FailedError, Figure, Figures, Row

GROUPS = {
    "speed": speed.ROWS,
    "accuracy": accuracy.ROWS,
    "honesty": honesty.ROWS,
    "fits": fits.ROWS,
}
Rounds = dict[str, list[tuple[Figure, ...]]]
"""Of each figure a tuple a round: of this checkout, and of the other one."""


def chosen(names: Sequence[str]) -> list[Row]:
    """The rows with these names, of these groups, or that match these patterns."""
    return [
        row
        for group, rows in GROUPS.items()
        for row in rows
        if any(name == group or fnmatch(row.name, name) for name in names)
    ]


def measured(row: Row, checkouts: Sequence[Checkout], rounds: int) -> Rounds:
    """The figures of a row; the checkouts take turns.

    Raises:
        FailedError: a command failed.
    """
    found: Rounds = {}
    for k in range(rounds):
        figures: dict[Path, Figures] = {}
        for checkout in checkouts[:: 1 if k % 2 else -1]:
            with TemporaryDirectory(prefix="impact_observer_") as folder:
                figures[checkout.folder] = row.measure(checkout, Path(folder), k)
        here, *others = (figures[checkout.folder] for checkout in checkouts)
        for name, figure in here.items():
            if all(name in other for other in others):
                found.setdefault(name, []).append((figure, *(other[name] for other in others)))
    return found


def cells(rounds: Sequence[tuple[Figure, ...]]) -> list[str]:
    """Medians of each checkout, then of two the median of their ratios and its range."""
    unit = rounds[0][0].unit
    columns = zip(*((figure.value for figure in figures) for figures in rounds), strict=True)
    made = [str(Figure(statistics.median(column), unit)) for column in columns]
    if len(made) > 1:
        ratios = [a.value / b.value if b.value else float("nan") for a, b in rounds]
        made.append(f"{statistics.median(ratios):.3g}")
        made.append(f"{min(ratios):.3g} to {max(ratios):.3g}")
    return made


def arguments(words: Sequence[str]) -> argparse.Namespace:
    """The arguments, checked; ``checkouts`` are one or two."""
    beside = bool(words) and words[0] == "beside"
    parser = argparse.ArgumentParser(prog="./dev bench", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    if beside:
        parser.add_argument("folder", type=Path, metavar="FOLDER", help="the other checkout")
    parser.add_argument("names", nargs="*", metavar="NAME", help="(default: speed)")
    parser.add_argument("--rounds", type=int, default=3, metavar="N", help="(default 3)")
    parser.add_argument("--list", action="store_true", help="list the rows, and end")
    parser.add_argument("--plants", type=Path, metavar="FOLDER", help="rows of honesty for each")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every figure to FILE")
    given = parser.parse_args(words[beside:])
    given.rows = chosen(given.names or ["speed"] * (given.plants is None))
    given.rows += [] if given.plants is None else honesty.elsewhere_rows(given.plants)
    if not given.rows or given.rounds < 1:
        parser.error(f"{' '.join(given.names)}: no row found, or no round; --list lists the rows")
    try:
        given.checkouts = [Checkout(HERE), *([Checkout(given.folder)] if beside else [])]
    except FailedError as error:
        parser.error(str(error))
    return given


def main(words: Sequence[str]) -> int:
    """Measure rows and print a table.

    Returns:
        0; 1 where a command of a checkout failed; 2 for wrong use.
    """
    if words and words[0] in ("walk", "reliability", "mutants"):
        return int(import_module(f"benchmarks.{words[0]}").main(words[1:]))
    given = arguments(words)
    if given.list:
        for row in (row for rows in GROUPS.values() for row in rows):
            print(f"{row.name:40} {row.question}")
        return 0
    beside = ("there", "ratio", "of the rounds")[: 3 * (len(given.checkouts) > 1)]
    table = Table("row", "figure", "here", *beside, box=box.SIMPLE_HEAD)
    found: dict[str, dict[str, list[list[float]]]] = {}
    failed = False
    for row in given.rows:
        try:
            rounds = measured(row, given.checkouts, given.rounds)
        except FailedError as error:
            failed = True
            table.add_row(row.name, f"failed: {error}")
            continue
        for name, figures in rounds.items():
            table.add_row(row.name, name, *cells(figures))
            values = [[figure.value for figure in each] for each in figures]
            found.setdefault(row.name, {})[name] = values
        print(f"{row.name}: measured", file=sys.stderr)
    Console(width=max(Console().width, 110)).print(table)
    if given.json:
        given.json.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
