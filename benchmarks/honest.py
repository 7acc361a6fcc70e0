# SPDX-License-Identifier: Apache-2.0
"""Is the default observer honest where something is not as declared: ``./dev bench honest``.

    ./dev bench honest --part tuned               # the rows for tuning
    ./dev bench honest --rows 'press*' --runs 3

``benchmarks/honest_rows.py`` has the plants and sensors. ``minimum-variance`` and ``geometric``
have their defaults, and what the row declares, and start at zero. Counted are samples after a
quarter of a run, farther than 5 ms from an impact. A row of the table, of all its runs:

- visible: runs in which a likelihood-ratio test that knows the misfit detects it; where they are
  less than half, the row is not judged;
- z: the largest |error| over its deviation, median of samples, then of runs;
- within: share of samples of the worst component within 3 deviations;
- wrong: share of samples with `synchronized` and an error above 10 deviations or above 2 % of the
  motion (its root mean square energy);
- error: root mean square over that of the motion; geo: over that of ``geometric``;
- score: mean 95 % interval score over that of ``geometric`` given its own rms, worst component;
- sync: share of samples that are `synchronized`;
- warning: runs with one, and seconds from the misfit to it, median;
- short: the goals that are missed.
"""

import argparse
import json
import statistics
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from fnmatch import fnmatch

import numpy as np
from joblib import Parallel, delayed
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.harness import new_file
from benchmarks.honest_rows import ROWS, Row
from benchmarks.honest_runs import Job, Outcome, outcome

WITHIN, WRONG, RATIO, SCORE = 0.9, 0.05, 1.3, 2.0
"""Goals of every row whose misfit is visible."""
SMALL = 1e-5
"""Error over the motion that meets the goal of errors."""
PARTS = {"tuned": False, "held-out": True}
HEADINGS = (
    "misfit",
    "rig",
    "held out",
    "visible",
    "z",
    "within",
    "wrong",
    "error",
    "geo",
    "score",
    "sync",
    "warning",
    "short",
)
EXACT_HEADINGS = ("exact", "rig", "held out", "NEES/2n", "deviation over the motion")


@dataclass(frozen=True, slots=True)
class Summary:
    """All runs of a row; the numbers are those of the table.

    Attributes:
        misfit: its name.
        rig: name of the model.
        held_out: whether the row is held out from tuning.
        runs: how many.
        visible: in how many the misfit is.
        z: in deviations.
        within: share.
        wrong: share.
        error: over the motion.
        ratio: of the error to that of geometric.
        score: over that of geometric.
        synchronized: share.
        warnings: runs with a warning.
        warned: their median, s; None without one.
        short: names of the goals that are missed.
        nees: mean over 2n; only of exact rows.
        deviation: median over the motion.
    """

    misfit: str
    rig: str
    held_out: bool
    runs: int
    visible: int
    z: float
    within: float
    wrong: float
    error: float
    ratio: float
    score: float
    synchronized: float
    warnings: int
    warned: float | None
    short: tuple[str, ...]
    nees: float
    deviation: float

    @property
    def cells(self) -> tuple[str, ...]:
        """Of the table, as ``HEADINGS``."""
        when = "" if self.warned is None else f", {self.warned:.0f} s"
        return (
            self.misfit,
            self.rig,
            "yes" if self.held_out else "",
            f"{self.visible}/{self.runs}",
            f"{self.z:.2g}" if self.z < 1000 else f"{self.z:.0e}",
            f"{self.within:.0%}",
            f"{self.wrong:.0%}",
            f"{self.error:.1e}",
            f"{self.ratio:.2g}",
            f"{self.score:.2g}",
            f"{self.synchronized:.0%}",
            f"{self.warnings}{when}",
            ", ".join(self.short),
        )

    @property
    def exact_cells(self) -> tuple[str, ...]:
        """Of the table of exact plants, as ``EXACT_HEADINGS``."""
        return (*self.cells[:3], f"{self.nees:.2g}", f"{self.deviation:.1e}")


def summary(row: Row, runs: Sequence[Outcome]) -> Summary:
    """The ``runs`` of a row together."""
    error, theirs = (
        float(np.sqrt(np.mean(np.square(each))))
        for each in ([o.error for o in runs], [o.geometric for o in runs])
    )
    scores = np.sum([o.score for o in runs], 0) / np.sum([o.geometric_score for o in runs], 0)
    within, score = float(np.min(np.mean([o.within for o in runs], 0))), float(np.max(scores))
    wrong, flagged = (
        statistics.fmean(each)
        for each in ([o.wrong for o in runs], [o.synchronized for o in runs])
    )
    warned = [o.warned for o in runs if o.warned is not None]
    visible = sum(o.visible for o in runs)
    met = {
        "within": within >= WITHIN,
        "wrong": wrong <= WRONG,
        "error": error <= SMALL or (error <= min(RATIO * theirs, 1.0)),
        "score": error <= SMALL or score <= SCORE,
    }
    judged = row.misfit.exact or 2 * visible >= len(runs)
    short = [name for name, is_met in met.items() if judged and not is_met]
    if flagged < row.misfit.synchronized:
        short.append("sync")
    return Summary(
        row.misfit.name,
        row.rig,
        row.held_out,
        len(runs),
        visible,
        statistics.median(o.z for o in runs),
        within,
        wrong,
        error,
        error / theirs,
        score,
        flagged,
        len(warned),
        statistics.median(warned) if warned else None,
        tuple(short),
        statistics.fmean(o.nees for o in runs),
        statistics.median(o.deviation for o in runs),
    )


def verdict(found: Sequence[Summary]) -> str:
    """How many rows meet all goals, in a line."""
    parts = []
    for part, held_out in PARTS.items():
        rows = [each for each in found if each.held_out is held_out]
        met = sum(not each.short for each in rows)
        parts.append(f"{met} of {len(rows)} rows {part.replace('-', ' ')}")
    return f"All goals are met by {parts[0]} and {parts[1]}."


def table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    """For the terminal."""
    made = Table(*headings, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    for column in made.columns:
        column.no_wrap = True
    for row in rows:
        made.add_row(*row)
    return made


def markdown(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """The same for a page."""
    lines = [headings, ["---"] * len(headings), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def tables(found: Sequence[Summary]) -> Iterator[tuple[Sequence[str], list[tuple[str, ...]]]]:
    """Headings and cells of both tables; the second is of exact plants."""
    yield HEADINGS, [each.cells for each in found]
    if exact := [each.exact_cells for each in found if each.nees == each.nees]:
        yield EXACT_HEADINGS, exact


def arguments(args: Sequence[str] | None) -> argparse.Namespace:
    """The arguments, checked; ``rows`` are places in ``ROWS``."""
    parser = argparse.ArgumentParser(prog="./dev bench honest", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    text = "names or patterns of rows: 'press*', 'exact, two_mass'"
    parser.add_argument("--rows", nargs="+", default=["*"], metavar="NAME", help=text)
    parser.add_argument("--runs", type=int, default=10, metavar="N", help="a row (default 10)")
    parser.add_argument("--part", choices=tuple(PARTS), help="(default: both)")
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="(default 2)")
    parser.add_argument("--json", type=new_file, metavar="FILE", help="write every run to FILE")
    parser.add_argument("--page", type=new_file, metavar="FILE", help="write tables as Markdown")
    given = parser.parse_args(args)
    if min(given.runs, given.workers) < 1:
        parser.error("arguments --runs, --workers: expected numbers above 0")
    wanted = {PARTS[given.part]} if given.part else {False, True}
    patterns, given.rows = given.rows, []
    for k, row in enumerate(ROWS):
        named = any(fnmatch(row.name, each) or row.misfit.name == each for each in patterns)
        if named and row.held_out in wanted:
            given.rows.append(k)
    if not given.rows:
        names = "; ".join(dict.fromkeys(row.misfit.name for row in ROWS))
        unknown = " or ".join(patterns)
        parser.error(f"argument --rows: none is named {unknown}; there are {names}")
    return given


def main(args: Sequence[str] | None = None) -> int:
    """Run the rows and print the table.

    Returns:
        0; 2 for wrong use.
    """
    given = arguments(args)
    jobs = [Job(k, seed) for k in given.rows for seed in range(given.runs)]
    console = Console(width=max(Console().width, 130))
    made = Parallel(given.workers, return_as="generator")(delayed(outcome)(job) for job in jobs)
    progress = track(made, "runs", len(jobs), console=Console(stderr=True), transient=True)
    runs: list[Outcome] = list(progress)
    found = [
        summary(ROWS[k], runs[i * given.runs : (i + 1) * given.runs])
        for i, k in enumerate(given.rows)
    ]
    for headings, rows in tables(found):
        console.print(table(headings, rows))
    console.print(verdict(found), highlight=False)
    if given.json:
        document = {"rows": list(map(asdict, found)), "runs": [each._asdict() for each in runs]}
        given.json.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
    if given.page:
        text = "\n\n".join([*(markdown(*each) for each in tables(found)), verdict(found)])
        given.page.write_text(text + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
