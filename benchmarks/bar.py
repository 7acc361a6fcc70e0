"""How the plant's cost grows with its size: ``python -m benchmarks.bar [N...]``.

A steel bar of ``n`` finite elements, clamped at one end; a harmonic force at the other one drives
it against a rigid stop without restitution about a hundred times. It rests there for a while and
leaves: each hit is two phases, one of them with a held contact.
"""

import argparse
import math
import time

import numpy as np

from impact_observer.model import Contact, Forcing, System
from impact_observer.plant import Plant, Run, simulate
from impact_observer.stamps import from_seconds, grid

EPOCH = 1_000_000_000
YOUNG, DENSITY, AREA, LENGTH = 210e9, 7850.0, 1e-4, 1.0
"""N/m2, kg/m3, m2, m."""
RAYLEIGH = (50.0, 1e-7)
"""Damping over mass, 1/s, and over stiffness, s."""
GAP = 1e-5
"""m"""
FORCE = 4000.0
"""N"""
HITS = 100
RATE = 100.0
"""Hz"""


def bar(n: int) -> System:
    """The bar, its coordinates from the clamped end to the free one."""
    h = LENGTH / n
    ends = np.ones(n)
    ends[-1] = 0.5  # of one element only
    beside = np.eye(n, k=1) + np.eye(n, k=-1)
    K = YOUNG * AREA / h * (2 * np.diag(ends) - beside)
    M = DENSITY * AREA * h / 6 * (4 * np.diag(ends) + beside)
    frequency = 0.8 * math.pi / 2 * math.sqrt(YOUNG / DENSITY) / LENGTH
    last = np.eye(n)[-1]
    force = Forcing(np.zeros(n), np.array([frequency]), np.zeros((1, n)), FORCE * last[None])
    stop = Contact("stop", -last, GAP, 0.0)
    names = tuple(f"x{i + 1}" for i in range(n))
    return System("bar", names, M, RAYLEIGH[0] * M + RAYLEIGH[1] * K, K, force, (stop,))


def run(system: System) -> tuple[Run, float, float]:
    """A run of about ``HITS`` hits; seconds to prepare it and seconds that it takes."""
    n = system.n
    period = 2 * math.pi / float(system.forcing.frequency[0])
    stamps = grid(EPOCH, EPOCH + from_seconds(HITS * period), RATE)
    begin = time.process_time()
    plant = Plant(system, np.zeros(n), np.zeros(n), epoch=EPOCH)
    plant.next_switching(EPOCH)
    prepared = time.process_time()
    found = simulate(plant, stamps)
    return found, prepared - begin, time.process_time() - prepared


def main() -> None:
    """Print what each size costs, and how that grows."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.bar", description=__doc__)
    parser.add_argument("sizes", nargs="*", type=int, default=[10, 100, 1000], metavar="N")
    before: tuple[int, float] | None = None
    for n in parser.parse_args().sizes:
        found, preparing, running = run(bar(n))
        phases = len(found.switchings) + 1
        each = running / phases
        line = f"n = {n}: {len(found.impacts)} impacts, {phases} phases;"
        line += (
            f" prepared in {preparing:.3f} s, run in {running:.3f} s, {1e3 * each:.3f} ms a phase"
        )
        if before is not None:
            exponent = math.log(each / before[1]) / math.log(n / before[0])
            line += f", growing as n^{exponent:.2f}"
        print(line)
        before = n, each


if __name__ == "__main__":
    main()
