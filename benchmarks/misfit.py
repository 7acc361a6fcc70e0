# SPDX-License-Identifier: Apache-2.0
"""The laws on plants that are not the model: ``./dev bench misfit``.

``benchmarks/misfit_plants.py`` has the plants. ``geometric`` and ``minimum-variance`` have their
defaults, start at zero, and receive the impacts of an ideal sensor: the onsets, to 1 ns. A table
for each group of plants, a row for each run:

- z: |error| over standard deviation of minimum-variance, the median of samples and coordinates
  after 10 s;
- flag: share of samples at which ``synchronized`` was true and the error above 10 deviations,
  V > 100 E[V];
- geometric, min.-variance: the error, square root of the median V over the mean energy of the
  motion, after 10 s; and its ratio;
- warning: events until minimum-variance warns that the model does not explain the impacts.

Samples within 5 ms of a contact do not count. Below each table are the goals; exact plants have
none. Plants with fewer than an impact a second run up to 3.5 times longer.

Instead, ``--exact N`` counts false alarms on exact models (``benchmarks/misfit_alarms.py``).
"""

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from fnmatch import fnmatch
from typing import NamedTuple, get_args

import numpy as np
from joblib import Parallel, delayed
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks import misfit_alarms
from benchmarks.harness import new_file
from benchmarks.misfit_plants import Group, plants
from benchmarks.misfit_runs import ALLOWED, GEOMETRIC, Job, Outcome, outcome

SOON = 40
"""Events within which a warning is expected."""
NOTICEABLE = 0.01
"""Error of minimum-variance above which one is."""


class Goal(NamedTuple):
    """A goal of a group, what was found, and whether that meets it."""

    text: str
    found: str
    is_met: bool


def goals(outcomes: Sequence[Outcome]) -> list[Goal]:
    """The goals for wrong plants; none where there is no such plant."""
    wrong = [each for each in outcomes if each.kind != "exact"]
    if not wrong:
        return []
    z, ratio = np.array([each.z for each in wrong]), np.array([each.ratio for each in wrong])
    honest, near = np.sum((z >= 0.3) & (z <= 3)), np.sum(ratio <= 1.3)
    enough, runs = 0.9 * z.size, f"of {z.size}"
    flag, worst = np.mean([each.flag for each in wrong]), max(each.flag for each in wrong)
    due = [each for each in wrong if each.filtered > NOTICEABLE]
    soon = sum(each.warned is not None and each.warned <= SOON for each in due)
    return [
        Goal("median z in [0.3, 3] on nine of ten", f"{honest} {runs}", bool(honest >= enough)),
        Goal("never above 5", f"largest {np.max(z):.1f}", bool(np.max(z) <= 5)),
        Goal(
            f"synchronized, error above {ALLOWED:g} deviations: at most 1 % of samples",
            f"{flag:.1%}, of one run up to {worst:.0%}",
            bool(flag <= 0.01),
        ),
        Goal(
            "error at most 1.3 of geometric's on nine of ten",
            f"{near} {runs}",
            bool(near >= enough),
        ),
        Goal("median ratio below 0.8", f"{np.median(ratio):.2f}", bool(np.median(ratio) < 0.8)),
        Goal(
            f"warning within {SOON} events where the error exceeds {NOTICEABLE:.0%}",
            f"{soon} of {len(due)}",
            soon == len(due),
        ),
    ]


def table(outcomes: Sequence[Outcome], title: str) -> Table:
    """A row for each run."""
    found = Table(
        box=box.SIMPLE_HEAD,
        title=title,
        title_justify="left",
        padding=(0, 1, 0, 0),
        pad_edge=False,
    )
    found.add_column("plant", no_wrap=True)
    headings = ("seed", "impacts", "z", "flag", GEOMETRIC, "min.-variance", "ratio", "warning")
    for heading in headings:
        found.add_column(heading, justify="right", no_wrap=True)
    for each in outcomes:
        found.add_row(
            each.plant,
            str(each.seed),
            str(each.impacts),
            f"{each.z:.2f}",
            f"{100 * each.flag:.1f} %",
            f"{100 * each.geometric:.2g} %",
            f"{100 * each.filtered:.2g} %",
            f"{each.ratio:.2f}",
            "" if each.warned is None else str(each.warned),
        )
    return found


def print_group(outcomes: Sequence[Outcome], group: Group, console: Console) -> None:
    """The table of a group, and its goals."""
    console.print(table(outcomes, group))
    for goal in goals(outcomes):
        met = "met" if goal.is_met else "missed"
        console.print(f"  {met:6} {goal.text}: {goal.found}", highlight=False)
    console.print()


def run(jobs: Sequence[Job], workers: int) -> Iterator[Outcome]:
    """The runs that can be made, in their order, by so many processes."""
    console = Console(stderr=True)
    made = Parallel(workers, return_as="generator")(delayed(outcome)(job) for job in jobs)
    for each in track(made, "runs", total=len(jobs), console=console, transient=True):
        if isinstance(each, Outcome):
            yield each
        else:
            console.print(each, highlight=False)


def arguments(args: Sequence[str] | None) -> argparse.Namespace:
    """The arguments, checked."""
    parser = argparse.ArgumentParser(prog="./dev bench misfit", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("names", nargs="*", metavar="PLANT", help="names or patterns: 'drill-*'")
    parser.add_argument("--group", choices=get_args(Group), help="(default: both)")
    parser.add_argument("--seeds", type=int, default=1, metavar="N", help="a plant (default 1)")
    parser.add_argument("--seconds", type=float, default=60.0, metavar="S", help="(default 60)")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="processes (default 2)")
    parser.add_argument("--json", type=new_file, metavar="FILE", help="write every run to FILE")
    parser.add_argument(
        "--exact", type=int, default=0, metavar="N", help="false alarms in N events instead"
    )
    parser.add_argument(
        "--first-seed", type=int, default=0, metavar="K", help="of --exact: the first seed"
    )
    given = parser.parse_args(args)
    if min(given.seeds, given.jobs) < 1 or not given.seconds > 10 or given.exact < 0:
        parser.error("expected --seeds, --jobs and --exact above 0, --seconds above 10")
    given.plants = [
        each
        for each in plants()
        if given.group in {None, each.group}
        and (not given.names or any(fnmatch(each.name, name) for name in given.names))
    ]
    if not given.plants:
        parser.error(f"no plant is named {' or '.join(given.names)} in that group")
    return given


def main(args: Sequence[str] | None = None) -> int:
    """Run the plants and print the tables.

    Returns:
        0; 2 for wrong use.
    """
    given, console = arguments(args), Console(width=max(Console().width, 110))
    if given.exact:
        counts = misfit_alarms.run(given.exact, given.jobs, given.first_seed)
        misfit_alarms.print_table(counts, console)
        document = {"exact": [asdict(each) for each in counts]}
    else:
        jobs = [
            Job(each.name, seed, given.seconds)
            for each in given.plants
            for seed in range(given.seeds)
        ]
        outcomes = list(run(jobs, given.jobs))
        for group in get_args(Group):
            if members := [each for each in outcomes if each.group == group]:
                print_group(members, group, console)
        document = {"seconds": given.seconds, "runs": [asdict(each) for each in outcomes]}
    if given.json:
        given.json.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
