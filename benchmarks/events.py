# SPDX-License-Identifier: Apache-2.0
"""The time of one event in an observer with default options."""

import statistics
from functools import partial
from pathlib import Path

from benchmarks.harness import Benchmark, Contest, Goal, Metrics
from benchmarks.impacts import each_received, impacts
from impact_observer.model import read_model
from impact_observer.observer import Options, make_observer

SECONDS = 600.0
"""Length of the run of two_mass, which has three impacts in four seconds, s."""
FIRST = 20
"""Events that are received before the measurement begins."""
ALONE, TOGETHER = "alone", "ten replicas"


def prepare(_: Path, law: str) -> Contest:
    """Simulate the events, which the observer receives in order."""
    events, system = impacts("two_mass", SECONDS), read_model("two_mass").system

    def ours(_: Path) -> Metrics:
        medians = {}
        for name, ensemble in ((ALONE, 1), (TOGETHER, 10)):
            observer = make_observer(system, Options(law=law, ensemble=ensemble))
            medians[name] = statistics.median(each_received(observer, events)[FIRST:])
        return medians

    work = f"two_mass, n = 2, {law}, default options, median of {len(events) - FIRST} events"
    return Contest(work, ours, units={ALONE: "s", TOGETHER: "s"})


def benchmarks() -> tuple[Benchmark, ...]:
    """The benchmarks of one event of ``geometric`` and of ``minimum-variance``."""
    return tuple(
        Benchmark(
            f"event_{law.replace('-', '_')}",
            "what does an event cost?",
            partial(prepare, law=law),
            (Goal(most, metric=TOGETHER),),
        )
        for law, most in (("geometric", 48e-6), ("minimum-variance", 80e-6))
    )
