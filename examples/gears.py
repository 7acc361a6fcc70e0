# SPDX-License-Identifier: Apache-2.0
"""A rattling gear pair: on which flank a loose gear hits, from clicks that do not say which.

The driven gear of an idle pair carries no load, so its tooth bounces between two teeth of the gear
that drives it, whose speed is never quite even. A microphone on the housing records the clicks; it
cannot tell the flanks from each other. The observer takes all clicks as those of one flank, with
a probability of one half that it was the other one, and finds out.

    python examples/gears.py
"""

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np

from impact_observer import Options, Plant, grid, make_observer, parse_model, replay, simulate
from impact_observer.events import ImpactEvent, Switch, Verdict
from impact_observer.stamps import NS_PER_S, from_seconds
from impact_observer.states import Estimate, Vector

BACKLASH = 0.002
"""Half of the play between the flanks, rad."""
DRIVE = 0.004, 100.0
"""Amplitude of the unevenness of the driving gear, rad, and its frequency, rad/s."""
MODEL = f"""\
name: gears
unit: rad
bodies:  [{{name: loose, mass: 0.001}}]     # kg m^2
grounds:
  - {{name: drive, motion: {{harmonics: [{{amplitude: {DRIVE[0]}, frequency: {DRIVE[1]}}}]}}}}
springs: [{{between: [ground, loose], stiffness: 0.5, damping: 0.004}}]    # drag of the oil
stops:
  - {{name: front, between: [loose, drive], gap: {BACKLASH}, restitution: 0.7}}
  - {{name: back, between: [drive, loose], gap: {BACKLASH}, restitution: 0.7}}
initial_state: {{position: [0.0035], velocity: [0]}}
"""
JITTER = 50e-6
"""Standard deviation of the clicks, s."""
RATE = 2000.0
"""Of the samples, Hz."""


class Rattled(NamedTuple):
    """A run of the gears.

    Attributes:
        times: s, shape (samples,).
        truth, estimates: angle of the loose gear relative to the other one, rad, (samples,).
        clicks: s, shape (clicks,).
        back: whether each click was on the back flank, true and estimated, shape (clicks, 2).
    """

    times: Vector
    truth: Vector
    estimates: Vector
    clicks: Vector
    back: Vector


def rattle(seconds: float, seed: int = 1) -> Rattled:
    """Simulate gears and microphone, and observe."""
    model = parse_model(MODEL, "gears")
    epoch, rng = NS_PER_S, np.random.default_rng(seed)
    plant = Plant(model.system, *model.initial_state(), epoch=epoch)
    run = simulate(plant, grid(epoch, epoch + from_seconds(seconds), RATE))
    events = [
        ImpactEvent(
            each.stamp + round(rng.normal(scale=JITTER * NS_PER_S)),
            (Switch("front"),),  # whichever it was
            each.sequence,
            epoch=epoch,
        )
        for each in run.events
    ]
    options = Options(
        "minimum-variance",
        initial_deviation="0.004,0.4",
        clock_error=JITTER,
        mislabelled=0.5,
        epoch=epoch,
    )
    observer = make_observer(model.system, options)
    items = list(replay(observer, events, run.stamps))
    verdicts = {
        each.sequence: each for each in items if isinstance(each, Verdict)
    }  # the last ones
    angles = np.array([each.q[0] for each in items if isinstance(each, Estimate)])
    times = (run.stamps - epoch) / NS_PER_S
    drive = DRIVE[0] * np.cos(DRIVE[1] * times)
    found = [verdicts[each.sequence] for each in run.events]
    true = [each.switches[0].contact == "back" for each in run.events]
    return Rattled(
        times,
        run.states[:, 0] - drive,
        angles - drive,
        (np.array([each.stamp for each in run.events]) - epoch) / NS_PER_S,
        np.column_stack([true, [each.hit_contact == "back" for each in found]]),
    )


def picture(found: Rattled, path: Path) -> None:
    """The loose gear between its flanks, at first."""
    from matplotlib.figure import Figure

    from impact_observer.draw.pictures import save

    figure = Figure(figsize=(7, 3.2), layout="constrained")
    axes = figure.add_subplot()
    part, clicks = found.times < 0.5, found.clicks < 0.5
    axes.plot(found.times[part], 1e3 * found.truth[part], color="0.6", linewidth=3, label="true")
    axes.plot(
        found.times[part], 1e3 * found.estimates[part], color="#D55E00", lw=1, label="estimated"
    )
    flank = np.where(found.back[clicks, 1], -1, 1) * 1e3 * BACKLASH
    axes.plot(found.clicks[clicks], flank, "kx", label="clicks, on the flank that was estimated")
    axes.set(xlabel="time [s]", ylabel="relative angle [mrad]", ylim=(-6, 7.5))
    axes.legend(frameon=False, ncols=3, loc="upper right")
    save(figure, path)


def main() -> None:
    """Print and draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=3.0)
    parser.add_argument("-o", "--output", type=Path, default=Path("gears.png"))
    args = parser.parse_args()
    found = rattle(args.seconds)
    true, estimated = found.back.T
    print(f"clicks: {true.size}, {true.sum():g} of them on the back flank")
    print(f"flank estimated rightly: {np.sum(true == estimated)} of {true.size}")
    late = found.times > args.seconds / 2
    error = np.sqrt(np.mean((found.estimates - found.truth)[late] ** 2))
    print(f"error of the angle in the second half: {1e6 * error:.0f} urad rms")
    picture(found, args.output)
    print(f"picture: {args.output}")


if __name__ == "__main__":
    main()
