# SPDX-License-Identifier: Apache-2.0
"""Hostile inputs to everything that reads something foreign: ``./dev soak``.

    ./dev soak                            # 20 000 inputs
    ./dev soak --inputs 1000000           # those of docs/security.md
    ./dev soak --only model csv --seed 7

Each input must be used, or refused by an error that is reported as one line. Anything else is an
exception that is foreign: it is printed with what repeats it. An input that takes longer than 10 s
of processor time is counted as one, too. Inputs depend on the seed and their number only.
"""

import argparse
import random
import signal
import sys
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType

from benchmarks.soak_targets import TARGETS, Target, expected_errors, folder, named

SECONDS = 10
"""Longest processor time that an input may take, s."""


class TooSlowError(Exception):
    """An input takes too long."""


@dataclass
class Outcome:
    """What became of the inputs of a target.

    Attributes:
        used: inputs that could be used.
        refused: inputs that were refused by an error of one line.
        foreign: what else was raised, with the number of its first input.
        counts: how often each of them.
        slowest: longest processor time of an input, s.
    """

    used: int = 0
    refused: int = 0
    foreign: dict[str, int] = field(default_factory=dict)
    counts: Counter[str] = field(default_factory=Counter)
    slowest: float = 0.0


def soak(target: Target, numbers: Sequence[int], seed: int, place: Path) -> Outcome:
    """Give the inputs of these ``numbers`` to a target, in the folder ``place``."""
    attack, found, expected = target.make(place), Outcome(), expected_errors()
    for number in numbers:
        begin = time.process_time()
        try:
            with _limited():
                attack(random.Random(f"{seed} {target.name} {number}"))
            found.used += 1
        except expected:
            found.refused += 1
        except Exception as error:  # noqa: BLE001 (this is what is searched for)
            place_of = traceback.extract_tb(error.__traceback__)[-1]
            where = f"{Path(place_of.filename).name}:{place_of.lineno}"
            _note(found, f"{type(error).__name__} at {where}: {str(error)[:500]}", number)
        found.slowest = max(found.slowest, time.process_time() - begin)
    return found


def _note(found: Outcome, what: str, number: int) -> None:
    kind = what.partition(": ")[0]
    found.counts[kind] += 1
    if found.counts[kind] == 1:
        found.foreign[what] = number


@contextmanager
def _limited() -> Iterator[None]:
    """Raise when the block takes too long."""

    def too_slow(_number: int, _frame: FrameType | None) -> None:
        raise TooSlowError

    previous = signal.signal(signal.SIGVTALRM, too_slow)
    signal.setitimer(signal.ITIMER_VIRTUAL, SECONDS)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        signal.signal(signal.SIGVTALRM, previous)


def main(args: Sequence[str] | None = None) -> int:
    """Attack all targets, and print what became of the inputs.

    Returns:
        0; 1 when an exception was foreign.
    """
    parser = argparse.ArgumentParser(prog="./dev soak", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--inputs", type=int, default=20_000, metavar="N")
    parser.add_argument("--seed", type=int, default=1, metavar="S")
    parser.add_argument("--from", dest="first", type=int, default=0, metavar="K")
    names = [each.name for each in TARGETS]
    parser.add_argument("--only", nargs="+", choices=names, default=[], metavar="TARGET")
    given = parser.parse_args(args)
    warnings.simplefilter("ignore")
    targets = named(given.only)
    whole, failed, total = sum(each.share for each in targets), 0, 0
    for target in targets:
        count = max(round(given.inputs * target.share / whole), 1)
        with folder() as place:
            numbers = range(given.first, given.first + count)
            found = soak(target, numbers, given.seed, Path(place))
        total += count
        failed += sum(found.counts.values())
        print(
            f"{target.name:12} {count:8} inputs: {found.used} used, {found.refused} refused,"
            f" {sum(found.counts.values())} foreign; the slowest took {found.slowest:.2f} s",
            flush=True,
        )
        for what, number in found.foreign.items():
            repeat = f"--only {target.name} --seed {given.seed} --from {number} --inputs 1"
            print(f"    {found.counts[what.partition(': ')[0]]} x {what}\n    ./dev soak {repeat}")
    print(f"{total} inputs, {failed} foreign exceptions", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
