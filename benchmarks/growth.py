"""The plant's cost against its size, as figures of the table; the bar itself is in ``bar.py``."""

from pathlib import Path

from benchmarks.bar import growth, run
from benchmarks.harness import Benchmark, Contest, Figures, Goal

SIZES = (10, 100, 1000)
TOTAL = f"n = {SIZES[-1]}"


def prepare(_: Path) -> Contest:
    """Nothing to prepare: a run of the large bar takes as long as one can wait."""

    def ours(_: Path) -> Figures:
        costs = [run(n)[1] for n in SIZES]
        return {"exponent": growth(costs), TOTAL: costs[-1].total}

    sizes = ", ".join(map(str, SIZES))
    work = f"steel bars of {sizes} elements, 100 hits each; a phase costs n to the exponent"
    return Contest(work, ours, units={"exponent": "", TOTAL: "s"})


BENCHMARK = Benchmark(
    "bar",
    "how does a plant's cost grow with its coordinates?",
    prepare,
    (Goal(1.2, figure="exponent"), Goal(10.0, figure=TOTAL)),
    rounds=1,
)
