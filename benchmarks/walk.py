# SPDX-License-Identifier: Apache-2.0
"""The walk of one event: which functions of the package run, in which files, and how often.

    ./dev bench walk                          # the eighth impact of two_mass
    ./dev bench walk --law geometric --list   # and every function, in the order of its first call

The impacts of two_mass have 1 ms of jitter. The observer has its default options. Functions are
those of Python, as ``sys.setprofile`` sees them; comprehensions are not counted.
"""

import argparse
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from types import CodeType, FrameType

import numpy as np
from rich.console import Console
from rich.table import Table

from impact_observer.model import read_model
from impact_observer.observer import make_observer
from impact_observer.options import Options
from impact_observer.plant import Plant, simulate
from impact_observer.stamps import NS_PER_S, from_seconds

PACKAGE = Path(__file__).resolve().parents[1] / "impact_observer"
EPOCH = NS_PER_S
JITTER = 1e-3
"""Standard deviation of the stamps, s."""
WHICH = 8
"""Number of the impact that is walked."""


def calls_of(action: Callable[[], object]) -> list[CodeType]:
    """The functions of the package that ``action`` calls, in the order of the calls."""
    codes: list[CodeType] = []

    def note(frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        is_ours = code.co_filename.startswith(str(PACKAGE)) and not code.co_name.startswith("<")
        if event == "call" and is_ours:
            codes.append(code)

    sys.setprofile(note)
    try:
        action()
    finally:
        sys.setprofile(None)
    return codes


def walk(law: str) -> list[CodeType]:
    """The functions that the impact number ``WHICH`` of two_mass calls under a law."""
    model, rng = read_model("two_mass"), np.random.default_rng(1)
    observer = make_observer(model, Options(law=law, initial_state="random:1", epoch=EPOCH))
    plant = Plant(model.system, *model.initial_state(), epoch=EPOCH)
    exact = simulate(plant, np.array([EPOCH + from_seconds(30.0)])).events
    events = [
        replace(each, stamp=each.stamp + round(JITTER * NS_PER_S * rng.normal()))
        for each in exact[:WHICH]
    ]
    for each in events[:-1]:
        observer.receive(each)
    return calls_of(lambda: observer.receive(events[-1]))


def main(args: Sequence[str] | None = None) -> int:
    """Print calls, functions, files, and how often the files are entered."""
    parser = argparse.ArgumentParser(prog="./dev bench walk", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--law", action="append", help="only this law (default: two of them)")
    parser.add_argument("--list", action="store_true", help="list the functions")
    given = parser.parse_args(args)
    console = Console(width=max(Console().width, 100))
    table = Table("law", "calls", "functions", "files", "most entries into one file")
    for law in given.law or ("minimum-variance", "geometric"):
        codes = walk(law)
        functions, files = Counter(codes), Counter(code.co_filename for code in codes)
        entries = Counter(name for name, _ in groupby(code.co_filename for code in codes))
        name, most = entries.most_common(1)[0]
        entered = f"{most}, {Path(name).relative_to(PACKAGE)}"
        table.add_row(law, f"{len(codes)}", f"{len(functions)}", f"{len(files)}", entered)
        for code, count in functions.items() if given.list else ():
            place = Path(code.co_filename).relative_to(PACKAGE)
            name = getattr(code, "co_qualname", code.co_name)  # since Python 3.11
            console.print(f"{law:17} {count:6} {place}: {name}")
    console.print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
