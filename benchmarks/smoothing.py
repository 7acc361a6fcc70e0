# SPDX-License-Identifier: Apache-2.0
"""How good smoothed states are, and how their cost grows: ``./dev bench smoothing``.

Two tables. The first is without timing: plants of two_mass and three_mass for 30 s, stamps with
normal errors of 1 ms, which are declared, and initial estimates that are wrong by a standard
normal error in every coordinate, as declared. It has the mean V of filter and smoother at the
start and 5 s after it, what the smoother's covariance says of that, and its normalised estimation
error squared over 2n at both, which should be 1. With ``trusted`` it is also declared that no
event is missed, false or of another contact, and that the model is exact. With ``troubled``, 20 %
of the impacts are missed and about as many are false: there the medians count.

The second table is of two_mass, 1 ms, over the number of impacts: processor time for each impact,
and the largest memory of the process.
"""

import argparse
import itertools
import multiprocessing
import os
import resource
import statistics
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.impacts import energy
from impact_observer.events import ImpactEvent
from impact_observer.model import System, read_model
from impact_observer.observer import make_observer, replay
from impact_observer.options import Options
from impact_observer.plant import Plant, SensorModel, simulate, simulate_sensor
from impact_observer.smooth import smoothed_runs
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Estimate, Stamps, Vector

EPOCH = 5 * NS_PER_S
LENGTH = 30 * NS_PER_S
JITTER = 1e-3
AT = (0.0, 5.0)
"""When V is read, s."""
MARGIN = 5 * JITTER
SENSORS = {
    "jitter": SensorModel(jitter=JITTER),
    "trusted": SensorModel(jitter=JITTER),
    "troubled": SensorModel(jitter=JITTER, missed=0.2, spurious=0.13),
}
DECLARED = Options(law="minimum-variance", clock_error=JITTER, ensemble=1)
TRUSTED = replace(DECLARED, model_error=0.0, missed=0.0, spurious=0.0, mislabelled=0.0)
MODELS = ("two_mass", "three_mass")


class Outcome(NamedTuple):
    """One run, at each of the instants.

    Attributes:
        filtered: V of the filter, J.
        smoothed: V of the smoother, J.
        expected: V that the smoother's covariance says, J.
        consistency: normalised estimation error squared of the smoother, over 2n.
    """

    filtered: list[float]
    smoothed: list[float]
    expected: list[float]
    consistency: list[float]


def drawn(
    system: System, x: Vector, sensor: SensorModel, seed: int
) -> tuple[list[ImpactEvent], Vector, Stamps]:
    """Events of a plant that starts at ``x``, and its states at stamps off impacts."""
    stamps = np.array([EPOCH + round(at * NS_PER_S) for at in AT] + [EPOCH + LENGTH])
    plant = Plant(system, *np.split(x, 2), epoch=EPOCH)
    run = simulate(plant, stamps)
    hits = [each.instant.stamp for each in run.impacts]
    for i in range(1, len(AT)):
        while any(abs(stamps[i] - hit) < MARGIN * NS_PER_S for hit in hits):
            stamps[i] += round(MARGIN * NS_PER_S)
    run = simulate(Plant(system, *np.split(x, 2), epoch=EPOCH), stamps)
    received = simulate_sensor(
        sensor, system, run.switchings, epoch=EPOCH, last=int(stamps[-1]), seed=seed
    )
    return [each.event for each in received], run.states[:-1], stamps[:-1]


def outcome(model: str, sensor: str, seed: int) -> Outcome:
    """One run of a plant, its filter and its smoother."""
    read, rng = read_model(model), np.random.default_rng(seed)
    system, x = read.system, np.concatenate(read.initial_state())
    events, truth, stamps = drawn(system, x, SENSORS[sensor], seed)
    wrong = ",".join(f"{each:.17g}" for each in x + rng.normal(size=x.size))
    options = replace(TRUSTED if sensor == "trusted" else DECLARED, initial_state=wrong)
    observer = make_observer(system, options)
    filtered = [each for each in replay(observer, events, stamps) if isinstance(each, Estimate)]
    (motion,) = smoothed_runs(system, events, options)
    made = [each for batch in motion.estimates(stamps) for each in batch]
    found = Outcome([], [], [], [])
    metric = np.zeros((x.size, x.size))
    metric[: system.n, : system.n], metric[system.n :, system.n :] = system.K, system.M
    for true, before, after in zip(truth, filtered, made, strict=True):
        found.filtered.append(float(energy(system, np.append(before.q, before.u) - true)))
        error = np.append(after.q, after.u) - true
        found.smoothed.append(float(energy(system, error)))
        found.expected.append(float(np.trace(metric @ after.covariance)) / 2)
        square = float(error @ np.linalg.lstsq(after.covariance, error)[0])  # it may be singular
        found.consistency.append(square / error.size)
    return found


def _outcome(case: tuple[str, str, int]) -> Outcome:
    return outcome(*case)


def accuracy(
    console: Console, runs: int, jobs: int, models: Sequence[str], sensors: Sequence[str]
) -> None:
    """Print the first table."""
    title = f"V [J], 30 s, stamps wrong by 1 ms, {runs} starts; NEES over 2n: 1 is consistent"
    table = Table(title=title, box=box.SIMPLE_HEAD)
    table.add_column("model, sensor")
    for name in ("at [s]", "filter", "smoother", "expected", "NEES", "median ratio"):
        table.add_column(name, justify="right")
    context = multiprocessing.get_context("forkserver")
    for model, sensor in itertools.product(models, sensors):
        cases = [(model, sensor, k) for k in range(runs)]
        with ProcessPoolExecutor(jobs, mp_context=context) as pool:
            some = list(track(pool.map(_outcome, cases), sensor, runs, console=console))
        for i, at in enumerate(AT):
            filtered, smoothed, expected, nees = (
                [each[j][i] for each in some] for j in range(len(Outcome._fields))
            )
            ratio = statistics.median(b / a for a, b in zip(filtered, smoothed, strict=True))
            average = statistics.median if sensor == "troubled" else statistics.fmean
            figures = [average(each) for each in (filtered, smoothed, expected)]
            row = [f"{each:.3g}" for each in figures]
            row = [f"{model}, {sensor}", f"{at:g}", *row, f"{average(nees):.2f}", f"{ratio:.2g}"]
            table.add_row(*row)
            console.print(*row)
    console.print(table)


def growth(console: Console, counts: Sequence[int]) -> None:
    """Print the second table, one process a row."""
    table = Table(title="two_mass, 1 ms: cost over the number of impacts", box=box.SIMPLE_HEAD)
    for name in ("impacts", "processor [s]", "per impact [ms]", "memory [MB]"):
        table.add_column(name, justify="right")
    context = multiprocessing.get_context("spawn")
    for count in counts:
        with ProcessPoolExecutor(1, mp_context=context) as pool:
            impacts, seconds, memory = pool.submit(cost, count).result()
        each = f"{seconds / impacts * 1e3:.2f}"
        table.add_row(f"{impacts}", f"{seconds:.1f}", each, f"{memory / 1e6:.0f}")
        console.print(f"{impacts} impacts: {seconds:.1f} s")
    console.print(table)


def cost(count: int) -> tuple[int, float, int]:
    """Impacts, processor time to smooth them (s) and the largest memory of the process (bytes)."""
    read = read_model("two_mass")
    plant = Plant(read.system, *read.initial_state(), epoch=EPOCH)
    last = EPOCH + round(count / 0.79 * NS_PER_S)  # about what two_mass makes in a second
    run = simulate(plant, np.array([last]))
    sensor = SensorModel(jitter=JITTER)
    received = simulate_sensor(sensor, read.system, run.switchings, epoch=EPOCH, last=last, seed=1)
    events = [each.event for each in received]
    before = time.process_time()
    (motion,) = smoothed_runs(read.system, events, DECLARED)
    assert motion.smoothed.is_settled, "it is a plain run"
    spent = time.process_time() - before
    return len(events), spent, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def main(argv: Sequence[str] | None = None) -> int:
    """Run both tables."""
    parser = argparse.ArgumentParser(prog="./dev bench smoothing", description=__doc__)
    parser.add_argument("--runs", type=int, default=200, help="starts of each row (default 200)")
    parser.add_argument("--models", nargs="+", choices=MODELS, default=[*MODELS])
    parser.add_argument("--sensors", nargs="+", choices=SENSORS, default=[*SENSORS])
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes")
    parser.add_argument(
        "--impacts",
        type=lambda text: [int(each) for each in text.split(",")],
        default=[100, 1000, 6000, 36000],
        help="rows of the second table (default 100,1000,6000,36000); 0 for none",
    )
    args = parser.parse_args(argv)
    console = Console()
    if args.runs:
        accuracy(console, args.runs, args.jobs, args.models, args.sensors)
    if any(args.impacts):
        growth(console, args.impacts)
    return 0


if __name__ == "__main__":
    sys.exit(main())
