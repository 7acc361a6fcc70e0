# SPDX-License-Identifier: Apache-2.0
"""A shaker table: how a part moves inside its housing, and how late the sensor's clock is.

A housing stands on a table that is shaken; a part inside hangs on a soft spring and hits the
housing. A contact wire reports the hits, stamped by a clock of its own that is 3 ms ahead of that
of the shaker. The table's motion is known, so the observer can find the offset of the clocks too.

    python examples/shaker.py
"""

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np

from impact_observer import Options, Plant, grid, make_observer, parse_model, replay, simulate
from impact_observer.plant import SensorModel, simulate_sensor
from impact_observer.stamps import NS_PER_S, from_seconds
from impact_observer.states import Estimate, Vector

MODEL = """\
name: shaker
bodies:  [{name: housing, mass: 2}, {name: part, mass: 0.3}]
grounds: [{name: table, motion: {harmonics: [{amplitude: 0.003, frequency: 75}]}}]
springs:
  - {between: [table, housing], stiffness: 4.0e+4, damping: 30}
  - {between: [housing, part], stiffness: 600, damping: 0.5}
stops:   [{name: wire, between: [housing, part], gap: 0.004, restitution: 0.6}]
initial_state: {position: [0.003, 0.003], velocity: [0, 0]}
"""
OFFSET = 0.003
"""How far the sensor's clock is ahead, s."""
SENSOR = SensorModel(clock_offset=OFFSET, jitter=20e-6)
RATE = 2000.0
"""Of the samples, Hz."""


class Shaken(NamedTuple):
    """A run of the shaker.

    Attributes:
        times: s, shape (samples,).
        truth, estimates: of the part relative to the housing, m, shape (samples,).
        offsets: of the clock, estimated, s, shape (samples,).
        hits: s, shape (hits,).
    """

    times: Vector
    truth: Vector
    estimates: Vector
    offsets: Vector
    hits: Vector

    def error(self) -> float:
        """Of the position in the second half, m rms, farther from hits than 5 ms.

        Between the instant of a hit and its stamp the estimate knows nothing of it.
        """
        distances = np.abs(self.times[:, None] - self.hits).min(axis=1)
        part = (self.times > self.times[-1] / 2) & (distances > 5e-3)
        return float(np.sqrt(np.mean((self.estimates - self.truth)[part] ** 2)))


def shake(seconds: float, seed: int = 1) -> Shaken:
    """Simulate shaker and sensor, and observe."""
    model = parse_model(MODEL, "shaker")
    epoch = NS_PER_S
    plant = Plant(model.system, *model.initial_state(), epoch=epoch)
    run = simulate(plant, grid(epoch, epoch + from_seconds(seconds), RATE))
    last = int(run.stamps[-1])
    sent = simulate_sensor(SENSOR, model.system, run.switchings, epoch=epoch, last=last, seed=seed)
    options = Options(
        "minimum-variance",
        initial_deviation="0.005,0.005,0.5,0.5",
        clock_offset_error=0.005,
        epoch=epoch,
    )
    observer = make_observer(model.system, options)
    items = replay(observer, [each.event for each in sent], run.stamps)
    found = [each for each in items if isinstance(each, Estimate)]
    return Shaken(
        (run.stamps - epoch) / NS_PER_S,
        run.states[:, 1] - run.states[:, 0],
        np.array([each.q[1] - each.q[0] for each in found]),
        np.array([each.clock_offset for each in found]),
        (np.array([each.stamp for each in run.events]) - epoch) / NS_PER_S,
    )


def picture(found: Shaken, path: Path) -> None:
    """The part in its housing, and the clock."""
    from matplotlib.figure import Figure

    from impact_observer.draw.pictures import save

    figure = Figure(figsize=(7, 4.5), layout="constrained")
    above, below = figure.subplots(2, sharex=True)
    above.plot(found.times, 1e3 * found.truth, color="0.6", linewidth=3, label="true")
    above.plot(found.times, 1e3 * found.estimates, color="#D55E00", lw=1, label="estimated")
    above.set(ylabel="part in housing [mm]")
    above.legend(frameon=False, ncols=2)
    below.plot(found.times, 1e3 * found.offsets, color="#D55E00", lw=1)
    below.axhline(1e3 * OFFSET, color="0.6", linewidth=3, zorder=0)
    below.set(
        xlabel="time [s]", ylabel="offset of the clock [ms]", xlim=(0, min(found.times[-1], 2))
    )
    save(figure, path)


def main() -> None:
    """Print and draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=3.0)
    parser.add_argument("-o", "--output", type=Path, default=Path("shaker.png"))
    args = parser.parse_args()
    found = shake(args.seconds)
    print(f"error of the part's position in the second half: {1e6 * found.error():.1f} um rms")
    print(f"offset of the clock: {1e3 * found.offsets[-1]:.3f} ms; {1e3 * OFFSET:g} ms is true")
    picture(found, args.output)
    print(f"picture: {args.output}")


if __name__ == "__main__":
    main()
