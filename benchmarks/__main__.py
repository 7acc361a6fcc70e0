# SPDX-License-Identifier: Apache-2.0
"""Run benchmarks: ``python -m benchmarks [NAME...]``, or ``./dev bench``."""

import argparse
import json
import sys
from collections.abc import Iterable, Sequence

from rich.console import Console

from benchmarks import (
    events,
    filter_cost,
    live_inputs,
    observe_bag,
    plant_run,
    report,
    sweep,
    topic,
)
from benchmarks.fast_bags import SECONDS
from benchmarks.harness import Benchmark, DisagreementError, Result, measure, new_file


def benchmarks(seconds: float) -> tuple[Benchmark, ...]:
    """Returns all benchmarks; ``seconds`` is the length of the bags to observe."""
    return (
        plant_run.BENCHMARK,
        plant_run.IMPACTS,
        topic.BENCHMARK,
        live_inputs.BENCHMARK,
        live_inputs.SENSOR,
        live_inputs.ROBOT,
        *observe_bag.benchmarks(seconds),
        *events.benchmarks(),
        *filter_cost.benchmarks(seconds),
        sweep.BENCHMARK,
    )


def main(args: Sequence[str] | None = None) -> int:
    """Run the benchmarks given, or all.

    Returns:
        0; 1 where the contestants of a benchmark disagree in their results; 2 for wrong use.
    """
    given = arguments(args)
    if given.list:
        for each in benchmarks(SECONDS):
            print(f"{each.name:24} {each.question}")
        return 0
    chosen = [each for each in benchmarks(given.seconds) if each.name in given.names]
    results, skipped, agreed = measured(chosen, given.rounds)
    if given.json:
        document = report.document(results, skipped)
        given.json.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
    console = Console(width=max(Console().width, 120))
    console.print(report.table(results))
    for result in results:
        console.print(f"{result.benchmark.name}: {result.contest.work}", highlight=False)
    for name, reason in skipped.items():
        console.print(f"{name}: skipped: {reason}", highlight=False)
    return 0 if agreed else 1


def arguments(args: Sequence[str] | None) -> argparse.Namespace:
    """The arguments, checked; ``names`` are those of all benchmarks where none are given."""
    names = [each.name for each in benchmarks(SECONDS)]
    parser = argparse.ArgumentParser(prog="./dev bench", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="only these (default: all)")
    parser.add_argument("--list", action="store_true", help="list the benchmarks, and end")
    parser.add_argument("--rounds", type=int, metavar="N", help="rounds (default: each its own)")
    parser.add_argument(
        "--seconds",
        type=float,
        default=SECONDS,
        metavar="S",
        help=f"length of the bags to observe (default {SECONDS:g})",
    )
    parser.add_argument("--json", type=new_file, metavar="FILE", help="write every metric to FILE")
    given = parser.parse_args(args)
    if unknown := [name for name in given.names if name not in names]:
        parser.error(f"no benchmark {', '.join(unknown)}; there are {', '.join(names)}")
    if given.rounds is not None and given.rounds < 1:
        parser.error(f"argument --rounds: {given.rounds}; expected 1 or more")
    if not 1 <= given.seconds <= 100_000:
        parser.error(f"argument --seconds: {given.seconds:g}; expected 1 to 100000")
    given.names = given.names or names
    return given


def measured(
    chosen: Iterable[Benchmark], rounds: int | None
) -> tuple[list[Result], dict[str, str], bool]:
    """Returns results, reasons of skipped benchmarks, and whether all contestants agreed."""
    results: list[Result] = []
    skipped: dict[str, str] = {}
    agreed = True
    with Console(stderr=True).status("") as status:
        for each in chosen:
            try:
                result = measure(each, rounds, status.update)
            except DisagreementError as error:
                result, agreed = f"results disagree: {error}", False
                print(f"benchmarks: {each.name}: {result}", file=sys.stderr)
            if isinstance(result, str):
                skipped[each.name] = result
            else:
                results.append(result)
    return results, skipped, agreed


if __name__ == "__main__":
    sys.exit(main())
