# SPDX-License-Identifier: Apache-2.0
"""How often an exact model is warned of: ``./dev bench alarms``.

    ./dev bench alarms --events 10000 --jobs 1 --first-seed 200000

Plants of the package's own integrator from random states, sensors with and without faults, the
law with its defaults. Runs of 60 s are made in rounds until there are enough events. The bound of
the rate is the upper limit of its 95 % confidence interval: 3 over the events where none alarms.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from joblib import Parallel, delayed
from rich import box
from rich.console import Console
from rich.progress import Progress
from rich.table import Table
from scipy import stats

from benchmarks.covariance import EPOCH, drawn, simulated
from benchmarks.troubles import Scenario, SimulatedPlant
from impact_observer import Options, make_observer
from impact_observer.plant import SensorModel
from impact_observer.stamps import from_seconds, grid

MODELS = ("two_mass", "three_mass")
SENSORS = tuple(
    Scenario(
        f"jitter {1e3 * jitter:g} ms, {100 * missed:g} % missed, {100 * spurious:g} % spurious",
        SensorModel(jitter=jitter, missed=missed),
        spurious,
    )
    for jitter in (0.0, 1e-4, 1e-3)
    for missed in (0.0, 0.1)
    for spurious in (0.0, 0.1)
)
SECONDS = 60.0


class Job(NamedTuple):
    """A run to be made."""

    model: str
    sensor: Scenario
    seed: int


@dataclass(frozen=True, slots=True)
class Count:
    """Of a model and a sensor.

    Attributes:
        model: name.
        sensor: its faults.
        events: received.
        alarms: events at which a warning began.
        warned: events at which there was one.
    """

    model: str
    sensor: str
    events: int = 0
    alarms: int = 0
    warned: int = 0

    def __add__(self, other: "Count") -> "Count":
        """Both together."""
        return replace(
            self,
            events=self.events + other.events,
            alarms=self.alarms + other.alarms,
            warned=self.warned + other.warned,
        )


def most(events: int, alarms: int) -> float:
    """The upper limit of the 95 % confidence interval of a rate of alarms, Poisson."""
    return float(stats.chi2.ppf(0.95, 2 * alarms + 2)) / 2 / events if events else np.inf


def counted(job: Job) -> Count:
    """Run the observer on the messages of one sensor."""
    system, x = drawn(job.model, np.random.default_rng([2027, job.seed]))
    run = simulated(system, x, grid(EPOCH, EPOCH + from_seconds(SECONDS), 1.0))
    observer = make_observer(system, Options(law="minimum-variance", epoch=EPOCH))
    warnings = [False]
    for message in SimulatedPlant(system, x, run).messages(job.sensor, job.seed):
        observer.receive(message.event)
        warnings.append(bool(observer.estimate(max(observer.last_event, EPOCH)).misfit))
    begun = np.flatnonzero(np.diff(np.array(warnings, int)) > 0).size
    return Count(job.model, job.sensor.name, len(warnings) - 1, begun, sum(warnings))


def run(events: int, workers: int, seed: int = 0) -> list[Count]:
    """Counts by model and sensor, of at least so many events; the first run has this ``seed``."""
    totals = {(m, sensor): Count(m, sensor.name) for m in MODELS for sensor in SENSORS}
    with (
        Progress(console=Console(stderr=True), transient=True) as progress,
        Parallel(workers, return_as="generator") as parallel,
    ):
        shown = progress.add_task("events", total=events)
        while sum(each.events for each in totals.values()) < events:
            jobs = [Job(*each, seed) for seed, each in enumerate(totals, start=seed)]
            for job, found in zip(jobs, parallel(map(delayed(counted), jobs)), strict=True):
                totals[job.model, job.sensor] += found
                progress.advance(shown, found.events)
            seed += len(jobs)
    return list(totals.values())


def print_table(counts: Sequence[Count], console: Console) -> None:
    """A row for each model and sensor, and their sum."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("model", "sensor"):
        table.add_column(heading, no_wrap=True)
    for heading in ("events", "alarms", "events warned of", "rate at most"):
        table.add_column(heading, justify="right", no_wrap=True)
    total = sum(counts, Count("all", ""))
    for each in (*counts, total):
        bound = f"{most(each.events, each.alarms):.1e}"
        numbers = (each.events, each.alarms, each.warned)
        table.add_row(each.model, each.sensor, *map(str, numbers), bound)
    console.print(table)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="./dev bench alarms", description=__doc__)
    parser.add_argument("--events", type=int, default=1000, metavar="N", help="(default 1000)")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="processes (default 2)")
    parser.add_argument("--first-seed", type=int, default=0, metavar="K", help="(default 0)")
    given = parser.parse_args(arguments)
    print_table(run(given.events, given.jobs, given.first_seed), Console())
    return 0


if __name__ == "__main__":
    sys.exit(main())
