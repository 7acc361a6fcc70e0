# SPDX-License-Identifier: Apache-2.0
"""The measurements as a document in JSON, and as a table."""

import math
import statistics
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from rich import box
from rich.table import Table

from benchmarks.harness import OURS, Goal, Result

HEADINGS = ("benchmark", "ours", "peer", "peer's", "ratio", "of the rounds", "goal", "met")
CAPTION = (
    "Medians of the rounds. A ratio is our figure over the peer's in the same round.\n"
    "A goal is for the median of ratios, or for the least of our own figures."
)
_PREFIXES = {"s": ((1.0, "s"), (1e-3, "ms"), (1e-6, "us"), (1e-9, "ns"))}


def document(results: Sequence[Result], skipped: Mapping[str, str]) -> dict[str, Any]:
    """Returns all measurements for a JSON file.

    Args:
        results: of the benchmarks.
        skipped: the reason of each benchmark that was skipped, by name.
    """
    return {
        "benchmarks": [
            {
                "name": result.benchmark.name,
                "work": result.contest.work,
                "units": dict(result.contest.units),
                "metrics": result.metrics,
                "ratios": {
                    peer: {f: asdict(result.ratio(peer, f)) for f in result.contest.units}
                    for peer in result.contest.peers
                },
            }
            for result in results
        ],
        "skipped": dict(skipped),
    }


def table(results: Sequence[Result]) -> Table:
    """Returns the table of all results for the terminal."""
    shown_table = Table(box=box.SIMPLE_HEAD, caption=CAPTION, caption_justify="left")
    for heading in HEADINGS:
        is_left = heading in {"benchmark", "peer", "met"}
        shown_table.add_column(heading, justify="left" if is_left else "right")
    for result in results:
        for row in _rows(result):
            shown_table.add_row(*row)
    return shown_table


def _rows(result: Result) -> Iterator[tuple[str, ...]]:
    """Yields a row for each goal, and for each other peer and metric."""
    contest, goals = result.contest, result.benchmark.goals
    shown_goals = {(goal.peer, goal.metric): goal for goal in goals}
    pairs = {(peer, metric) for peer in contest.peers for metric in contest.units}
    pairs |= {("", metric) for metric in contest.units if not contest.peers}
    pairs |= {(goal.peer, goal.metric) for goal in goals}
    for peer, metric in sorted(pairs, key=lambda pair: (pair[1], pair[0])):
        yield _row(result, peer, metric, shown_goals.get((peer, metric)))


def _row(result: Result, peer: str, metric: str, goal: Goal | None) -> tuple[str, ...]:
    contest, unit = result.contest, result.contest.units[metric]
    ours = result.metrics[OURS][metric]
    name = (
        result.benchmark.name if len(contest.units) == 1 else f"{result.benchmark.name}, {metric}"
    )
    median = shown(statistics.median(ours), unit)
    limit = ""
    if goal is not None:
        limit = f"<= {goal.most:g}" if peer else f"<= {shown(goal.most, unit)}"
    if peer and peer not in contest.peers:
        return (name, median, peer, "", "", f"skipped: {contest.absent[peer]}", limit, "")
    if not peer:
        is_met = goal is not None and min(ours) <= goal.most
        spread = f"{shown(min(ours), unit)} to {shown(max(ours), unit)}"
        return (name, median, "", "", "", spread, limit, _word(goal, is_met=is_met))
    ratio = result.ratio(peer, metric)
    theirs = shown(statistics.median(result.metrics[peer][metric]), unit)
    spread = f"{ratio.low:.3g} to {ratio.high:.3g}"
    is_met = goal is not None and ratio.median <= goal.most
    met = _word(goal, is_met=is_met)
    return (name, median, peer, theirs, f"{ratio.median:.3g}", spread, limit, met)


def _word(goal: Goal | None, *, is_met: bool) -> str:
    return "" if goal is None else "yes" if is_met else "no"


def shown(value: float, unit: str) -> str:
    """Returns ``value`` with three digits and the prefix that fits."""
    for scale, name in _PREFIXES.get(unit, ()):
        if abs(value) >= 0.9995 * scale:
            rounded = float(f"{value / scale:.3g}")
            return f"{rounded:.{max(2 - math.floor(math.log10(abs(rounded))), 0)}f} {name}"
    return f"{value:.3g} {unit}".rstrip()
