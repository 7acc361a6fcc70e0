# SPDX-License-Identifier: Apache-2.0
"""How the plant's cost grows with its size: ``./dev bench bar``, ``python -m benchmarks.bar``.

A steel bar of ``n`` finite elements, clamped at one end; a force on the other one presses it
against a rigid stop without restitution, ten times a second, for ten seconds. Each time it stays
there for half of a period, so a hit is two phases, one of them with a persistent contact. The
coordinate at the stop is sampled at 100 Hz.

Making the system, which checks its matrices, and preparing both phases happen once and are counted
separately. The cost of a phase is the rest over the number of phases. These are processor times,
which other programs disturb less; the total is also given in wall time.
"""

import argparse
import json
import math
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from benchmarks.harness import Benchmark, Contest, Goal, Metrics, new_file
from impact_observer.model import Contact, Forcing, System
from impact_observer.plant import Plant, simulate
from impact_observer.stamps import from_seconds, grid
from impact_observer.states import Vector

EPOCH = 1_000_000_000
YOUNG, DENSITY, AREA, LENGTH = 210e9, 7850.0, 1e-4, 1.0
"""N/m2, kg/m3, m2, m: steel."""
RAYLEIGH = (50.0, 1e-7)
"""Damping over mass, 1/s, and over stiffness, s."""
GAP = 1e-5
"""m"""
FORCE, FREQUENCY = 4000.0, 10.0
"""N, Hz"""
SECONDS = 10.0
RATE = 100.0
"""Hz"""
SIZES = (10, 100, 1000)
LARGEST = f"n = {SIZES[-1]}"


@dataclass(frozen=True, slots=True)
class BarCost:
    """The cost of a run.

    Attributes:
        n: elements.
        impacts: hits.
        phases: between changes of the contact.
        making: of the system, processor time, s.
        preparing: until the first hit, when both phases are prepared, processor time, s.
        running: from the first hit to the end, processor time, s.
        wall: all of it, wall time, s.
    """

    n: int
    impacts: int
    phases: int
    making: float
    preparing: float
    running: float
    wall: float

    @property
    def total(self) -> float:
        """All of it, processor time, s."""
        return self.making + self.preparing + self.running

    @property
    def phase(self) -> float:
        """One phase, processor time, s."""
        return self.running / self.phases

    def __str__(self) -> str:
        """One line."""
        return (
            f"n = {self.n}: {self.impacts} hits, {self.phases} phases of"
            f" {1e3 * self.phase:.1f} ms; system {self.making:.2f} s, preparing"
            f" {self.preparing:.2f} s, running {self.running:.2f} s,"
            f" in all {self.total:.2f} s ({self.wall:.2f} s by the clock)"
        )


def bar(n: int) -> System:
    """The bar, its coordinates from the clamped end to the free one."""
    h = LENGTH / n
    ends = np.ones(n)
    ends[-1] = 0.5  # one element only
    beside = np.eye(n, k=1) + np.eye(n, k=-1)
    K = YOUNG * AREA / h * (2 * np.diag(ends) - beside)
    M = DENSITY * AREA * h / 6 * (4 * np.diag(ends) + beside)
    last = np.eye(n)[-1]
    frequency = np.array([2 * math.pi * FREQUENCY])
    force = Forcing(np.zeros(n), frequency, np.zeros((1, n)), FORCE * last[None])
    stop = Contact("stop", -last, GAP, 0.0)
    names = tuple(f"x{i + 1}" for i in range(n))
    return System("bar", names, M, RAYLEIGH[0] * M + RAYLEIGH[1] * K, K, force, (stop,))


def run(n: int) -> tuple[Vector, BarCost]:
    """The coordinate at the stop, shape (samples,), m, and the cost of the run."""
    stamps = grid(EPOCH, EPOCH + from_seconds(SECONDS), RATE)
    wall, times = time.perf_counter(), [time.process_time()]
    system = bar(n)
    times.append(time.process_time())
    plant = Plant(system, np.zeros(n), np.zeros(n), epoch=EPOCH)
    first = plant.next_switching(int(stamps[1]))
    assert first is not None, "it hits before the second sample"
    plant.cross(first)
    times.append(time.process_time())
    found = simulate(plant, stamps[1:])
    times.append(time.process_time())
    at_stop = np.concatenate([[0.0], found.states[:, n - 1]])
    hits, phases = 1 + len(found.impacts), 1 + len(found.switchings)
    making, preparing, running = np.diff(times).tolist()
    wall = time.perf_counter() - wall
    return at_stop, BarCost(n, hits, phases, making, preparing, running, wall)


def growth(costs: list[BarCost]) -> float:
    """The exponent ``p`` of a phase's cost ``~ n^p``, by least squares."""
    sizes, phases = np.log([(cost.n, cost.phase) for cost in costs]).T
    return float(np.polyfit(sizes, phases, 1)[0])


def prepare(_: Path) -> Contest:
    """Nothing to prepare: a run of the large bar is too long for a second one."""

    def ours(_: Path) -> Metrics:
        costs = [run(n)[1] for n in SIZES]
        return {"exponent": growth(costs), LARGEST: costs[-1].total}

    sizes = ", ".join(map(str, SIZES))
    work = f"steel bars of {sizes} elements, 100 hits each; a phase costs n to the exponent"
    return Contest(work, ours, units={"exponent": "", LARGEST: "s"})


BENCHMARK = Benchmark(
    "bar",
    "how does a plant's cost grow with its coordinates?",
    prepare,
    (Goal(1.2, metric="exponent"), Goal(3.0, metric=LARGEST)),
    rounds=1,
)


def main() -> None:
    """Print the cost of each size, and its growth."""
    parser = argparse.ArgumentParser(prog="./dev bench bar", description=__doc__)
    parser.add_argument("sizes", nargs="*", type=int, default=SIZES, metavar="N")
    parser.add_argument("--json", type=new_file, metavar="FILE", help="write every metric to FILE")
    given = parser.parse_args()
    if any(n < 1 for n in given.sizes):
        parser.error(f"{min(given.sizes)} elements; expected 1 or more")
    costs = []
    for n in given.sizes:
        costs.append(run(n)[1])
        print(costs[-1], flush=True)
    metrics: dict[str, object] = {"bars": [asdict(c) | {"total": c.total} for c in costs]}
    if len(set(given.sizes)) > 1:
        metrics["growth"] = growth(costs)
        print(f"a phase grows as n^{metrics['growth']:.2f}")
    if given.json:
        given.json.write_text(json.dumps(metrics, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
