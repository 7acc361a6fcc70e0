"""Measuring contestants side by side: they take turns, and each round gives its own ratio."""

import gc
import statistics
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

Job: TypeAlias = Callable[[Path], object]
"""Does the work once; gets an empty folder, which is gone afterwards."""


class DisagreementError(Exception):
    """The contestants did not do the same work: there is nothing to compare."""


@dataclass(frozen=True, slots=True)
class Contest:
    """What takes turns.

    Attributes:
        work: what everybody has done, with numbers; checked before anything is timed.
        ours: the package.
        peers: the others, by name.
        absent: why a peer cannot take part here, by name.
    """

    work: str
    ours: Job
    peers: Mapping[str, Job]
    absent: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Benchmark:
    """A contest that can be prepared.

    Attributes:
        name: how it is selected.
        question: what its ratios answer, one line.
        prepare: makes the data in a folder and checks that the results agree.
    """

    name: str
    question: str
    prepare: Callable[[Path], Contest]


@dataclass(frozen=True, slots=True)
class Ratio:
    """A peer's time over ours: above 1 we are faster.

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
    """What was measured.

    Attributes:
        benchmark: which one.
        work: as in :class:`Contest`.
        seconds: each round's time by contestant, s; ours is called ``ours``.
        absent: as in :class:`Contest`.
    """

    benchmark: Benchmark
    work: str
    seconds: Mapping[str, list[float]]
    absent: Mapping[str, str]

    @property
    def ratios(self) -> dict[str, Ratio]:
        """Of each peer; times of the same round are divided, so that a slow spell cancels."""
        return {
            name: _ratio(times, self.seconds["ours"])
            for name, times in self.seconds.items()
            if name != "ours"
        }

    def median(self, name: str) -> float:
        """The median time of a contestant, s."""
        return statistics.median(self.seconds[name])


def measure(benchmark: Benchmark, rounds: int, show: Callable[[str], None]) -> Result:
    """Prepare a benchmark and let its contestants take turns.

    Args:
        benchmark: what to measure.
        rounds: turns of each; the order rotates.
        show: told what is being done.

    Raises:
        DisagreementError: the contestants' results differ.
    """
    with tempfile.TemporaryDirectory(prefix="impact_observer_") as folder:
        show(f"{benchmark.name}: preparing")
        contest = benchmark.prepare(Path(folder))
        jobs = {"ours": contest.ours, **contest.peers}
        seconds: dict[str, list[float]] = {name: [] for name in jobs}
        names = list(jobs)
        for k in range(rounds):
            for name in names[k % len(names) :] + names[: k % len(names)]:
                show(f"{benchmark.name}: round {k + 1} of {rounds}, {name}")
                seconds[name].append(_timed(jobs[name], Path(folder)))
    return Result(benchmark, contest.work, seconds, contest.absent)


def _timed(job: Job, folder: Path) -> float:
    """How long ``job`` takes, s: with garbage collected before, not during."""
    with tempfile.TemporaryDirectory(dir=folder) as place:
        gc.collect()
        gc.disable()
        try:
            begin = time.perf_counter()
            job(Path(place))
            return time.perf_counter() - begin
        finally:
            gc.enable()


def _ratio(theirs: list[float], ours: list[float]) -> Ratio:
    each = [a / b for a, b in zip(theirs, ours, strict=True)]
    return Ratio(statistics.median(each), min(each), max(each))
