"""Run benchmarks: ``python -m benchmarks [NAME...]``, or ``./dev bench``."""

import argparse
import json
import platform
import sys
from collections.abc import Sequence
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks import compare_bag, observe_bag, plant_run
from benchmarks.fast_bags import SECONDS
from benchmarks.harness import Benchmark, DisagreementError, Result, measure

PACKAGES = ("impact_observer", "numpy", "scipy", "rosbags")


def benchmarks(seconds: float) -> tuple[Benchmark, ...]:
    """All there are; ``seconds`` is the length of bags to observe and to compare."""
    return (
        plant_run.BENCHMARK,
        *observe_bag.benchmarks(seconds),
        compare_bag.benchmark(seconds),
    )


def main(args: Sequence[str] | None = None) -> int:
    """Run what is asked for.

    Returns:
        0; 1 when contestants disagree, so that there is nothing to compare; 2 for wrong use.
    """
    known = [each.name for each in benchmarks(SECONDS)]
    parser = argparse.ArgumentParser(prog="./dev bench", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="only these (default: all)")
    parser.add_argument("--list", action="store_true", help="say what there is, and end")
    parser.add_argument("--rounds", type=int, default=7, metavar="N", help="turns (default 7)")
    parser.add_argument(
        "--seconds",
        type=float,
        default=SECONDS,
        metavar="S",
        help=f"length of the bags to observe and to compare (default {SECONDS:g})",
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every figure to FILE")
    given = parser.parse_args(args)
    if unknown := [name for name in given.names if name not in known]:
        parser.error(f"no benchmark {', '.join(unknown)}; there are {', '.join(known)}")
    if given.rounds < 1:
        parser.error(f"argument --rounds: {given.rounds}; expected 1 or more")
    if not 1 <= given.seconds <= 100_000:
        parser.error(f"argument --seconds: {given.seconds:g}; expected 1 to 100000")
    if given.json and not given.json.absolute().parent.is_dir():
        parser.error(f"argument --json: no folder {given.json.parent}; make it first")
    console = Console()
    if given.list:
        for each in benchmarks(SECONDS):
            console.print(f"{each.name:16} {each.question}", highlight=False)
        return 0
    chosen = [each for each in benchmarks(given.seconds) if each.name in (given.names or known)]
    try:
        with console.status("") as status:
            results = [measure(each, given.rounds, status.update) for each in chosen]
    except DisagreementError as error:
        print(f"benchmarks: results disagree: {error}", file=sys.stderr)
        return 1
    console.print(_table(results))
    for result in results:
        console.print(f"{result.benchmark.name}: {result.work}", highlight=False)
    if given.json:
        given.json.write_text(json.dumps(_document(results), indent=2) + "\n", encoding="utf-8")
    return 0


def _table(results: Sequence[Result]) -> Table:
    """One row a peer."""
    table = Table(caption="ratio: the peer's time over ours, above 1 we are faster; medians")
    for heading in ("benchmark", "peer"):
        table.add_column(heading)
    for heading in ("ours [ms]", "peer [ms]", "ratio", "lowest to highest"):
        table.add_column(heading, justify="right")
    for result in results:
        name, ours = result.benchmark.name, f"{1e3 * result.median('ours'):.2f}"
        for peer, ratio in result.ratios.items():
            spread = f"{ratio.low:.3g} to {ratio.high:.3g}"
            theirs = f"{1e3 * result.median(peer):.2f}"
            table.add_row(name, peer, ours, theirs, f"{ratio.median:.3g}", spread)
        for peer, reason in result.absent.items():
            table.add_row(name, peer, ours, "", "", f"skipped: {reason}")
    return table


def _document(results: Sequence[Result]) -> dict[str, object]:
    """Everything measured, and with what; nothing that names the machine."""
    return {
        "versions": {"python": platform.python_version()} | {p: _version(p) for p in PACKAGES},
        "benchmarks": [
            {
                "name": result.benchmark.name,
                "question": result.benchmark.question,
                "work": result.work,
                "seconds": result.seconds,
                "ratios": {peer: asdict(ratio) for peer, ratio in result.ratios.items()},
                "skipped": result.absent,
            }
            for result in results
        ],
    }


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


if __name__ == "__main__":
    sys.exit(main())
