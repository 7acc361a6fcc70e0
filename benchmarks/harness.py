# SPDX-License-Identifier: Apache-2.0
"""Measuring contestants side by side: they take turns, and each round gives a ratio."""

import argparse
import gc
import os
import statistics
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias, cast

Metrics: TypeAlias = Mapping[str, float]
"""Measured values, by name."""
Job: TypeAlias = Callable[[Path], object]
"""Does the work once, in an empty folder that is removed afterwards."""
TIME = "time"
"""How long a job takes, s: the metric of jobs that return none."""
OURS = "ours"


def new_file(text: str) -> Path:
    """The path of a file to be written, checked before anything is measured.

    Raises:
        ArgumentTypeError: it is a folder, or it cannot be written.
    """
    path = Path(text)
    folder = path.absolute().parent
    if not folder.is_dir():
        raise argparse.ArgumentTypeError(f"no folder {folder}; make it first")
    if path.is_dir() or not os.access(path if path.exists() else folder, os.W_OK):
        raise argparse.ArgumentTypeError(f"{path}: cannot be written; name another file")
    return path


class DisagreementError(Exception):
    """The results of the contestants differ, so their times cannot be compared."""


class SkippedError(Exception):
    """A benchmark cannot run here; the message has the reason."""


@dataclass(frozen=True, slots=True)
class Contest:
    """The contestants of a benchmark.

    Attributes:
        work: what each of them does, with numbers; checked before anything is timed.
        ours: the package.
        peers: the others, by name.
        absent: why a peer cannot take part here, by name.
        units: of the metrics, by their names. Where there are others than ``TIME``, jobs return
            all of them.
        ready: makes what ours starts from, before each time; it is not timed.
        repeats: how often each does the work in its turn. The least of these counts: the first
            run after a pause of milliseconds measures how the processor wakes up.
    """

    work: str
    ours: Job
    peers: Mapping[str, Job] = field(default_factory=dict)
    absent: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=lambda: {TIME: "s"})
    ready: Callable[[], object] = lambda: None
    repeats: int = 1


@dataclass(frozen=True, slots=True)
class Goal:
    """An upper bound of a ratio's median, or of the least of the rounds.

    Attributes:
        most: the largest value that meets the goal.
        peer: whose metric ours is divided by; empty for the least of ours, in its unit.
        metric: its name.
    """

    most: float
    peer: str = ""
    metric: str = TIME


@dataclass(frozen=True, slots=True)
class Benchmark:
    """A contest, to be prepared.

    Attributes:
        name: on the command line.
        question: that its ratios answer, one line.
        prepare: makes the data in a folder and checks that the results agree.
        goals: for its metrics and ratios.
        rounds: how many, by default.
    """

    name: str
    question: str
    prepare: Callable[[Path], Contest]
    goals: tuple[Goal, ...] = ()
    rounds: int = 7


@dataclass(frozen=True, slots=True)
class Ratio:
    """Our metric over a peer's: below 1 we are faster.

    Attributes:
        median: over the rounds.
        low: least of the rounds.
        high: largest of the rounds.
    """

    median: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Result:
    """The measurements of a benchmark.

    Attributes:
        benchmark: which one.
        contest: its contestants.
        metrics: of each round, by contestant and metric; the package is called ``OURS``.
    """

    benchmark: Benchmark
    contest: Contest
    metrics: Mapping[str, Mapping[str, list[float]]]

    def ratio(self, peer: str, metric: str) -> Ratio:
        """Our metric over the peer's in the same round, so that a slow spell cancels."""
        ours, theirs = self.metrics[OURS][metric], self.metrics[peer][metric]
        return _spread([a / b for a, b in zip(ours, theirs, strict=True)])

    def own(self, metric: str) -> Ratio:
        """Our metric."""
        return _spread(self.metrics[OURS][metric])


def measure(benchmark: Benchmark, rounds: int | None, show: Callable[[str], None]) -> Result | str:
    """Prepare a benchmark and let its contestants take turns.

    Args:
        benchmark: what to measure.
        rounds: how many, in rotating order; None for the default of the benchmark.
        show: called with what is being done.

    Returns:
        The measurements, or why nothing can be measured here.

    Raises:
        DisagreementError: the contestants' results differ.
    """
    turns = rounds or benchmark.rounds
    with tempfile.TemporaryDirectory(prefix="impact_observer_") as folder:
        show(f"{benchmark.name}: preparing")
        try:
            contest = benchmark.prepare(Path(folder))
        except SkippedError as reason:
            return str(reason)
        jobs = {OURS: contest.ours, **contest.peers}
        found: dict[str, dict[str, list[float]]] = {
            name: {metric: [] for metric in contest.units} for name in jobs
        }
        names = list(jobs)
        for k in range(turns):
            for name in names[k % len(names) :] + names[: k % len(names)]:
                show(f"{benchmark.name}: round {k + 1} of {turns}, {name}")
                measured = _turn(contest, jobs[name], Path(folder))
                for metric, values in found[name].items():
                    values.append(measured[metric])
    return Result(benchmark, contest, found)


def _turn(contest: Contest, job: Job, folder: Path) -> Metrics:
    """The least metrics of one turn of ``job``; garbage is collected before, not during."""
    gc.collect()
    gc.disable()
    try:
        found = [_measured(contest, job, folder) for _ in range(contest.repeats)]
    finally:
        gc.enable()
    return {metric: min(each[metric] for each in found) for metric in contest.units}


def _measured(contest: Contest, job: Job, folder: Path) -> Metrics:
    """The metrics of ``job``, or its time, s."""
    if job is contest.ours:
        contest.ready()
    with tempfile.TemporaryDirectory(dir=folder) as place:
        begin = time.perf_counter()
        metrics = job(Path(place))
        taken = time.perf_counter() - begin
    return {TIME: taken} if TIME in contest.units else cast("Metrics", metrics)


def _spread(values: list[float]) -> Ratio:
    return Ratio(statistics.median(values), min(values), max(values))
