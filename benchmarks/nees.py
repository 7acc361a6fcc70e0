# SPDX-License-Identifier: Apache-2.0
"""Whether covariances hold at all times and near impacts: ``./dev bench nees``.

    ./dev bench nees                         # 75 runs of each rig
    ./dev bench nees --runs 5 --rigs drill

Plants with exact models that start at random, stamps with a normal error that is declared, initial
estimates that are wrong by normal errors as declared; ``chain`` is another one in every run. The
other options are the defaults. Runs in which a contact stays closed, or that have fewer impacts
than twice the numbers of the state, are left out. Two tables:

- farther than 5 ms and five deviations of a stamp from any impact: NEES over 2n in each sixth of
  the recording, the median over the runs, of the mean of a run. It should be about 1; where the
  error hardly changes within a run, a chi-square of 4, 6 or 8 has the medians 0.84, 0.89 or 0.92.
  Directions whose variance the rounding of a covariance hides do not count;
- within three deviations of the stamp of an impact: the share of the samples that are within three
  deviations, of the worst component, and the mean square of error over deviation, of all.
"""

import argparse
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from joblib import Parallel, delayed
from rich.console import Console
from rich.table import Table

from benchmarks.covariance import Array, drawn
from benchmarks.impacts import EPOCH
from benchmarks.silence import model_named
from impact_observer.events import ImpactEvent, Kind
from impact_observer.model import System
from impact_observer.observer import make_observer
from impact_observer.options import Options
from impact_observer.plant import Plant, Run, SensorModel, simulate, simulate_sensor
from impact_observer.smooth import smoothed_runs
from impact_observer.stamps import NS_PER_S, from_seconds, grid
from impact_observer.states import Estimate, Stamps

BINS = 6
NEAR = 3.0
"""Farthest sample from a stamp that counts as near, in deviations of stamps."""
SAMPLES = 4
"""Of them about each impact."""
AWAY = 5e-3
"""Least distance from an impact of samples that count as away from all, s."""
LEAST = 1e-13
"""Least variance of a direction that counts, over the largest: doubles hold no smaller one."""
COMMANDS = ("observe", "smooth")


class Rig(NamedTuple):
    """A model, the length of a run, s, the jitter, s, and the deviation of the first estimate."""

    model: str
    seconds: float
    jitter: float
    deviation: float


RIGS = {
    "two_mass": Rig("two_mass", 30.0, 1e-3, 1.0),
    "three_mass": Rig("three_mass", 30.0, 1e-3, 1.0),
    "three_mass, 60 s": Rig("three_mass", 60.0, 1e-3, 1.0),
    "chain": Rig("random", 30.0, 1e-3, 1.0),
    "drill": Rig("drill", 3.0, 5e-5, 0.1),
}


class Outcome(NamedTuple):
    """Of one command in one run.

    Attributes:
        nees: mean over 2n in each part of the run, shape (BINS,); NaN without samples.
        within: share within three deviations of the samples near impacts, of the worst component.
        square: mean of the squares of error over deviation near impacts.
    """

    nees: Array
    within: float
    square: float


def plant_of(name: str, rng: np.random.Generator) -> tuple[System, Array]:
    """A system, and an initial state of the plant inside no stop."""
    if name != "drill":
        return drawn(name, rng)
    model = model_named(name)
    x = np.concatenate(model.initial_state())
    return model.system, x * rng.uniform(0.5, 1.5, x.size)


def recorded(
    rig: Rig, system: System, x: Array, seed: int
) -> tuple[Run, list[ImpactEvent], Stamps]:
    """A run with its states also near impacts, the reported events, and the stamps near these."""
    last = EPOCH + from_seconds(rig.seconds)
    stamps = grid(EPOCH, last, 199 / rig.seconds)
    run = simulate(Plant(system, *np.split(x, 2), epoch=EPOCH), stamps)
    sensor = SensorModel(jitter=rig.jitter)
    sent = simulate_sensor(sensor, system, run.switchings, epoch=EPOCH, last=last, seed=seed)
    events = [each.event for each in sent]
    reported = np.repeat(np.array([each.stamp for each in events], dtype=np.int64), SAMPLES)
    far = np.random.default_rng(seed).uniform(-NEAR, NEAR, reported.size) * rig.jitter * NS_PER_S
    near = np.unique(reported + far.astype(int))
    near = near[(near > EPOCH) & (near < last)]
    every = np.unique(np.concatenate([stamps, near]))
    run = simulate(Plant(system, *np.split(x, 2), epoch=EPOCH), every)
    return run, events, near


def outcomes(name: str, seed: int) -> list[Outcome]:
    """One run by each of ``COMMANDS``; none if a contact stays closed, or impacts are few."""
    rig, rng = RIGS[name], np.random.default_rng([2026, seed])
    system, x = plant_of(rig.model, rng)
    run, events, near = recorded(rig, system, x, seed)
    stays = any(switch.kind is not Kind.IMPACT for each in events for switch in each.switches)
    if stays or len(events) < 2 * x.size:
        return []
    start = x + rig.deviation * rng.normal(size=x.size)
    options = Options(
        "minimum-variance",
        ",".join(f"{each:.17g}" for each in start),
        f"{rig.deviation:g}",
        clock_error=rig.jitter,
        epoch=EPOCH,
        history=1e4,
    )
    observer = make_observer(system, options)
    for each in events:
        observer.receive(each)
    (motion,) = smoothed_runs(system, events, options)
    smoothed = [one for some in motion.estimates(run.stamps) for one in some]
    observed = [observer.estimate(int(each)) for each in run.stamps]
    return [outcome(rig, run, near, each) for each in (observed, smoothed)]


def outcome(rig: Rig, run: Run, near: Stamps, estimates: Sequence[Estimate]) -> Outcome:
    """What ``estimates`` at all stamps of a run are worth."""
    hits = np.array([each.stamp for each in run.events])
    margin = max(AWAY if rig.jitter >= 1e-3 else 0.0, 5 * rig.jitter) * NS_PER_S
    nees, z = [list[float]() for _ in range(BINS)], list[Array]()
    last = float(run.stamps[-1] - EPOCH)
    for each, truth in zip(estimates, run.states, strict=True):
        assert each.covariance is not None, "the law has a covariance"
        error = np.append(each.q, each.u) - truth
        deviations = np.sqrt(np.diag(each.covariance))
        if each.stamp in near:
            z.append(error / deviations)
        elif np.min(np.abs(hits - each.stamp)) > margin:
            correlation = each.covariance / np.outer(deviations, deviations)
            variances, axes = np.linalg.eigh(correlation)
            kept = variances > LEAST * variances[-1]
            squares = (axes.T @ (error / deviations))[kept] ** 2 / variances[kept]
            part = min(int((each.stamp - EPOCH) / last * BINS), BINS - 1)
            nees[part].append(float(np.mean(squares)))
    means = np.array([np.mean(each) if each else np.nan for each in nees])
    within = np.mean(np.abs(z) < 3, axis=0) if z else np.full(1, np.nan)
    return Outcome(means, float(np.min(within)), float(np.mean(np.square(z))))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print both tables."""
    parser = argparse.ArgumentParser(prog="./dev bench nees", description=__doc__)
    parser.add_argument("--runs", type=int, default=75, help="of each rig (default 75)")
    parser.add_argument("--rigs", nargs="+", choices=RIGS, default=[*RIGS], metavar="RIG")
    parser.add_argument("--processes", type=int, default=2)
    args = parser.parse_args(arguments)
    parts = [f"{k + 1}/{BINS}" for k in range(BINS)]
    away = Table("rig", "command", "runs", *parts, "largest mean", title="NEES/2n, away")
    near = Table("rig", "command", "within 3", "worst run", "mean square", title="near impacts")
    with Parallel(args.processes) as pool:
        for name in args.rigs:
            made = pool(delayed(outcomes)(name, seed) for seed in range(args.runs))
            for k, command in enumerate(COMMANDS):
                some = [each[k] for each in made if each]
                nees = np.array([each.nees for each in some])
                middle, mean = np.nanmedian(nees, axis=0), np.nanmean(nees, axis=0)
                cells = (*middle, np.max(mean))
                away.add_row(name, command, f"{len(some)}", *(f"{each:.2g}" for each in cells))
                shares = [each.within for each in some]
                square = np.nanmedian([each.square for each in some])
                cells = f"{np.nanmean(shares):.1%}", f"{np.nanmin(shares):.0%}", f"{square:.2g}"
                near.add_row(name, command, *cells)
    Console().print(away, near)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
