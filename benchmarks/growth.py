"""The plant's cost against its size, as figures of the table; the bar itself is in ``bar.py``."""

import math
from pathlib import Path

from benchmarks.bar import bar, run
from benchmarks.harness import Benchmark, Contest, Figures, Goal

SMALL, LARGE = 100, 1000


def prepare(_: Path) -> Contest:
    """Nothing to prepare: a run of the large bar takes as long as one can wait."""

    def ours(_: Path) -> Figures:
        each: dict[int, float] = {}
        total = 0.0
        for n in (SMALL, LARGE):
            found, preparing, running = run(bar(n))
            each[n] = running / (len(found.switchings) + 1)
            total = preparing + running
        growth = math.log(each[LARGE] / each[SMALL]) / math.log(LARGE / SMALL)
        return {"exponent": growth, f"n = {LARGE}": total}

    work = f"a steel bar of {SMALL} and {LARGE} elements; n to the exponent is a phase's cost"
    return Contest(work, ours, units={"exponent": "", f"n = {LARGE}": "s"})


BENCHMARK = Benchmark(
    "bar",
    "how does a plant's cost grow with its coordinates?",
    prepare,
    (Goal(1.2, figure="exponent"), Goal(10.0, figure=f"n = {LARGE}")),
    rounds=1,
)
