# SPDX-License-Identifier: Apache-2.0
"""How exact ``minimum-variance`` is where impacts accumulate: ``./dev bench chatter``.

A table, without timing: a drill of three masses with two stops, and ten random chains that a
constant force presses on their stops. Impacts accumulate and contacts persist in every period. The
sensor is ideal unless options say otherwise, stamps are rounded to 1 ns, all options but the law
are defaults. The observer starts at zero, the plant at a state that is drawn. The figures of a run
are the largest V and the median V over the initial V from 5 s on, farther from any impact than
5 us and five standard deviations of a stamp: nearer, plant and estimate may be on different sides
of it. Processor time is that of the observer, for each second of the rig.
"""

import argparse
import multiprocessing
import os
import statistics
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import NamedTuple

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.impacts import energy
from impact_observer.errors import UsageError
from impact_observer.events import Kind
from impact_observer.model import Contact, Forcing, System, parse_model
from impact_observer.observer import make_observer, replay
from impact_observer.options import Options
from impact_observer.plant import Plant, Run, simulate
from impact_observer.plant.sensor import SensorModel, simulate_sensor
from impact_observer.stamps import NS_PER_S, from_seconds, grid
from impact_observer.states import Estimate, Vector

DRILL = """
name: drill
bodies: [{name: motor, mass: 2}, {name: rod, mass: 1}, {name: bit, mass: 0.5}]
springs:
  - {between: [ground, motor], stiffness: 30, damping: 0.6}
  - {between: [motor, rod], stiffness: 60, damping: 0.4}
  - {between: [rod, bit], stiffness: 60, damping: 0.2}
forces:
  - {body: bit, constant: 4}
  - {body: motor, amplitude: 12, frequency: 2.2}
stops:
  - {name: rock, body: bit, limit: 0.05, side: above, restitution: 0.6}
  - {name: collar, body: rod, limit: -0.08, side: below, restitution: 0.4}
"""
RANDOM = 10
EPOCH = 5 * NS_PER_S
RATE = 20.0
SETTLED = 5.0
"""From when on V counts, s."""
_BESIDE = 5_000
"""Distance from an impact at which V is read, ns."""


class Outcome(NamedTuple):
    """One run.

    Attributes:
        events: how many were sent.
        closes: how many of them closed a contact for longer.
        ratio: the largest V over the initial V that counts.
        usual: the median of those.
        cost: processor time of the observer for each second.
    """

    events: int
    closes: int
    ratio: float
    usual: float
    cost: float


class Job(NamedTuple):
    """A run of a system.

    Attributes:
        number: of the system.
        seed: of its start and of the sensor's faults.
        seconds: how long.
        sensor: what reports its impacts.
    """

    number: int
    seed: int
    seconds: float
    sensor: SensorModel


def system_of(number: int) -> System:
    """The drill, number 0, or a random chain of 2 to 4 masses pressed on its stops."""
    if not number:
        return parse_model(DRILL, "drill").system
    rng = np.random.default_rng([2014, number])
    n = int(rng.integers(2, 5))
    springs, dampers = rng.uniform(20.0, 80.0, n), rng.uniform(0.1, 0.8, n)
    stretched = np.eye(n) - np.eye(n, k=-1)  # of each spring by each coordinate
    directions = [np.eye(n)[-1]]
    if n > 2 or rng.random() < 0.5:
        directions.append(np.eye(n)[int(rng.integers(n - 1))])
    contacts = tuple(
        Contact(f"stop{i}", sign * w, rng.uniform(0.02, 0.1), rng.uniform(0.2, 0.7))
        for i, (w, sign) in enumerate(zip(directions, (-1.0, 1.0), strict=False))
    )
    press = np.sum([-each.direction * rng.uniform(2.0, 6.0) for each in contacts], axis=0)
    harmonic = np.zeros((1, n))
    harmonic[0, int(rng.integers(n))] = rng.uniform(8.0, 16.0)
    forcing = Forcing(press, rng.uniform(1.0, 3.0, 1), harmonic, np.zeros((1, n)))
    return System(
        f"random{number}",
        tuple(f"x{i + 1}" for i in range(n)),
        np.diag(rng.uniform(0.5, 2.0, n)),
        stretched.T @ np.diag(dampers) @ stretched,
        stretched.T @ np.diag(springs) @ stretched,
        forcing,
        contacts,
    )


def start_of(system: System, seed: int) -> Vector:
    """A state of the plant inside no stop, shape (2n,)."""
    rng = np.random.default_rng(seed)
    while True:
        x: Vector = rng.normal(size=2 * system.n) * np.repeat([0.1, 0.7], system.n)
        if np.all(system.gap(x[: system.n]) > 0.0):
            return x


def simulated(system: System, seed: int, seconds: float) -> Run:
    """A run of the plant."""
    stamps = grid(EPOCH, EPOCH + from_seconds(seconds), RATE)[1:]
    return simulate(Plant(system, *np.split(start_of(system, seed), 2), epoch=EPOCH), stamps)


def outcome(job: Job) -> Outcome:
    """One run of a system."""
    number, seed, seconds, sensor = job
    system, last = system_of(number), EPOCH + from_seconds(seconds)
    run = simulated(system, seed, seconds)
    sent = simulate_sensor(sensor, system, run.switchings, epoch=EPOCH, last=last, seed=seed)
    events = [each.event for each in sent]
    observer = make_observer(system, Options(law="minimum-variance"))
    begin = time.process_time()
    found = [*replay(observer, events, run.stamps)]
    cost = (time.process_time() - begin) / seconds
    states = [np.concatenate([each.q, each.u]) for each in found if isinstance(each, Estimate)]
    V = energy(system, np.array(states) - run.states)
    impacts = np.array([each.instant.stamp for each in run.impacts])
    beside = _BESIDE + from_seconds(5 * sensor.jitter)
    clear = np.min(np.abs(run.stamps[:, None] - impacts), axis=1, initial=NS_PER_S) > beside
    counted = clear & (run.stamps >= EPOCH + from_seconds(SETTLED))
    kinds = [switch.kind for each in events for switch in each.switches]
    ratios = V[counted] / float(energy(system, start_of(system, seed)))
    largest, usual = float(np.max(ratios)), float(np.median(ratios))
    return Outcome(len(events), kinds.count(Kind.CLOSE), largest, usual, cost)


def print_table(names: Sequence[str], groups: Sequence[Sequence[Outcome]]) -> None:
    """A row for each system; all but the worst are medians of its runs, processor times means."""
    table = Table(box=box.SIMPLE_HEAD, title="V/V0 from 5 s on", title_justify="left")
    table.add_column("system")
    for heading in ("events", "closes", "usual", "largest", "worst", "processor s/s"):
        table.add_column(heading, justify="right")
    everything = [each for group in groups for each in group]
    for name, group in zip((*names, "all"), (*groups, everything), strict=True):
        columns = zip(*group, strict=True)
        events, closes, largest, usual, _ = (statistics.median(each) for each in columns)
        worst, cost = max(each.ratio for each in group), statistics.mean(e.cost for e in group)
        ratios = (f"{each:.0e}" for each in (usual, largest, worst))
        table.add_row(name, f"{events:.0f}", f"{closes:.0f}", *ratios, f"{cost:.3f}")
    Console().print(table)


def main(args: Sequence[str] | None = None) -> int:
    """Run all starts of all systems and print the table.

    Returns:
        0; 2 for wrong use.
    """
    parser = argparse.ArgumentParser(prog="./dev bench chatter", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--runs", type=int, default=10, metavar="N", help="a system (default 10)")
    parser.add_argument("--seconds", type=float, default=60.0, metavar="S", help="(default 60)")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, metavar="N")
    for fault, unit in (("jitter", "S"), ("missed", "P"), ("spurious", "RATE")):
        text = f"of the sensor, as of simulate (default 0, {unit})"
        parser.add_argument(f"--{fault}", type=float, default=0.0, metavar=unit, help=text)
    given = parser.parse_args(args)
    if min(given.runs, given.workers) < 1 or not given.seconds > SETTLED:
        parser.error(
            "arguments --runs, --seconds, --workers: expected at least one run and worker, and"
            f" more than {SETTLED:g} s"
        )
    try:
        sensor = SensorModel(jitter=given.jitter, missed=given.missed, spurious=given.spurious)
    except UsageError as error:
        parser.error(str(error))
    numbers = range(1 + RANDOM)
    jobs = [Job(k, seed, given.seconds, sensor) for k in numbers for seed in range(given.runs)]
    context, console = multiprocessing.get_context("spawn"), Console(stderr=True)
    with ProcessPoolExecutor(given.workers, mp_context=context) as pool:
        runs = pool.map(outcome, jobs)
        found = [*track(runs, "runs", total=len(jobs), console=console, transient=True)]
    groups = [found[i : i + given.runs] for i in range(0, len(found), given.runs)]
    print_table([system_of(k).name for k in numbers], groups)
    return 0


if __name__ == "__main__":
    sys.exit(main())
