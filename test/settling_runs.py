# SPDX-License-Identifier: Apache-2.0
"""A drill that comes to rest on its stops, and errors of runs in which no contact rests."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from impact_observer.model import System, parse_model, read_model
from impact_observer.observer import make_observer, replay
from impact_observer.options import Options
from impact_observer.plant import Plant, Run, simulate
from impact_observer.stamps import NS_PER_S, from_seconds, grid
from impact_observer.states import Estimate, Vector

DRILL = parse_model(
    """
name: drill
bodies: [{name: motor, mass: 2}, {name: rod, mass: 1}, {name: bit, mass: 0.5}]
springs:
  - {between: [ground, motor], stiffness: 30, damping: 0.6}
  - {between: [motor, rod], stiffness: 60, damping: 0.4}
  - {between: [rod, bit], stiffness: 60, damping: 0.2}
forces:
  - {body: bit, constant: 4}
  - {body: motor, amplitude: 12, frequency: 2.2}
stops:
  - {name: rock, body: bit, limit: 0.05, side: above, restitution: 0.6}
  - {name: collar, body: rod, limit: -0.08, side: below, restitution: 0.4}
""",
    "drill",
).system
"""Three masses with two stops, pressed on the rock by a constant force."""
EPOCH = 5 * NS_PER_S
RATE = 20.0
JITTER = 1e-3
"""Standard deviation of the errors of stamps, s."""
MARGIN = 5 * JITTER
"""Distance from an impact at which truth and estimate are on the same side of it, s."""

Array = NDArray[np.float64]


def start_of(system: System, seed: int) -> Vector:
    """A state of the plant inside no stop, shape (2n,)."""
    rng = np.random.default_rng(seed)
    while True:
        x: Vector = rng.normal(size=2 * system.n) * np.repeat([0.1, 0.7], system.n)
        if np.all(system.gap(x[: system.n]) > 0.0):
            return x


def simulated(system: System, seed: int, seconds: float) -> Run:
    """A run of the plant."""
    stamps = grid(EPOCH, EPOCH + from_seconds(seconds), RATE)[1:]
    return simulate(Plant(system, *np.split(start_of(system, seed), 2), epoch=EPOCH), stamps)


def nees_of_run(seed: int) -> Array:
    """NEES over 2n of three_mass at each of 30 s, but near impacts, whose stamps have jitter."""
    rng, system = np.random.default_rng([2014, seed]), read_model("three_mass").system
    x = rng.normal(size=6) * np.repeat([0.2, 0.7], 3)
    while not np.all(system.gap(x[:3]) > 0.01):
        x = rng.normal(size=6) * np.repeat([0.2, 0.7], 3)
    stamps = np.arange(1, 31) * NS_PER_S + EPOCH
    run = simulate(Plant(system, *np.split(x, 2), epoch=EPOCH), stamps)
    start = ",".join(map(repr, (x + rng.normal(size=6)).tolist()))
    late = np.rint(rng.normal(0.0, JITTER * NS_PER_S, len(run.events))).astype(int).tolist()
    events = [replace(e, stamp=e.stamp + dt) for e, dt in zip(run.events, late, strict=True)]
    faultless = Options("minimum-variance", start, missed=0.0, spurious=0.0, mislabelled=0.0)
    observer = make_observer(system, replace(faultless, clock_error=JITTER, epoch=EPOCH))
    found = []
    impacts = np.array([each.stamp for each in run.events])
    made = replay(observer, sorted(events, key=lambda each: each.stamp), stamps)
    estimates = (each for each in made if isinstance(each, Estimate))
    for each, truth in zip(estimates, run.states, strict=True):
        if np.min(np.abs(impacts - each.stamp)) > MARGIN * NS_PER_S:
            error = np.concatenate([each.q, each.u]) - truth
            found.append(error @ np.linalg.solve(each.covariance, error) / 6)
    return np.array(found)
