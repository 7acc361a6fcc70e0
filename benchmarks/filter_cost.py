# SPDX-License-Identifier: Apache-2.0
"""Processor time of chains of many masses, and of the filter for a second of a recorded rig.

The cost of an observer is the processor time of the whole command ``observe`` with
``--law minimum-variance`` and default options on a recording with true states at 100 Hz, less that
of the same command on a recording without an impact, over the recorded seconds.
"""

import resource
import subprocess
import sys
import time
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.fast_bags import EPOCH, fast_model
from benchmarks.harness import Benchmark, Contest, Goal, Metrics, SkippedError
from benchmarks.plant_run import REPEATS
from impact_observer.dynamics import Phases
from impact_observer.model import Model, parse_model
from impact_observer.plant import Plant, simulate
from impact_observer.stamps import NS_PER_S, from_seconds

CHAINS = (20, 100)
RUN = 20.0
"""Of a chain, s."""
DRILL = 40.8
"""Speed-up over the sample two_mass, at its speeds: 32 hits a second."""
JITTER = ("--jitter", "1e-4")
NOISE = (*JITTER, "--missed", "0.2", "--spurious")


def chain(n: int) -> Model:
    """``n`` unit masses in a row on a wall, driven at the three that hit stops."""
    names = ["ground", *(f"x{k + 1}" for k in range(n))]
    bodies = ", ".join(f"{{name: {name}, mass: 1}}" for name in names[1:])
    springs = [
        f"{{between: [{a}, {b}], stiffness: {20 * n}, damping: {0.02 * n}}}"
        for a, b in pairwise(names)
    ]
    hit = [names[k] for k in (n // 3, 2 * n // 3, n)]
    forces = [
        f"{{body: {body}, amplitude: 20, frequency: {frequency}, phase: {phase}}}"
        for body, frequency, phase in zip(hit, (5.3, 8.1, 6.7), range(3), strict=True)
    ]
    stops = [
        f"{{name: at_{body}, body: {body}, limit: 0.2, side: above, restitution: 0.6}}"
        for body in hit
    ]
    text = f"""
name: chain_{n}
bodies: [{bodies}]
springs: [{", ".join(springs)}]
forces: [{", ".join(forces)}]
stops: [{", ".join(stops)}]
initial_state: {{position: {[0] * n}, velocity: {[0] * n}}}
"""
    return parse_model(text, f"chain_{n}")


def prepare_chains(_: Path) -> Contest:
    """Chains of which an earlier run has prepared all phases."""
    models = {f"n = {n}": chain(n) for n in CHAINS}

    phases = {name: Phases(model.system) for name, model in models.items()}
    for name, model in models.items():
        _seconds_of(model, phases[name])

    def ours(_: Path) -> Metrics:
        return {name: _seconds_of(model, phases[name]) for name, model in models.items()}

    work = f"chains of {CHAINS[0]} and {CHAINS[1]} masses, three stops, {RUN:g} s, impacts only"
    return Contest(work, ours, units=dict.fromkeys(models, "s"), repeats=REPEATS)


def _seconds_of(model: Model, phases: Phases) -> float:
    """Processor time of a run of a plant that is made already, s."""
    end = EPOCH + from_seconds(RUN)
    plant = Plant(model.system, *model.initial_state(), epoch=EPOCH, phases=phases)
    begin = time.process_time()
    simulate(plant, np.array([end]))
    return time.process_time() - begin


class Recording(NamedTuple):
    """A recorded rig: its model and the faults of its sensor, as ``simulate`` takes them.

    ``declared`` is the model of the observer; None for that of the rig.
    """

    model: Model
    faults: dict[str, tuple[str, ...]]
    goals: tuple[float, ...]
    declared: Model | None = None


RECORDINGS = {
    "drill": Recording(
        fast_model(DRILL, 1 / DRILL),
        {"exact": (), "20 % missed, 5 false a second": (*NOISE, "5")},
        (0.03, 0.15),
    ),
    "misfit": Recording(
        fast_model(DRILL, 1 / DRILL, restitution=0.97 * 0.7),
        {"restitution 3 % off": ()},
        (0.3,),
        declared=fast_model(DRILL, 1 / DRILL),
    ),
    "chain_20": Recording(
        chain(20), {"jitter": JITTER, "20 % missed, 2 false a second": (*NOISE, "2")}, (0.15, 0.4)
    ),
    "chain_100": Recording(chain(100), {"jitter": JITTER}, (1.0,)),
}


def prepare_filter(folder: Path, recording: Recording, seconds: float) -> Contest:
    """Record the rig with each kind of faults, and without an impact."""
    model, declared = folder / "model.yaml", folder / "declared.yaml"
    model.write_text(recording.model.text(), encoding="utf-8")
    declared.write_text((recording.declared or recording.model).text(), encoding="utf-8")
    simulated = ("simulate", str(model), "--seed", "1", "--duration")
    _command(*simulated, "0.001", "-o", str(folder / "empty"))
    bags = {name: folder / f"bag_{k}" for k, name in enumerate(recording.faults)}
    for name, faults in recording.faults.items():
        _command(*simulated, f"{seconds}", *faults, "-o", str(bags[name]))

    def ours(place: Path) -> Metrics:
        epoch = ("--epoch", f"{EPOCH / NS_PER_S}")
        start = _observed(folder / "empty", declared, place / "empty", *epoch)
        return {
            name: (_observed(bag, declared, place / bag.name) - start) / seconds
            for name, bag in bags.items()
        }

    work = f"{recording.model.system.name}, {seconds:g} s, jitter 0.1 ms where not exact"
    return Contest(
        f"{work}; processor time of observe per second", ours, units=dict.fromkeys(bags, "s")
    )


def _observed(bag: Path, model: Path, output: Path, *options: str) -> float:
    """Processor time of observing ``bag`` with a model, s."""
    given = ("--law", "minimum-variance", "--model", str(model))
    return _command("observe", str(bag), *given, *options, "-o", str(output))


def _command(*arguments: str) -> float:
    """The processor time of ``impact-observer`` with these arguments, s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    _python("-m", "impact_observer", *arguments)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _python(*arguments: str) -> None:
    """Run a Python process to its end."""
    command = [sys.executable, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SkippedError(done.stderr.strip() or f"exit code {done.returncode}")


def benchmarks(seconds: float) -> tuple[Benchmark, ...]:
    """All of them; ``seconds`` is the length of recordings."""
    cost = "what does minimum-variance cost per second of the rig?"
    filters = [
        Benchmark(
            f"filter_{name}",
            cost,
            partial(prepare_filter, recording=each, seconds=seconds),
            tuple(Goal(most, metric=m) for m, most in zip(each.faults, each.goals, strict=True)),
            rounds=3,
        )
        for name, each in RECORDINGS.items()
    ]
    chains = (Goal(5e-3, metric="n = 20"), Goal(20e-3, metric="n = 100"))
    return (
        Benchmark("plant_chain", "what do many coordinates cost?", prepare_chains, chains),
        *filters,
    )
