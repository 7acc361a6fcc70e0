# SPDX-License-Identifier: Apache-2.0
"""An encoder and impacts together: what each of them knows of a hammer, and what both know.

A carriage hangs on a spring, a hammer hangs on the carriage and hits an anvil. A coarse encoder
measures the carriage, ten times a second, to 5 cm; a switch that is 1 ms uncertain reports the
hits, and misses one in five. The impacts alone need six seconds to determine the state. The
encoder alone has not done it after ten. Both together need two.

    python examples/encoder.py
"""

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np

from impact_observer import Options, Plant, grid, make_observer, parse_model, simulate
from impact_observer.events import ImpactEvent
from impact_observer.model.measurement import parse_measurements
from impact_observer.observer.replay import replay_batches
from impact_observer.observer.samples import SensorSample
from impact_observer.plant import SensorModel, simulate_sensor
from impact_observer.stamps import NS_PER_S, from_seconds
from impact_observer.states import Estimates, Vector

MODEL = """\
name: hammer_and_encoder
bodies: [{name: carriage, mass: 1}, {name: hammer, mass: 1}]
springs:
  - {between: [ground, carriage], stiffness: 10, damping: 0.1}
  - {between: [carriage, hammer], stiffness: 10, damping: 0.1}
forces: [{body: hammer, amplitude: 4, frequency: 2.5}]
stops:  [{name: anvil, body: hammer, limit: 0.5, side: above, restitution: 0.7}]
initial_state: {position: [0.1, -0.2], velocity: [0.5, 0]}
"""
NOISE = 0.05
"""Of the encoder, m."""
ENCODER = f"""\
measurements:
  - {{name: encoder, topic: /encoder, joint: carriage, quantity: position, deviation: {NOISE}}}
"""
SWITCH = SensorModel(jitter=0.001, missed=0.2)
COLOURS = ("#0072B2", "0.6", "#D55E00")
NEAR = 0.01
"""Before and after a hit errors do not count, s: truth and estimate jump at different instants."""
RATE, EVERY = 100.0, 10
"""Of the samples, Hz; the encoder has every tenth of them."""


class Compared(NamedTuple):
    """Errors of the hammer's speed.

    Attributes:
        times: s, shape (samples,).
        errors: m/s, by what was used, shape (samples,) each; not a number beside a hit.
    """

    times: Vector
    errors: dict[str, Vector]

    def typical(self, begin: float, end: float) -> dict[str, float]:
        """Medians of their magnitudes between two times, s."""
        part = (self.times >= begin) & (self.times < end)
        return {k: float(np.nanmedian(np.abs(v[part]))) for k, v in self.errors.items()}


def compare(seconds: float, seed: int = 1) -> Compared:
    """Simulate the hammer and its sensors, and observe it three times."""
    model, epoch = parse_model(MODEL, "hammer"), NS_PER_S
    plant = Plant(model.system, *model.initial_state(), epoch=epoch)
    run = simulate(plant, grid(epoch, epoch + from_seconds(seconds), RATE))
    last = int(run.stamps[-1])
    sent = simulate_sensor(SWITCH, model.system, run.switchings, epoch=epoch, last=last, seed=seed)
    hits = [each.event for each in sent]
    stamps, positions = run.stamps[::EVERY], run.states[::EVERY, 0]
    positions = positions + np.random.default_rng(seed).normal(scale=NOISE, size=positions.size)
    samples = [
        SensorSample(0, *each) for each in zip(stamps.tolist(), positions.tolist(), strict=True)
    ]

    times = (run.stamps - epoch) / NS_PER_S
    instants = (np.array([each.instant.stamp for each in run.impacts]) - epoch) / NS_PER_S
    beside = np.abs(times[:, None] - instants).min(axis=1, initial=np.inf) < NEAR

    def error(events: list[ImpactEvent], used: list[SensorSample]) -> Vector:
        options = Options("minimum-variance", epoch=epoch, clock_error=1e-3)
        encoder = parse_measurements(ENCODER, "encoder")
        observer = make_observer(model.system, options, measurements=encoder)
        found = replay_batches(observer, events, run.stamps, samples=used)
        parts = [each for each in found if isinstance(each, Estimates)]
        errors = np.full(run.stamps.size, np.nan)
        for part in parts:
            at = np.searchsorted(run.stamps, part.stamps)
            errors[at] = part.x[:, 3] - run.states[at, 3]
        return np.where(beside, np.nan, errors)

    return Compared(
        times,
        {
            "impacts": error(hits, []),
            "encoder": error([], samples),
            "both": error(hits, samples),
        },
    )


def picture(found: Compared, path: Path) -> None:
    """The three errors."""
    from matplotlib.figure import Figure

    from impact_observer.draw.pictures import save

    figure = Figure(figsize=(7, 3.5), layout="constrained")
    axes = figure.add_subplot()
    for (name, errors), colour in zip(found.errors.items(), COLOURS, strict=True):
        axes.semilogy(found.times, np.abs(errors), color=colour, linewidth=1, label=name)
    axes.set(xlabel="time [s]", ylabel="error of the hammer's speed [m/s]", ylim=(1e-6, 10))
    axes.legend(frameon=False, ncols=3, loc="lower left")
    save(figure, path)


def main() -> None:
    """Print and draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("-o", "--output", type=Path, default=Path("encoder.png"))
    args = parser.parse_args()
    found = compare(args.seconds)
    for begin, end in ((0.0, 2.0), (2.0, 5.0), (6.0, 10.0)):
        errors = ", ".join(f"{v:.4f} m/s by {k}" for k, v in found.typical(begin, end).items())
        print(f"{begin:g} to {end:g} s: {errors}")
    picture(found, args.output)
    print(f"picture: {args.output}")


if __name__ == "__main__":
    main()
