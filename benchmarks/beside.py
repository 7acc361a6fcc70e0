# SPDX-License-Identifier: Apache-2.0
"""Two checkouts side by side in one run: ``python -m benchmarks.beside FOLDER NAME...``.

    python -m benchmarks.beside ../before plant event_geometric filter_drill --rounds 3

FOLDER is a checkout of another version whose kernel is built. The checkouts take turns. A ratio is
the figure of this checkout over the figure of the other one in the same round.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.report import shown

HERE = Path(__file__).resolve().parents[1]
Figures = dict[str, tuple[float, str]]
"""Value and unit of each metric, by ``benchmark, metric``."""


def measured(checkout: Path, name: str) -> Figures:
    """Returns the figures of one round of a benchmark in a checkout.

    Raises:
        CalledProcessError: the benchmark failed there.
    """
    with TemporaryDirectory() as folder:
        path = Path(folder) / "figures.json"
        command = [sys.executable, "-m", "benchmarks", name, "--rounds", "1", "--json", str(path)]
        environment = os.environ | {"PYTHONPATH": str(checkout), "OPENBLAS_NUM_THREADS": "1"}
        subprocess.run(
            command, cwd=checkout, env=environment, check=True, stdout=subprocess.DEVNULL
        )
        document = json.loads(path.read_text(encoding="utf-8"))
    return {
        f"{each['name']}, {metric}": (values[0], each["units"][metric])
        for each in document["benchmarks"]
        for metric, values in each["metrics"]["ours"].items()
    }


def main(args: Sequence[str] | None = None) -> int:
    """Let both checkouts take turns, and print the medians of both and of their ratios.

    Returns:
        0; 2 for wrong use.
    """
    parser = argparse.ArgumentParser(prog="python -m benchmarks.beside", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="the other checkout")
    parser.add_argument("names", nargs="+", metavar="NAME", help="benchmarks of both checkouts")
    parser.add_argument("--rounds", type=int, default=5, metavar="N", help="(default 5)")
    given = parser.parse_args(args)
    if not (given.folder / "benchmarks").is_dir() or given.rounds < 1:
        parser.error(f"{given.folder}: expected a checkout, and --rounds above 0")
    turns = [(name, k) for name in given.names for k in range(given.rounds)]
    rounds: dict[str, list[tuple[float, float, str]]] = {}
    for name, k in track(turns, "rounds", console=Console(stderr=True), transient=True):
        order = [HERE, given.folder.resolve()][:: 1 if k % 2 else -1]
        figures = {checkout: measured(checkout, name) for checkout in order}
        for metric, (value, unit) in figures[HERE].items():
            other, _ = figures[given.folder.resolve()][metric]
            rounds.setdefault(metric, []).append((value, other, unit))
    table = Table("figure", "here", "there", "ratio", "of the rounds")
    for metric, values in rounds.items():
        ratios = [ours / theirs for ours, theirs, _ in values]
        here = statistics.median(value for value, _, _ in values)
        there = statistics.median(value for _, value, _ in values)
        unit = values[0][2]
        spread = f"{min(ratios):.3g} to {max(ratios):.3g}"
        median = f"{statistics.median(ratios):.3g}"
        table.add_row(metric, shown(here, unit), shown(there, unit), median, spread)
    Console(width=max(Console().width, 100)).print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
