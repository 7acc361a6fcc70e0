# SPDX-License-Identifier: Apache-2.0
"""The time of a sweep of ten thousand starts, by the whole command from start to end."""

import subprocess
import sys
from pathlib import Path

from benchmarks.harness import Benchmark, Contest, Goal

STARTS = 10_000
WORKERS = 2
_COMMAND = (
    *("-m", "impact_observer", "sweep", "three_mass", "--runs", str(STARTS)),
    *("--duration", "60", "--jobs", str(WORKERS), "--json", "-o"),
)


def prepare(_: Path) -> Contest:
    """Name the command; each turn writes a new file of outcomes."""

    def ours(place: Path) -> None:
        command = [sys.executable, *_COMMAND, str(place / "starts.parquet")]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)

    return Contest(f"{STARTS} starts of three_mass, 60 s each, law geometric, two processes", ours)


BENCHMARK = Benchmark(
    "sweep", "how long do ten thousand starts take?", prepare, (Goal(5.0),), rounds=3
)
