# SPDX-License-Identifier: Apache-2.0
"""A robot's velocity through hits: by the observer, and by differences of its encoders.

Two motors swing the hammer_arm against a wall. Its encoders have 1 mrad of noise at 200 Hz, the
stamps of its hits an error of 0.2 ms; rotors and damping are 5 and 10 %, the restitution is 0.05
larger than the model says. A difference of the encoder, even with the best low pass, needs two
samples to see that the arm has turned back, and is noisy. The observer knows from the hit on.

    python examples/hammer_arm.py
"""

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np

from impact_observer import Options, grid, make_observer, read_model, simulate
from impact_observer.model.measurement import read_measurements
from impact_observer.observer.replay import replay_batches
from impact_observer.observer.samples import SensorSample
from impact_observer.plant import Plant, SensorModel, simulate_sensor
from impact_observer.robots import Robot
from impact_observer.stamps import NS_PER_S, from_seconds
from impact_observer.states import Estimates, Matrix, Vector

RATE = 200.0
"""Of the encoders, Hz."""
FAST = 5
"""Estimates for each sample of the encoders."""
JITTER, NOISE = 0.0002, 0.001
"""Of the stamps of hits, s, and of the encoders, rad."""
LOW_PASS = (0.002, 0.005, 0.01, 0.02)
"""Time constants of the differences, s; the best one is used."""
AFTER = (0.002, 0.05)
"""Begin and end of the time after a hit in which errors count, s."""
SHOWN = (-0.04, 0.08)
"""Begin and end of the time about a hit in which velocities are estimated, s."""


class Velocities(NamedTuple):
    """Velocities of both joints about the hits, rad/s.

    Attributes:
        times: s, shape (samples,).
        truth: shape (samples, 2).
        observed: shape (samples, 2).
        deviations: of those observed, shape (samples, 2).
        differences: of the encoders, held from one sample to the next, shape (samples, 2).
        hits: s, shape (hits,).
    """

    times: Vector
    truth: Matrix
    observed: Matrix
    deviations: Matrix
    differences: Matrix
    hits: Vector

    def error(self, velocities: Matrix) -> float:
        """The root mean square error after hits."""
        since = self.times[:, None] - self.hits
        chosen = np.any((since >= AFTER[0]) & (since < AFTER[1]), axis=1)
        lengths = np.linalg.norm(velocities[chosen] - self.truth[chosen], axis=1)
        return float(np.sqrt(np.mean(lengths**2)))


def swing(seconds: float, seed: int = 1) -> Velocities:
    """Simulate the arm and its sensors, and observe it."""
    model, epoch = read_model("hammer_arm"), NS_PER_S
    assert model.robot is not None, "a robot"
    wrong = {"damping": 1.1, "rotor-inertia": 1.05}
    true = {k: v * wrong.get(k.partition(".")[0], 1.0) for k, v in model.robot.parameters.items()}
    true["restitution.wall"] += 0.05
    robot = Robot(model.robot.with_parameters(true))
    plant = Plant(robot, *model.initial_state(), epoch=epoch)
    run = simulate(plant, grid(epoch, epoch + from_seconds(seconds), FAST * RATE))
    last, rng = int(run.stamps[-1]), np.random.default_rng(seed)
    sensor = SensorModel(jitter=JITTER)
    sent = simulate_sensor(sensor, robot, run.switchings, epoch=epoch, last=last, seed=seed)
    encoders, stamps = run.states[::FAST, :2], run.stamps[::FAST]
    encoders = encoders + rng.normal(scale=NOISE, size=encoders.shape)
    samples = [
        SensorSample(joint, stamp, value)
        for stamp, row in zip(stamps.tolist(), encoders.tolist(), strict=True)
        for joint, value in enumerate(row)
    ]

    measurements = read_measurements("hammer_arm")
    options = Options("minimum-variance", epoch=epoch, clock_error=JITTER)
    observer = make_observer(model, options, measurements=measurements)
    assert observer.live is not None, "efforts are measured"
    for stamp in stamps.tolist():
        efforts = robot.torques((stamp - epoch) / NS_PER_S)
        for name, effort in zip(robot.coordinates, efforts.tolist(), strict=True):
            observer.live.add_force(name, stamp, effort)
    events = sorted((each.event for each in sent), key=lambda event: event.stamp)
    times = (run.stamps - epoch) / NS_PER_S
    hits = (np.array([each.instant.stamp for each in run.impacts]) - epoch) / NS_PER_S
    since = times[:, None] - hits
    shown = np.any((since > SHOWN[0]) & (since < SHOWN[1]), axis=1)
    found = [*replay_batches(observer, events, run.stamps[shown], samples=samples)]
    estimates = [each for some in found if isinstance(some, Estimates) for each in some]

    result = Velocities(
        times=times[shown],
        truth=run.states[shown, 2:],
        observed=np.array([each.u for each in estimates]),
        deviations=np.array([np.sqrt(np.diag(each.covariance))[2:] for each in estimates]),
        differences=np.empty((0, 2)),
        hits=hits,
    )
    tried = [_held(differences(encoders, each), times.size)[shown] for each in LOW_PASS]
    return result._replace(differences=min(tried, key=result.error))


def differences(encoders: Matrix, time_constant: float) -> Matrix:
    """Differences of the ``encoders`` with a low pass of first order, shape (samples, 2)."""
    share, now = 1 - np.exp(-1 / (RATE * time_constant)), np.zeros(2)
    found = [now]
    for change in np.diff(encoders, axis=0):
        now = now + share * (change * RATE - now)
        found.append(now)
    return np.array(found)


def _held(values: Matrix, size: int) -> Matrix:
    """Each of the ``values`` until the next one, shape (size, 2)."""
    return np.repeat(values, FAST, axis=0)[:size]


def picture(found: Velocities, path: Path) -> None:
    """The velocities of both joints around the first hits."""
    from matplotlib.figure import Figure

    from impact_observer.draw.pictures import save

    shown = found.hits[:3]
    figure = Figure(figsize=(8, 4.5), layout="constrained")
    grid_of_axes = figure.subplots(2, max(shown.size, 1), squeeze=False, sharey="row")
    for row, name in enumerate(("shoulder", "elbow")):
        for axes, hit in zip(grid_of_axes[row], shown, strict=False):
            since = found.times - hit
            part = (since > SHOWN[0]) & (since < SHOWN[1])
            t, u, s = 1e3 * since[part], found.observed[part, row], found.deviations[part, row]
            axes.plot(t, found.truth[part, row], color="0.75", linewidth=3.5, label="truth")
            axes.step(
                t,
                found.differences[part, row],
                where="post",
                color="#0072B2",
                linewidth=1,
                label="differences of the encoder",
            )
            axes.plot(t, u, color="#D55E00", linewidth=1.2, label="observer")
            axes.fill_between(t, u - 2 * s, u + 2 * s, color="#D55E00", alpha=0.22, linewidth=0)
            axes.axvline(0, color="0.5", linewidth=0.8, linestyle=":")
            if row == 0:
                axes.set_title(f"hit at {hit:.3f} s", fontsize="medium")
            else:
                axes.set_xlabel("time since the hit [ms]")
        low, high = np.min(found.truth[:, row]), np.max(found.truth[:, row])
        grid_of_axes[row, 0].set_ylim(1.15 * low - 0.15 * high, 1.15 * high - 0.15 * low)
        grid_of_axes[row, 0].set_ylabel(f"d{name}/dt [rad/s]")
    lines = grid_of_axes[0, 0].lines[:3]
    figure.legend(
        lines,
        [str(each.get_label()) for each in lines],
        loc="outside upper center",
        ncols=3,
        frameon=False,
    )
    save(figure, path)


def main() -> None:
    """Print and draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("-o", "--output", type=Path, default=Path("hammer_arm.png"))
    args = parser.parse_args()
    found = swing(args.seconds)
    print(f"{found.hits.size} hits; velocity from 2 to 50 ms after each, rms error:")
    print(f"observer {found.error(found.observed):.2f} rad/s")
    print(f"differences of the encoders {found.error(found.differences):.2f} rad/s")
    picture(found, args.output)
    print(f"picture: {args.output}")


if __name__ == "__main__":
    main()
