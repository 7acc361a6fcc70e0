# SPDX-License-Identifier: Apache-2.0
"""Basins of attraction: 10 000 starts of an oscillator at a wall, and where each one ends.

A driven oscillator that hits a wall may settle on motions of different periods. Here it repeats
itself after one period of the drive, or after three, and only the start decides. Every start is
simulated to the end with exact impacts; the picture colours it by the period that it ends with.

    python examples/basins.py                 # 100 x 100 starts, some 80 s of one core
    python examples/basins.py --starts 40     # 40 x 40
"""

import argparse
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from impact_observer import Plant, parse_model, simulate
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Vector

FREQUENCY = 2.5
MODEL = f"""\
name: oscillator
bodies:  [{{name: x, mass: 1}}]
springs: [{{between: [ground, x], stiffness: 1, damping: 0.06}}]
forces:  [{{body: x, amplitude: 1, frequency: {FREQUENCY}}}]
stops:   [{{name: wall, body: x, limit: 0.05, side: above, restitution: 0.8}}]
"""
PERIODS, MOST = 50, 6
"""Periods of the drive until the end, and the longest motion that is recognized, in periods."""
SETTLED = 0.02
"""Largest difference of states, m and m/s, that counts as none."""
COLOURS = ("#222222", "#D9D9D9", "#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9")
"""By the period; the first one is for motions that have not settled."""
POSITIONS, VELOCITIES = (-1.6, 0.04), (-2.0, 2.0)


def period(start: tuple[float, float]) -> int:
    """After how many periods of the drive the motion from ``start`` repeats itself; 0: never."""
    system = parse_model(MODEL, "oscillator").system
    plant = Plant(system, np.array(start[:1]), np.array(start[1:]), epoch=NS_PER_S)
    last = np.arange(PERIODS - MOST - 1, PERIODS + 1) * 2 * np.pi / FREQUENCY
    states = simulate(plant, NS_PER_S + np.round(last * NS_PER_S).astype(np.int64)).states
    for n in range(1, MOST + 1):
        if np.abs(states[n:] - states[:-n]).max() < SETTLED:
            return n
    return 0


def basins(side: int, jobs: int | None = None) -> Vector:
    """Periods of ``side`` x ``side`` starts, rows by velocity; ``jobs`` processes at once."""
    positions, velocities = np.linspace(*POSITIONS, side), np.linspace(*VELOCITIES, side)
    starts = [(float(q), float(u)) for u in velocities for q in positions]
    if jobs == 1:
        found = list(map(period, starts))
    else:
        with ProcessPoolExecutor(jobs) as pool:
            found = list(pool.map(period, starts, chunksize=50))
    return np.reshape(np.array(found, dtype=float), (side, side))


def picture(found: Vector, path: Path) -> None:
    """Each start in the colour of the period that it ends with."""
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure

    from impact_observer.draw.pictures import save

    periods = sorted({int(each) for each in found.flat})
    numbers = np.searchsorted(periods, found)
    figure = Figure(figsize=(5.5, 4.5), layout="constrained")
    axes = figure.add_subplot()
    axes.imshow(
        numbers,
        origin="lower",
        aspect="auto",
        extent=(*POSITIONS, *VELOCITIES),
        cmap=ListedColormap([COLOURS[each] for each in periods]),
    )
    for each in periods:
        label = f"period {each}" if each else "not settled"
        axes.plot([], [], "s", color=COLOURS[each], label=label)
    figure.legend(loc="outside upper center", ncols=len(periods), frameon=False)
    axes.set_xlabel("position at the start [m]")
    axes.set_ylabel("velocity at the start [m/s]")
    save(figure, path)


def main() -> None:
    """Simulate, count and draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, default=100, help="in each direction")
    parser.add_argument("--jobs", type=int, help="processes at once (default: one a core)")
    parser.add_argument("-o", "--output", type=Path, default=Path("basins.png"))
    args = parser.parse_args()
    found = basins(args.starts, args.jobs)
    for each in np.unique(found):
        name = f"period {each:g}" if each else "not settled"
        print(f"{name}: {np.mean(found == each):.1%} of {found.size} starts")
    picture(found, args.output)
    print(f"picture: {args.output}")


if __name__ == "__main__":
    main()
