# SPDX-License-Identifier: Apache-2.0
"""The measurements as a document, and the document as a table or in Markdown.

python -m benchmarks.report FILE     # of ./dev bench --json FILE, in Markdown
"""

import json
import math
import os
import platform
import statistics
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree as ET

from rich import box
from rich.table import Table

from benchmarks.harness import OURS, Goal, Result

PACKAGES = {
    "impact_observer": (),
    "numpy": (),
    "scipy": (),
    "rosbags": (),
    "mcap": (),
    "rclpy": ("ros-rclpy",),
    "fastrtps": ("ros-fastrtps",),
}
"""Packages whose versions are reported, and their names as wheels."""
_SICONOS = Path("/usr/include/siconos/SiconosConfig.h")
_PREFIXES = {"s": ((1.0, "s"), (1e-3, "ms"), (1e-6, "us"), (1e-9, "ns"))}


class Row(NamedTuple):
    """A line of the table."""

    benchmark: str
    ours: str
    peer: str
    theirs: str
    ratio: str
    spread: str
    goal: str
    met: str


HEADINGS = Row("benchmark", "ours", "peer", "peer's", "ratio", "of the rounds", "goal", "met")

CAPTION = (
    "Medians of the rounds. Ratios are ours over the peer's in the same round: below 1 is less."
    "\nGoals are for the median of ratios, and for the least of our own metrics."
    "\nTables of their own: ./dev bench memory, of a node after 1e6 events; ./dev bench sweep, how"
    " that scales."
)


def document(results: Sequence[Result], skipped: Mapping[str, str]) -> dict[str, Any]:
    """All measurements and versions; nothing identifies the machine.

    Args:
        results: of the benchmarks.
        skipped: why others were skipped, by name.
    """
    return {
        "versions": {"python": platform.python_version(), **_versions()},
        "benchmarks": [
            {
                "name": result.benchmark.name,
                "question": result.benchmark.question,
                "work": result.contest.work,
                "units": dict(result.contest.units),
                "metrics": result.metrics,
                "ratios": {
                    peer: {f: asdict(result.ratio(peer, f)) for f in result.contest.units}
                    for peer in result.contest.peers
                },
                "goals": [
                    {**asdict(goal), **_reached(result, goal)} for goal in result.benchmark.goals
                ],
                "skipped": dict(result.contest.absent),
            }
            for result in results
        ],
        "skipped": dict(skipped),
    }


def _reached(result: Result, goal: Goal) -> dict[str, float | bool | None]:
    """The value and whether it meets a goal; None where the peer is absent."""
    if goal.peer and goal.peer not in result.contest.peers:
        return {"found": None, "met": None}
    # A ratio has no slow spells in it; a metric of our own has, so its least counts.
    own = result.own(goal.metric).low
    found = result.ratio(goal.peer, goal.metric).median if goal.peer else own
    return {"found": found, "met": found <= goal.most}


def rows(document: Mapping[str, Any]) -> Iterator[Row]:
    """The table of a document: a row for each goal, and for each other peer and metric."""
    for each in document["benchmarks"]:
        left = {(peer, metric) for peer in each["ratios"] for metric in each["units"]}
        left |= {(peer, next(iter(each["units"]))) for peer in each["skipped"]}
        if not left:
            left = {("", metric) for metric in each["units"]}
        goals = {(goal["peer"], goal["metric"]): goal for goal in each["goals"]}
        for peer, metric in sorted(left | goals.keys(), key=lambda two: (two[1], two[0])):
            yield _row(each, peer, metric, goals.get((peer, metric)))


def _row(each: Mapping[str, Any], peer: str, metric: str, goal: Mapping[str, Any] | None) -> Row:
    unit, metrics = each["units"][metric], each["metrics"]
    ours = metrics[OURS][metric]
    theirs = ratio = ""
    spread = f"{shown(min(ours), unit)} to {shown(max(ours), unit)}"
    if peer in each["skipped"]:
        spread = f"skipped: {each['skipped'][peer]}"
    elif peer:
        theirs = shown(statistics.median(metrics[peer][metric]), unit)
        own = each["ratios"][peer][metric]
        ratio, spread = f"{own['median']:.3g}", f"{own['low']:.3g} to {own['high']:.3g}"
    limit = met = ""
    if goal is not None:
        limit = f"{goal['most']:g}" if peer else shown(goal["most"], unit)
        met = {True: "yes", False: "no", None: ""}[goal["met"]]
    median = shown(statistics.median(ours), unit)
    wanted = f"<= {limit}" if limit else ""
    name = each["name"] if len(each["units"]) == 1 else f"{each['name']}, {metric}"
    return Row(name, median, peer, theirs, ratio, spread, wanted, met)


def shown(value: float, unit: str) -> str:
    """Three digits, with the prefix that fits."""
    for scale, name in _PREFIXES.get(unit, ()):
        if abs(value) >= 0.9995 * scale:
            rounded = float(f"{value / scale:.3g}")
            return f"{rounded:.{max(2 - math.floor(math.log10(abs(rounded))), 0)}f} {name}"
    return f"{value:.3g} {unit}".rstrip()


def table(document: Mapping[str, Any]) -> Table:
    """The table of a document, for the terminal."""
    made = Table(box=box.SIMPLE_HEAD, caption=CAPTION, caption_justify="left")
    for heading in HEADINGS:
        left = heading in {"benchmark", "peer", "met"}
        whole = heading in {"benchmark", "ours", "peer's", "goal"}
        made.add_column(heading, justify="left" if left else "right", no_wrap=whole)
    for row in rows(document):
        made.add_row(*row)
    return made


def markdown(document: Mapping[str, Any]) -> str:
    """The table of a document in Markdown, with versions."""
    lines = [HEADINGS, ["---"] * len(HEADINGS), *rows(document)]
    versions = ", ".join(
        f"{name} {found}" for name, found in document["versions"].items() if found
    )
    return "\n".join([*(f"| {' | '.join(line)} |" for line in lines), "", f"With {versions}."])


def _versions() -> dict[str, str | None]:
    found = {name: _version(name, wheels) for name, wheels in PACKAGES.items()}
    return {**found, "siconos": _siconos()}


def _version(name: str, wheels: Sequence[str]) -> str | None:
    """The version of a Python package, or of a ROS package."""
    for each in (*wheels, name):
        with suppress(PackageNotFoundError):
            return version(each)
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        manifest = Path(prefix, "share", name, "package.xml")
        if manifest.is_file():
            return ET.parse(manifest).findtext("version")
    return None


def _siconos() -> str | None:
    """The version of Siconos, from its header."""
    if not _SICONOS.is_file():
        return None
    for line in _SICONOS.read_text("utf-8", errors="replace").splitlines():
        if "SICONOS_VERSION" in line and '"' in line:
            return line.split('"')[1]
    return None


if __name__ == "__main__":
    try:
        measured = json.loads(Path(sys.argv[1]).read_text("utf-8"))
    except (IndexError, OSError, ValueError) as error:
        sys.exit(f"benchmarks.report: {error}; give the FILE of ./dev bench --json FILE")
    print(markdown(measured))
