# SPDX-License-Identifier: Apache-2.0
"""Encoders beside impacts: ``./dev bench measurements``.

Plants of two_mass, three_mass and a pair of bodies that floats freely, an encoder on ``x1`` with
100 Hz and 1 mm of noise, impacts with stamps that jitter by 1 ms; noises are declared, initial
errors are normal as declared. Three tables:

- accuracy: the root mean square error of all runs in the norm of V (for the floating pair with
  the masses instead of the stiffness, which is singular) over the Cramer-Rao bound, which is that
  of the covariance of an unbiased estimator that linearises at the true states: mean and root
  mean square over all instants, that of the median run, in the second second and at the end; the
  normalised estimation error squared over 2n, which should be 1; and the same where 20 % of the
  impacts are missed and as many are false, relative to the clean runs;
- what each source is worth: encoder alone, by a Kalman filter without stops whose process noise
  is the best of several; impacts alone; both;
- processor time for each sample at 1 kHz.

Instants nearer than five deviations of the clock to an impact do not count.
"""

import argparse
import multiprocessing
import os
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import linalg

from impact_observer.dynamics import ImpactLaw, Phases
from impact_observer.events import ImpactEvent
from impact_observer.filter.saltation import Measured, Mirror, StateRates
from impact_observer.filter.square_root import correction, triangular
from impact_observer.model import Model, System, parse_model, read_model
from impact_observer.model.measurement import Measurement
from impact_observer.observer import make_observer
from impact_observer.observer.samples import SensorSample
from impact_observer.options import Options
from impact_observer.plant import Plant, Run, SensorModel, simulate, simulate_sensor
from impact_observer.plant.switching import Switching
from impact_observer.stamps import NS_PER_S, grid, seconds_between

EPOCH = 5 * NS_PER_S
RATE, NOISE, JITTER = 100.0, 1e-3, 1e-3
"""Of the encoder, Hz and m; of the stamps of impacts, s."""
DEVIATION = 0.2
"""Of the initial state, m and m/s."""
MARGIN = 5 * JITTER
FLOATING = """
name: floating
bodies: [{name: x1, mass: 1}, {name: x2, mass: 1.5}]
springs: [{between: [x1, x2], stiffness: 20, damping: 0.1}]
stops: [{name: stop, between: [x1, x2], gap: 0.1, restitution: 0.7}]
forces: [{body: x1, amplitude: 2, frequency: 4.1, phase: 0}]
initial_state: {position: [0, 0.1], velocity: [0.3, 0]}
"""
MODELS = ("two_mass", "three_mass", "floating")
TROUBLED = SensorModel(jitter=JITTER, missed=0.2, spurious=0.13)
NOISES = (0.1, 0.3, 1.0, 3.0, 10.0)
"""Process noise of the Kalman filter without stops, m/s^1.5: the best of them counts."""

Array = NDArray[np.float64]


class Drawn(NamedTuple):
    """A run of the plant, and what sensors make of it.

    Attributes:
        run: with states at the stamps of the encoder.
        events: of the sensor of impacts.
        samples: of the encoder.
        start: the initial estimate, shape (2n,).
    """

    run: Run
    events: list[ImpactEvent]
    samples: list[SensorSample]
    start: Array


@cache
def model_named(name: str) -> Model:
    """A sample model, or the pair that floats."""
    return parse_model(FLOATING, name) if name == "floating" else read_model(name)


@cache
def true_run(name: str, seconds: float, rate: float = RATE) -> Run:
    """The plant of a model."""
    model = model_named(name)
    stamps = grid(EPOCH, EPOCH + round(seconds * NS_PER_S), rate)
    return simulate(Plant(model.system, *model.initial_state(), epoch=EPOCH), stamps)


def encoder(deviation: float = NOISE) -> Measurement:
    """On the first body."""
    return Measurement("encoder", "/encoder", "x1", "position", deviation=deviation)


def drawn(name: str, seconds: float, sensor: SensorModel, seed: int) -> Drawn:
    """What the sensors make of the run of a plant."""
    run, rng = true_run(name, seconds), np.random.default_rng([2023, seed])
    system = model_named(name).system
    last = int(run.stamps[-1])
    received = simulate_sensor(sensor, system, run.switchings, epoch=EPOCH, last=last, seed=seed)
    values = run.states[:, 0] + NOISE * rng.normal(size=run.stamps.size)
    samples = [
        SensorSample(0, s, v) for s, v in zip(run.stamps.tolist(), values.tolist(), strict=True)
    ]
    start = run.states[0] + DEVIATION * rng.normal(size=2 * system.n)
    return Drawn(run, [each.event for each in received], samples[1:], start)


def metric(system: System) -> Array:
    """Of errors: that of V; masses instead of a singular stiffness."""
    singular = linalg.eigvalsh(system.K, system.M)[0] < 1e-9
    return np.asarray(linalg.block_diag(system.M if singular else system.K, system.M))


def bounds(name: str, seconds: float, *, encodes: bool = True, impacts: bool = True) -> Array:
    """Roots of the least covariance at each stamp of the encoder, shape (samples, 2n, 2n)."""
    system, run = model_named(name).system, true_run(name, seconds)
    phases, law, n = Phases(system), ImpactLaw(system), system.n
    phase = phases.phase()
    rates, root, last = StateRates(phase), DEVIATION * np.eye(2 * n), 0.0
    found, row = [root], np.eye(2 * n)[:1]
    marks: list[tuple[float, int, Switching | None]]
    marks = [(-each.instant.until(EPOCH), 0, each) for each in run.impacts if impacts]
    marks += [(seconds_between(EPOCH, s), 1, None) for s in run.stamps[1:].tolist()]
    for t, _, each in sorted(marks, key=lambda mark: mark[:2]):
        root, last = phase.transition(t - last) @ root, t
        if each is None:
            if encodes:
                root = correction(root, row, NOISE * np.eye(1)).root
            found.append(root)
            continue
        hit, forces = each.contacts, system.forcing.derivatives(np.array([t]), 2)[:, 0]
        joint = linalg.block_diag(JITTER, root)
        rows = Measured.gaps(system, hit).expanded(rates, each.before, forces).H
        corrected = correction(joint, rows, 1e-15 * np.eye(len(hit))).root
        mirror = Mirror.of(system, law.jump(hit), hit)
        jump = mirror.expanded(rates, rates, each.before, forces)
        root = triangular(jump.H @ corrected)
    return np.array(found)


def clear(run: Run) -> NDArray[np.bool_]:
    """Which stamps are far from any impact."""
    hits = np.array([each.instant.stamp for each in run.impacts])
    near = np.min(np.abs(run.stamps[:, None] - hits), axis=1)
    return np.asarray(near > MARGIN * NS_PER_S)


def followed(
    name: str, given: Drawn, options: Options, *, encodes: bool = True
) -> tuple[Array, Array]:
    """Errors and covariances at each stamp of the encoder: (samples, 2n), (samples, 2n, 2n)."""
    model = model_named(name)
    system, start = model.system, ",".join(map(repr, given.start.tolist()))
    options = replace(options, epoch=EPOCH, initial_state=start, initial_deviation=str(DEVIATION))
    observer = make_observer(system, options, measurements=[encoder()])
    events = sorted(given.events, key=lambda each: each.stamp)[::-1]
    errors, covariances = [], []
    samples = [None, *given.samples]
    for stamp, truth, sample in zip(
        given.run.stamps.tolist(), given.run.states, samples, strict=True
    ):
        while events and events[-1].stamp <= stamp:
            observer.receive(events.pop())
        if sample is not None and encodes:
            observer.measure([sample])
        estimate = observer.estimate(stamp)
        errors.append(np.concatenate([estimate.q, estimate.u]) - truth)
        covariances.append(estimate.covariance)
    return np.array(errors), np.array(covariances)


class Accuracy(NamedTuple):
    """Of one run, at the instants that count, over the second half of it.

    Attributes:
        squares: of the errors in the metric.
        consistency: normalised estimation error squared over 2n.
    """

    squares: Array
    consistency: Array


OPTIONS = Options(law="minimum-variance", clock_error=JITTER)
TRUSTED = replace(OPTIONS, missed=0.0, spurious=0.0, mislabelled=0.0, model_error=0.0)


def accuracy(
    name: str, seconds: float, sensor: SensorModel, options: Options, seed: int
) -> Accuracy:
    """Of one run."""
    given = drawn(name, seconds, sensor, seed)
    errors, covariances = followed(name, given, options)
    W, size = metric(model_named(name).system), errors.shape[1]
    squares = np.einsum("ki,ij,kj->k", errors, W, errors)
    scaled = np.linalg.solve(covariances, errors[..., None])[..., 0]
    return Accuracy(squares, np.einsum("ki,ki->k", errors, scaled) / size)


def accuracies(
    name: str, seconds: float, sensor: SensorModel, options: Options, runs: int
) -> list[Accuracy]:
    """Of several runs, on all cores."""
    job = partial(accuracy, name, seconds, sensor, options)
    with ProcessPoolExecutor(os.cpu_count(), multiprocessing.get_context("spawn")) as pool:
        return list(pool.map(job, range(runs), chunksize=4))


def print_accuracy(name: str, seconds: float, runs: int) -> None:
    """Print rows of clean and of troubled runs."""
    run, root = true_run(name, seconds), bounds(name, seconds)
    counted = clear(run)
    counted[: counted.size // 10] = False
    W = metric(model_named(name).system)
    least = np.einsum("kij,il,klj->k", root, W, root)[counted]
    print(f"\n{name}: {len(run.impacts)} impacts in {seconds:g} s, {runs} runs")
    headings = ("mean", "rms", "median run", "2nd second", "at the end", "NEES / 2n")
    print(f"{'':>10} " + " ".join(f"{each:>11}" for each in headings))
    clean = 0.0
    for label, sensor, options in (
        ("clean", SensorModel(jitter=JITTER), OPTIONS),
        ("troubled", TROUBLED, replace(OPTIONS, missed=0.2, spurious=0.2)),
    ):
        found = accuracies(name, seconds, sensor, options, runs)
        squares = np.array([each.squares for each in found])[:, counted]
        consistency = np.array([each.consistency for each in found])[:, counted]
        each = np.sqrt(squares.mean(axis=0) / least)
        mean, rms = float(np.mean(each)), float(np.sqrt(np.mean(each**2)))
        median = float(np.median(np.sqrt(np.mean(squares / least, axis=1))))
        early = float(np.mean(each[: round(RATE) - 1]))
        numbers = (mean, rms, median, early, each[-10:].mean(), consistency.mean())
        line = f"{label:>10} " + " ".join(f"{number:11.3f}" for number in numbers)
        print(line + (f"   {mean / clean:.3f} of clean" if clean else ""))
        clean = mean


def without_stops(model: Model) -> Model:
    """The model as a filter sees it that knows no impacts."""
    return replace(model, linear=replace(model.system, contacts=()))


def alone(name: str, given: Drawn, noise: float) -> Array:
    """Errors of a Kalman filter that knows the encoder only: shape (samples, 2n)."""
    system = without_stops(model_named(name)).system
    start = ",".join(map(repr, given.start.tolist()))
    options = replace(
        TRUSTED,
        epoch=EPOCH,
        initial_state=start,
        initial_deviation=str(DEVIATION),
        model_error=noise,
    )
    observer = make_observer(system, options, measurements=[replace(encoder(), gate=1e6)])
    errors = []
    samples = [None, *given.samples]
    for stamp, truth, sample in zip(
        given.run.stamps.tolist(), given.run.states, samples, strict=True
    ):
        if sample is not None:
            observer.measure([sample])
        estimate = observer.estimate(stamp)
        errors.append(np.concatenate([estimate.q, estimate.u]) - truth)
    return np.array(errors)


def sources(name: str, seconds: float, seed: int = 0) -> dict[str, Array]:
    """Errors of the three, by what they are made of: shape (samples, 2n) each."""
    given = drawn(name, seconds, SensorModel(jitter=JITTER), seed)
    half = given.run.stamps.size // 2
    tried = {noise: alone(name, given, noise) for noise in NOISES}
    best = min(tried, key=lambda noise: float(np.sum(tried[noise][half:] ** 2)))
    return {
        f"encoder alone (process noise {best:g})": tried[best],
        "impacts alone": followed(name, given, OPTIONS, encodes=False)[0],
        "both": followed(name, given, OPTIONS)[0],
    }


def print_sources(name: str, seconds: float, picture: Path | None) -> None:
    """Print what each source is worth, and draw it."""
    found = sources(name, seconds)
    system, counted = model_named(name).system, clear(true_run(name, seconds))
    counted[: counted.size // 2] = False
    names = [*system.coordinates, *(f"d{c}/dt" for c in system.coordinates)]
    print(f"\n{name}: rms error in the second half of {seconds:g} s, away from impacts, SI units")
    print(f"{'':>35} " + " ".join(f"{each:>9}" for each in names))
    for label, errors in found.items():
        rms = np.sqrt(np.mean(errors[counted] ** 2, axis=0))
        print(f"{label:>35} " + " ".join(f"{each:9.2e}" for each in rms))
    if picture is not None:
        draw(name, seconds, found, picture)
        print(f"picture: {picture}")


def draw(name: str, seconds: float, found: dict[str, Array], picture: Path) -> None:
    """Draw the error of the coordinate that the encoder does not see, and of its speed."""
    system, run = model_named(name).system, true_run(name, seconds)
    t = (run.stamps - EPOCH) / NS_PER_S
    with mpl.rc_context({"font.size": 9.0, "svg.hashsalt": "measurements"}):
        figure = Figure(figsize=(8.0, 4.2), layout="constrained")
        panels = figure.subplots(2, 1, sharex=True)
        columns = (system.n - 1, 2 * system.n - 1)
        labels = (f"{system.coordinates[-1]} [m]", f"d{system.coordinates[-1]}/dt [m/s]")
        for axes, column, label in zip(panels, columns, labels, strict=True):
            for k, (source, errors) in enumerate(found.items()):
                axes.semilogy(
                    t, np.abs(errors[:, column]) + 1e-9, color=f"C{k}", lw=0.9, label=source
                )
            for each in run.impacts:
                axes.axvline(-each.instant.until(EPOCH), color="0.8", lw=0.8, zorder=0)
            axes.set_ylabel(f"error of {label}")
            axes.set_ylim(1e-6, 3.0)
        panels[0].legend(frameon=False, ncol=3, loc="upper right", fontsize="small")
        panels[1].set_xlabel("time since the epoch [s]; lines: impacts")
        figure.savefig(picture, metadata={"Date": None})


def print_cost(seconds: float = 3.0, rounds: int = 3) -> None:
    """Print the processor time of a sample at 1 kHz, and how many hypotheses there are."""
    print("\nprocessor time of a sample at 1 kHz, the least of several rounds, microseconds")
    run = true_run("three_mass", seconds, 1000.0)
    rng, model = np.random.default_rng(1), model_named("three_mass")
    values = run.states[1:, 0] + NOISE * rng.normal(size=run.stamps.size - 1)
    samples = [
        SensorSample(0, s, v)
        for s, v in zip(run.stamps[1:].tolist(), values.tolist(), strict=True)
    ]
    cases = {
        "minimum-variance, all declared": TRUSTED,
        "minimum-variance, clock declared": OPTIONS,
        "minimum-variance, defaults": Options(law="minimum-variance"),
    }
    for label, options in cases.items():
        taken, followed_ = np.inf, 0
        for _ in range(rounds):
            observer = make_observer(
                model.system, replace(options, epoch=EPOCH), measurements=[encoder()]
            )
            events = [*run.events][::-1]
            begin = time.process_time()
            for sample in samples:
                while events and events[-1].stamp <= sample.stamp:
                    observer.receive(events.pop())
                observer.measure([sample])
            taken = min(taken, (time.process_time() - begin) / len(samples))
            timeline = observer.timeline
            assert timeline is not None
            followed_ = len(timeline.entries[-1].belief.hypotheses)
        print(f"{label:>35} {1e6 * taken:8.0f}   {followed_ or 1} hypotheses at the end")


def main(args: Sequence[str] | None = None) -> int:
    """Print the three tables."""
    parser = argparse.ArgumentParser(prog="./dev bench measurements")
    parser.add_argument("--runs", type=int, default=500, metavar="N", help="(default 500)")
    parser.add_argument("--seconds", type=float, default=10.0, metavar="S", help="(default 10)")
    parser.add_argument("--models", nargs="+", choices=MODELS, default=MODELS)
    parser.add_argument("--picture", type=Path, metavar="FILE", help="of what sources are worth")
    given = parser.parse_args(args)
    if given.runs < 1 or not given.seconds > 1:
        parser.error("--runs: expected 1 or more; --seconds: expected more than 1")
    print_cost()
    for name in given.models:
        print_sources(name, given.seconds, given.picture if name == "three_mass" else None)
    for name in given.models:
        print_accuracy(name, given.seconds, given.runs)
    return 0


if __name__ == "__main__":
    sys.exit(main())
