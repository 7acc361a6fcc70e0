# SPDX-License-Identifier: Apache-2.0
"""A vibro-impact drill: the energy of every blow, from a microphone that misses some.

An exciter drives a housing; the bit hangs in it on a spring and hits the rock, hard and softly in
turns. A sensor that is 50 us uncertain reports the blows. It misses one in ten and reports two
false ones a second. The observer estimates all motion, and so the energy that each blow had.

    python examples/drill.py
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
name: drill
bodies:  [{name: housing, mass: 5}, {name: bit, mass: 1}]
springs:
  - {between: [ground, housing], stiffness: 2.0e+4, damping: 60}
  - {between: [housing, bit], stiffness: 2.0e+4, damping: 20}
forces:  [{body: housing, amplitude: 400, frequency: 140}]
stops:   [{name: rock, body: bit, limit: 0.008, side: above, restitution: 0.5}]
initial_state: {position: [0, 0], velocity: [0, 0]}
"""
SENSOR = SensorModel(jitter=50e-6, missed=0.1, spurious=2.0)
GUESS = "0.005,-0.005,1,-1"
"""What the observer starts from: the drill starts at rest."""
UNCERTAIN = "0.01,0.01,1,1"
"""Its standard deviations, m and m/s."""
RATE = 2000.0
"""Of the samples, Hz."""


class Drilled(NamedTuple):
    """A run of the drill.

    Attributes:
        times: s, shape (samples,).
        truth, estimates, deviations: of the states (q, u), shape (samples, 4), m and m/s.
        blow_times: s, shape (blows,).
        blows: energy of the bit before each blow, true and estimated, J, shape (blows, 2).
    """

    times: Vector
    truth: Vector
    estimates: Vector
    deviations: Vector
    blow_times: Vector
    blows: Vector


def drill(seconds: float, seed: int = 1) -> Drilled:
    """Simulate drill and sensor, and observe."""
    model = parse_model(MODEL, "drill")
    system, epoch = model.system, NS_PER_S
    plant = Plant(system, *model.initial_state(), epoch=epoch)
    run = simulate(plant, grid(epoch, epoch + from_seconds(seconds), RATE))
    last = int(run.stamps[-1])
    sent = simulate_sensor(SENSOR, system, run.switchings, epoch=epoch, last=last, seed=seed)
    options = Options("minimum-variance", GUESS, initial_deviation=UNCERTAIN, epoch=epoch)
    observer = make_observer(system, options)
    items = replay(observer, [each.event for each in sent], run.stamps)
    found = [each for each in items if isinstance(each, Estimate)]
    estimates = np.array([np.concatenate([each.q, each.u]) for each in found])
    blows = np.array([each.instant.stamp for each in run.impacts])
    before = np.searchsorted(run.stamps, blows) - 2  # a sample that both have before the blow
    speeds = np.column_stack([run.states[before, 3], estimates[before, 3]])
    return Drilled(
        times=(run.stamps - epoch) / NS_PER_S,
        truth=run.states,
        estimates=estimates,
        deviations=np.array([np.sqrt(np.diag(each.covariance)) for each in found]),
        blow_times=(blows - epoch) / NS_PER_S,
        blows=speeds**2 / 2,  # of a bit of 1 kg
    )


def picture(found: Drilled, path: Path) -> None:
    """The bit at first, and the energy of all blows."""
    from matplotlib.figure import Figure

    from impact_observer.draw.pictures import save

    figure = Figure(figsize=(7, 5), layout="constrained")
    above, below = figure.subplots(2)
    part = found.times < 0.6
    times, bit = found.times[part], 1e3 * found.estimates[part, 1]
    band = 2e3 * found.deviations[part, 1]
    above.plot(times, 1e3 * found.truth[part, 1], color="0.6", linewidth=3, label="true")
    above.plot(times, bit, color="#D55E00", linewidth=1, label="estimated")
    above.fill_between(times, bit - band, bit + band, color="#D55E00", alpha=0.2, linewidth=0)
    above.set(xlabel="time [s]", ylabel="bit [mm]", ylim=(-40, 20))
    above.legend(frameon=False, ncols=2)
    below.plot(found.blow_times, found.blows[:, 0], "o", color="0.6", markersize=8)
    below.plot(found.blow_times, found.blows[:, 1], ".", color="#D55E00")
    below.set(xlabel="time [s]", ylabel="energy of a blow [J]")
    save(figure, path)


def main() -> None:
    """Print and draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=3.0)
    parser.add_argument("-o", "--output", type=Path, default=Path("drill.png"))
    args = parser.parse_args()
    found = drill(args.seconds)
    late = found.blow_times > args.seconds / 2
    true, estimated = found.blows[late].T
    print(f"blows in the second half: {late.sum()}, of {true.min():.2f} to {true.max():.2f} J")
    print(f"error of their estimated energies: {np.abs(estimated / true - 1).max():.2%} at most")
    picture(found, args.output)
    print(f"picture: {args.output}")


if __name__ == "__main__":
    main()
