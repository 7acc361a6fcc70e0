# SPDX-License-Identifier: Apache-2.0
"""How long ``impact-observer --help`` takes, against an interpreter that does nothing."""

import os
import subprocess
import sys
from pathlib import Path

from benchmarks.harness import Benchmark, Contest, DisagreementError, Goal

_BOOTSTRAPPED = ("_ROS_WHEELS_BOOTSTRAP_COMPLETE", "LD_LIBRARY_PATH")
"""With ROS as wheels the interpreter restarts itself once; these variables would prevent it."""


def prepare(_: Path) -> Contest:
    """The installed command, or its module."""
    script = Path(sys.executable).with_name("impact-observer")
    command = [str(script)] if script.exists() else [sys.executable, "-m", "impact_observer"]
    if "COMMAND" not in _run([*command, "--help"]):
        raise DisagreementError("impact-observer --help prints no help")
    return Contest(
        "processes from start to end",
        lambda _: _run([*command, "--help"]),
        {"python -c pass": lambda _: _run([sys.executable, "-c", "pass"])},
    )


def _run(command: list[str]) -> str:
    kept = {name: value for name, value in os.environ.items() if name not in _BOOTSTRAPPED}
    done = subprocess.run(command, env=kept, capture_output=True, text=True, check=True)
    return done.stdout


BENCHMARK = Benchmark(
    "start", "how long does impact-observer --help take?", prepare, (Goal(0.15),), rounds=15
)
