# SPDX-License-Identifier: Apache-2.0
"""A ball's drop height, and its restitution, from nothing but the times at which it bounces.

A phone records the clicks of a ball that falls on a floor; nobody saw from where. Between bounces
it flies freely, so the times determine the speed at the first bounce and the restitution, and the
speed gives the height.

    python examples/drop_height.py
    python examples/drop_height.py 1.201 2.032 2.714 3.273    # clicks of your own, s
"""

import argparse
from math import sqrt
from pathlib import Path
from typing import NamedTuple

import numpy as np

from impact_observer import Plant, grid, parse_model, simulate
from impact_observer.batch.identification import identify
from impact_observer.events import ImpactEvent, Switch
from impact_observer.model.free_parameters import parametric_family
from impact_observer.stamps import NS_PER_S, from_seconds

GRAVITY = 9.81
MODEL = f"""\
name: ball
bodies: [{{name: height, mass: 0.05}}]
forces: [{{body: height, constant: {-0.05 * GRAVITY}}}]
stops:  [{{name: floor, body: height, limit: 0, side: below, restitution: 0.7}}]
"""
CLICKS = (1.2010, 2.0236, 2.6981, 3.2512, 3.7048, 4.0767, 4.3816, 4.6317)
"""Of a ball that fell from 1.234 m with a restitution of 0.82, read to 0.1 ms."""
BEFORE = 0.05
"""Where the motion begins that is looked for: so long before the first click, s."""


class Drop(NamedTuple):
    """What the clicks say, with standard errors.

    Attributes:
        height, height_error: from which it fell, m.
        restitution, restitution_error: of floor and ball.
    """

    height: float
    height_error: float
    restitution: float
    restitution_error: float


def drop(clicks: tuple[float, ...], clock: float = 1e-4) -> Drop:
    """Height and restitution of a ball, from ``clicks`` (s) with errors of ``clock`` (s)."""
    epoch = NS_PER_S + from_seconds(clicks[0] - BEFORE)
    events = [
        ImpactEvent(NS_PER_S + from_seconds(click), (Switch("floor"),), number, epoch=epoch)
        for number, click in enumerate(clicks, 1)
    ]
    model = parse_model(MODEL, "ball")
    family = parametric_family(model.system, ("restitution",), model.elements)
    found = identify(family, events, clock=clock, trust_events=True)
    q, u = found.start.tolist()
    height = q + u**2 / (2 * GRAVITY)  # where it was at rest, before the first click
    slope = np.array([1.0, u / GRAVITY, 0.0])
    return Drop(
        height,
        float(np.sqrt(slope @ found.covariance @ slope)),
        float(found.values[0]),
        float(found.errors[0]),
    )


def picture(clicks: tuple[float, ...], found: Drop, path: Path) -> None:
    """The motion that was found, with the clicks."""
    from matplotlib.figure import Figure

    from impact_observer.draw.pictures import save

    model = parse_model(MODEL.replace("0.7}", f"{found.restitution}}}"), "ball")
    fall = clicks[0] - sqrt(2 * found.height / GRAVITY)
    epoch = NS_PER_S
    plant = Plant(model.system, np.array([found.height]), np.zeros(1), epoch=epoch)
    run = simulate(plant, grid(epoch, epoch + from_seconds(clicks[-1] - fall + 0.1), 500.0))
    figure = Figure(figsize=(6.5, 3.2), layout="constrained")
    axes = figure.add_subplot()
    axes.plot(fall + (run.stamps - epoch) / NS_PER_S, run.states[:, 0], color="black")
    axes.plot(clicks, np.zeros(len(clicks)), "^", color="#D55E00", label="clicks")
    axes.axhline(found.height, color="0.6", linestyle=":")
    axes.set(xlabel="time [s]", ylabel="height [m]")
    axes.legend(frameon=False)
    save(figure, path)


def main() -> None:
    """Print and draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("clicks", type=float, nargs="*", help="s, at least four")
    parser.add_argument(
        "--clock", type=float, default=1e-4, help="error of a click, s (default %(default)g)"
    )
    parser.add_argument("-o", "--output", type=Path, default=Path("drop_height.png"))
    args = parser.parse_args()
    clicks = tuple(args.clicks) or CLICKS
    found = drop(clicks, args.clock)
    print(f"drop height {found.height:.4f} +- {found.height_error:.4f} m")
    print(f"restitution {found.restitution:.5f} +- {found.restitution_error:.5f}")
    picture(clicks, found, args.output)
    print(f"picture: {args.output}")


if __name__ == "__main__":
    main()
