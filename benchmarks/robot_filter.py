# SPDX-License-Identifier: Apache-2.0
"""Velocities of a robot that hits a wall: ``./dev bench robot_filter``.

The plant is hammer_arm with masses, inertias and damping 5 % larger and a restitution 0.05 larger
than in the model, which declares white torques of 0.05 N m sqrt(s). Encoders have 1 mrad of noise
at 1 kHz and at 200 Hz, efforts are exact, stamps of impacts jitter by 0.2 ms; all of that is
declared. The velocity error is the root mean square over both joints from 2 ms to 50 ms after each
hit, and the table has the median of the seeds, of

- ``saltation``: the observer;
- ``inflated``: the same filter without contacts, whose covariance of velocities is made larger at
  the stamp of each hit;
- ``no jump``: the same filter without contacts and without hits;
- ``differences``: of the encoder, with a low pass of first order.

The last three are tuned on the truth, by the best of several numbers. ``cost`` is the processor
time for each instant of samples of both joints and an estimate, in microseconds.
"""

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import NamedTuple
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from impact_observer.events import ImpactEvent
from impact_observer.model import Model, read_model
from impact_observer.model.measurement import Measurement
from impact_observer.model.measurements_file import read_measurements
from impact_observer.model.urdf_file import Urdf
from impact_observer.observer import Observer, make_observer
from impact_observer.observer.samples import SensorSample
from impact_observer.options import Options
from impact_observer.plant import Run, SensorModel, simulate, simulate_sensor
from impact_observer.plant.master import make_plant
from impact_observer.robots.robot import Robot
from impact_observer.stamps import NS_PER_S, from_seconds, grid

EPOCH = 5 * NS_PER_S
MODEL = "hammer_arm"
JITTER, NOISE = 0.0002, 0.001
"""Of the stamps of impacts, s; of the encoders, rad."""
TORQUES = 0.05
"""Deviation of white torques that the model declares, N m sqrt(s)."""
AFTER, SECONDS, SEEDS = 0.05, 40.0, 10
"""End of the window after a hit, s; length of a run with some 30 hits, s; runs."""
BEFORE = 0.002
"""Begin of the window: the contact of 1 ms and five deviations of a stamp, s."""
RATES = (1000.0, 200.0)
LOW_PASS = (0.002, 0.005, 0.01, 0.02)
"""Time constants of the differences, s."""
INFLATED = (1.0, 3.0, 10.0)
"""Deviations of the velocities after a hit, rad/s."""
FREE = (0.02, 0.2, 1.0, 5.0)
"""Deviations of white torques of the filter without hits, N m sqrt(s)."""

Array = NDArray[np.float64]


class Recording(NamedTuple):
    """What is recorded of one run.

    Attributes:
        run: of the plant, with states at the stamps of the encoders.
        events: impacts as they are stamped.
        samples: of the encoders.
        efforts: of both joints at the stamps of the encoders, shape (samples, 2), N m.
    """

    run: Run
    events: list[ImpactEvent]
    samples: list[SensorSample]
    efforts: Array

    def after_hits(self) -> NDArray[np.bool_]:
        """Which states are at most ``AFTER`` after a hit, shape (samples,)."""
        found = np.zeros(self.run.stamps.size, dtype=np.bool_)
        for each in self.run.impacts:
            since = self.run.stamps - each.instant.stamp
            found |= (since >= from_seconds(BEFORE)) & (since < from_seconds(AFTER))
        return found

    def error(self, speeds: Array) -> float:
        """The root mean square error of ``speeds``, shape (samples, 2), after hits, rad/s."""
        errors = (speeds - self.run.states[:, 2:])[self.after_hits()]
        return float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))


def wrong_plant(model: Model) -> Robot:
    """The robot of a ``model`` with other masses, damping and restitution."""
    assert model.robot is not None, "a robot"
    root = ET.fromstring(model.robot.known_urdf.text)
    for part in (*root.iter("mass"), *root.iter("inertia")):
        part.attrib.update({k: repr(1.05 * float(v)) for k, v in part.attrib.items()})
    known = model.robot.parameters
    other = {k: 1.05 * v for k, v in known.items() if k.startswith("damping")}
    other |= {k: v + 0.05 for k, v in known.items() if k.startswith("restitution")}
    urdf = Urdf(ET.tostring(root, encoding="unicode"), model.robot.known_urdf.source)
    return Robot(replace(model.robot.with_parameters(other), urdf=urdf))


@cache
def true_run(rate: float, seconds: float) -> tuple[Robot, Run]:
    """The plant, which is not the model, and its motion at the stamps of encoders."""
    robot = wrong_plant(read_model(MODEL))
    return robot, run_of(robot, rate, seconds)


def run_of(robot: Robot, rate: float, seconds: float) -> Run:
    """The motion of a ``robot`` from the initial state of the model."""
    stamps = grid(EPOCH, EPOCH + from_seconds(seconds), rate)
    return simulate(make_plant(robot, *read_model(MODEL).initial_state(), epoch=EPOCH), stamps)


def recorded(seed: int, rate: float, seconds: float) -> Recording:
    """A run of the plant as encoders and the sensor of impacts record it."""
    return _sensed(*true_run(rate, seconds), seed)


def recorded_of(robot: Robot, seed: int, rate: float, seconds: float) -> Recording:
    """The same of another ``robot``."""
    return _sensed(robot, run_of(robot, rate, seconds), seed)


def _sensed(robot: Robot, run: Run, seed: int) -> Recording:
    last, rng = int(run.stamps[-1]), np.random.default_rng([51, seed])
    sensor = SensorModel(jitter=JITTER)
    sent = simulate_sensor(sensor, robot, run.switchings, epoch=EPOCH, last=last, seed=seed)
    values = run.states[:, :2] + NOISE * rng.normal(size=(run.stamps.size, 2))
    samples = [
        SensorSample(i, stamp, value)
        for stamp, row in zip(run.stamps.tolist(), values.tolist(), strict=True)
        for i, value in enumerate(row)
    ]
    times = (run.stamps - EPOCH) / NS_PER_S
    efforts = np.array([robot.torques(t) for t in times.tolist()])
    events = sorted((each.event for each in sent), key=lambda event: event.stamp)
    return Recording(run, events, samples, efforts)


def declared() -> Model:
    """The model that the observers know."""
    model = read_model(MODEL)
    assert model.robot is not None, "a robot"
    deviations = np.full(model.robot.n, TORQUES)
    return replace(model, robot=replace(model.robot, torque_deviation=deviations))


def encoders() -> Sequence[Measurement]:
    """As declared beside the model."""
    return read_measurements(MODEL)


def observer_of(model: Model, recording: Recording) -> Observer:
    """An observer of a ``model`` that knows the efforts of a ``recording``."""
    assert model.robot is not None, "a robot"
    options = Options(law="minimum-variance", clock_error=JITTER, epoch=EPOCH)
    observer = make_observer(model, options, measurements=encoders())
    assert observer.live is not None, "efforts are measured"
    efforts = zip(recording.run.stamps.tolist(), recording.efforts.tolist(), strict=True)
    for stamp, row in efforts:
        for name, value in zip(model.robot.joints, row, strict=True):
            observer.live.add_force(name, stamp, value)
    return observer


def without_contacts(model: Model, deviation: float) -> Model:
    """The ``model`` without contacts, with white torques of this ``deviation``."""
    assert model.robot is not None, "a robot"
    torques = np.full(model.robot.n, deviation)
    robot = replace(model.robot, contacts=(), torque_deviation=torques)
    return replace(model, robot=robot, uncertainty=None)


def filtered(
    observer: Observer, recording: Recording, *, inflated: float = 0.0, hits: bool = True
) -> Array:
    """Velocities that an observer estimates just after each sample, shape (samples, 2).

    Where ``inflated`` is given, hits only make the deviations of velocities as large, rad/s.
    """
    events, found = list(recording.events) if hits else [], list[Array]()
    samples = iter(recording.samples)
    for stamp in recording.run.stamps.tolist():
        while events and events[0].stamp <= stamp:
            event = events.pop(0)
            if not inflated:
                observer.receive(event)
                continue
            now = observer.estimate(event.stamp)
            wider = now.covariance.copy()
            wider[2:, 2:] += inflated**2 * np.eye(2)
            observer.set_state(event.stamp, now.q, now.u, wider)
        observer.measure([next(samples), next(samples)])
        found.append(observer.estimate(stamp).u)
    return np.array(found)


def differences(recording: Recording, time_constant: float) -> Array:
    """Differences of the encoders with a low pass of first order, shape (samples, 2)."""
    q = np.array([each.value for each in recording.samples]).reshape(-1, 2)
    steps = np.diff(recording.run.stamps) / NS_PER_S
    found, now = [np.zeros(2)], np.zeros(2)
    for change, step in zip(np.diff(q, axis=0), steps.tolist(), strict=True):
        now = now + (1 - np.exp(-step / time_constant)) * (change / step - now)
        found.append(now)
    return np.array(found)


class Errors(NamedTuple):
    """Velocity errors of one run, rad/s, and processor time for each instant of samples, us."""

    saltation: float
    inflated: float
    no_jump: float
    differences: float
    cost: float


def errors_of(seed: int, rate: float, seconds: float) -> Errors:
    """The errors of one run."""
    recording, model = recorded(seed, rate, seconds), declared()
    observer, began = observer_of(model, recording), time.process_time()
    saltation = recording.error(filtered(observer, recording))
    cost = (time.process_time() - began) / recording.run.stamps.size * 1e6
    free = [without_contacts(model, each) for each in FREE]
    no_jump = (filtered(observer_of(each, recording), recording, hits=False) for each in free)
    inflated = (
        filtered(
            observer_of(without_contacts(model, TORQUES), recording), recording, inflated=each
        )
        for each in INFLATED
    )
    low = (differences(recording, each) for each in LOW_PASS)
    best = [min(map(recording.error, some)) for some in (inflated, no_jump, low)]
    return Errors(saltation, best[0], best[1], best[2], cost)


def main(args: Sequence[str] | None = None) -> int:
    """Print a table."""
    parser = argparse.ArgumentParser(prog="./dev bench robot_filter", description=__doc__)
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--seconds", type=float, default=SECONDS, help="of each run")
    chosen = parser.parse_args(args)
    table = Table("encoders", "hits", *(each.replace("_", " ") for each in Errors._fields))
    for rate in RATES:
        found = [errors_of(seed, rate, chosen.seconds) for seed in range(chosen.seeds)]
        hits = len(true_run(rate, chosen.seconds)[1].impacts)
        *errors, cost = np.median(found, axis=0).tolist()
        cells = [f"{each:.3f}" for each in errors]
        table.add_row(f"{rate:g} Hz", str(hits), *cells, f"{cost:.0f}")
    Console(width=100).print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
