# SPDX-License-Identifier: Apache-2.0
"""A beam of finite elements at a stop: its whole shape from the instants at which its tip hits.

A steel beam is clamped at one end and pushed in the middle; its tip rattles at a stop, in bursts
of hits that end in contact. Eight elements of Euler and Bernoulli give sixteen coordinates. The
system is made of matrices, as a finite element program exports them. The observer knows the force
and the hits, and begins with a straight beam at rest; the true one is bent.

    python examples/beam.py
"""

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np

from impact_observer import Options, Plant, System, grid, make_observer, replay, simulate
from impact_observer.dynamics.lyapunov import distance
from impact_observer.model import Contact, Forcing
from impact_observer.stamps import NS_PER_S, from_seconds
from impact_observer.states import Estimate, Vector

ELEMENTS = 8
LENGTH, WIDTH, THICKNESS = 0.5, 0.03, 0.003
"""Of the beam, m."""
YOUNG, DENSITY = 210e9, 7850.0
"""Of steel, N/m^2 and kg/m^3."""
RAYLEIGH = 2.0, 2e-5
"""Damping over mass, 1/s, and over stiffness, s."""
FORCE, FREQUENCY = 6.0, 100.0
"""N and rad/s"""
GAP, RESTITUTION = 0.001, 0.6
BENT = -8.0
"""Force at the tip that bends the beam at first, N."""
RATE = 2000.0
"""Of the samples, Hz."""
SHOWN_TRUE = {"color": "0.6", "linewidth": 4.0}
SHOWN_ESTIMATE = {"color": "#D55E00", "linewidth": 1.0}


def beam() -> System:
    """The beam; coordinates are deflection and angle of each node but the clamped one."""
    h, area = LENGTH / ELEMENTS, WIDTH * THICKNESS
    bending = YOUNG * WIDTH * THICKNESS**3 / 12 / h**3
    k = bending * np.array(
        [
            [12, 6 * h, -12, 6 * h],
            [6 * h, 4 * h**2, -6 * h, 2 * h**2],
            [-12, -6 * h, 12, -6 * h],
            [6 * h, 2 * h**2, -6 * h, 4 * h**2],
        ]
    )
    m = (DENSITY * area * h / 420) * np.array(
        [
            [156, 22 * h, 54, -13 * h],
            [22 * h, 4 * h**2, 13 * h, -3 * h**2],
            [54, 13 * h, 156, -22 * h],
            [-13 * h, -3 * h**2, -22 * h, 4 * h**2],
        ]
    )
    M, K = (np.zeros((2 * ELEMENTS + 2,) * 2) for _ in range(2))
    for e in range(ELEMENTS):
        at = slice(2 * e, 2 * e + 4)
        M[at, at] += m
        K[at, at] += k
    M, K = M[2:, 2:], K[2:, 2:]
    one = np.eye(2 * ELEMENTS)
    force = FORCE * one[ELEMENTS - 2]  # on the node in the middle
    frequency, nothing = np.array([FREQUENCY]), np.zeros(2 * ELEMENTS)
    return System(
        "beam",
        tuple(f"{name}{node}" for node in range(1, ELEMENTS + 1) for name in ("w", "a")),
        M,
        RAYLEIGH[0] * M + RAYLEIGH[1] * K,
        K,
        Forcing(nothing, frequency, nothing[None], force[None]),
        (Contact("stop", -one[-2], GAP, RESTITUTION),),
    )


class Vibrated(NamedTuple):
    """A run of the beam.

    Attributes:
        times: s, shape (samples,).
        truth, estimates: states (q, u), shape (samples, 4 ELEMENTS).
        distances: V between them, J, shape (samples,).
        events: number of changes of the contact.
    """

    times: Vector
    truth: Vector
    estimates: Vector
    distances: Vector
    events: int


def vibrate(seconds: float) -> Vibrated:
    """Simulate the beam, and observe it with the law ``geometric``."""
    system, epoch = beam(), NS_PER_S
    bent = np.linalg.solve(system.K, BENT * np.eye(system.n)[-2])
    plant = Plant(system, bent, np.zeros(system.n), epoch=epoch)
    run = simulate(plant, grid(epoch, epoch + from_seconds(seconds), RATE))
    observer = make_observer(system, Options("geometric", epoch=epoch, ensemble=1))
    items = replay(observer, run.events, run.stamps)
    found = [each for each in items if isinstance(each, Estimate)]
    estimates = np.array([np.concatenate([each.q, each.u]) for each in found])
    q, u = np.split(estimates - run.states, 2, axis=1)
    times = (run.stamps - epoch) / NS_PER_S
    return Vibrated(times, run.states, estimates, distance(system, q, u), len(run.events))


def picture(found: Vibrated, path: Path) -> None:
    """Shapes at some instants, and the distance of the estimate."""
    from matplotlib.figure import Figure

    from impact_observer.draw.pictures import save

    figure = Figure(figsize=(7, 4.5), layout="constrained")
    above, below = figure.subplots(2)
    x = np.linspace(0.0, LENGTH, ELEMENTS + 1)
    for shown, at in enumerate((0.0, 0.01, 0.02, 0.05, 0.1, 0.2)):
        k = int(np.searchsorted(found.times, at))
        for states, style in ((found.truth, SHOWN_TRUE), (found.estimates, SHOWN_ESTIMATE)):
            shape = np.concatenate([[0.0], states[k, : 2 * ELEMENTS : 2]])
            above.plot(x + shown * 1.1 * LENGTH, 1e3 * shape, **style)
        above.annotate(f"{1e3 * at:g} ms", (shown * 1.1 * LENGTH, 12), fontsize="small")
    above.set(ylabel="deflection [mm]", xticks=[], ylim=(-27, 18))
    below.semilogy(found.times, found.distances, color="black", linewidth=1)
    below.set(xlabel="time [s]", ylabel="V [J]")
    save(figure, path)


def main() -> None:
    """Print and draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=1.5)
    parser.add_argument("-o", "--output", type=Path, default=Path("beam.png"))
    args = parser.parse_args()
    found = vibrate(args.seconds)
    print(f"{found.events} changes of the contact in {args.seconds:g} s")
    print(f"V: {found.distances[0]:.2g} J at first, {found.distances[-1]:.2g} J at the end")
    picture(found, args.output)
    print(f"picture: {args.output}")


if __name__ == "__main__":
    main()
