# SPDX-License-Identifier: Apache-2.0
"""Estimates with sensor faults, and the goals for them: ``./dev bench troubles``.

A table for each model, without timing. Each scenario is a sensor with faults; each run starts with
an initial error that is standard normal in every coordinate. The tables have V over the initial V
at the end, median and worst, of

- ``minimum-variance``, given the standard deviation of the stamps where the scenario says so and,
  where the sensor is late, 20 ms for that of their offset; all other options are defaults;
- an oracle: the same filter given which events are spurious, which contact was hit, when an
  impact was missed and whether a contact then rests, the delay, and the standard deviation of the
  stamps. At a missed impact its estimate jumps where the plant does and is not corrected;
- ``geometric``, with its defaults.

Further columns are the goals; in how many runs ``minimum-variance`` ended worse than
``geometric``; in how many ``synchronized`` was ever true while V was above the threshold of the
observer; and the normalised estimation error squared (NEES) of the published covariance at the
end, over 2n, which should be 1. For jitter alone also the Cramer-Rao bound, as mean V over the
mean initial V (``benchmarks/covariance.py``). A last table has harder systems, half as long.
docs/laws.md quotes these tables.

Events arrive as the sensor sends them. V is read farther from any impact than stamps may be wrong:
nearer, it would be the size of the jump.
"""

import argparse
import json
import multiprocessing
import os
import statistics
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from itertools import islice
from typing import NamedTuple

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.covariance import drawn, least
from benchmarks.harness import new_file
from benchmarks.impacts import energy
from benchmarks.laws import FAR_END
from impact_observer.errors import ImpactObserverError
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.impact_filter import ImpactFilter
from impact_observer.filter.uncertainty import Uncertainty
from impact_observer.model import System, parse_model, read_model
from impact_observer.observer import Law, Observer
from impact_observer.observer.laws.geometric import Geometric
from impact_observer.observer.laws.minimum_variance import MinimumVariance
from impact_observer.options import Options
from impact_observer.plant import (
    Plant,
    Run,
    SensorMessage,
    SensorModel,
    SensorSimulation,
    Switching,
    simulate,
    simulate_sensor,
)
from impact_observer.stamps import NS_PER_S, from_seconds, grid, seconds_between
from impact_observer.states import Matrix, Vector

EPOCH = 5 * NS_PER_S
RATE = 10.0
MODELS = ("two_mass", "three_mass")
LATE = 0.02
"""Declared standard deviation of the offset of stamps, s."""
FEW = 10
"""Most runs of a scenario in the table of harder systems."""
WIDTH = 100
"""Columns of a table."""
LEGEND = """\
median/worst of V over the initial V at the end; worse: runs that ended worse than geometric;
flag: runs in which `synchronized` was wrong, of those in which it was true; NEES: over 2n, mean;
short: the goals not met"""
_BESIDE = 1e-6
"""Least distance from an impact at which V is read, s."""
_ROUNDED = 1e-12
"""Eigenvalue of a correlation matrix that counts as rounding, relative to the largest."""


@dataclass(frozen=True, slots=True)
class Scenario:
    """A sensor with faults, and the options of the observer.

    Attributes:
        name: of the scenario.
        sensor: without spurious impacts.
        spurious: spurious impacts, over the true ones.
        declared: whether the observer is given the standard deviation of the stamps.
        goals: median and worst of V over the initial V; None for harder systems.
    """

    name: str
    sensor: SensorModel
    spurious: float = 0.0
    declared: bool = True
    goals: tuple[float, float] | None = None

    def uncertainty(self) -> Uncertainty:
        """The options of ``minimum-variance``."""
        return Uncertainty(
            clock_error=self.sensor.jitter if self.declared else None,
            clock_offset_error=LATE if self.sensor.delay else 0.0,
        )


SCENARIOS = (
    Scenario("clean", SensorModel(), goals=(1e-16, 1e-14)),
    Scenario("jitter 1 ms", SensorModel(jitter=1e-3), goals=(1e-8, 1e-6)),
    Scenario("not declared", SensorModel(jitter=1e-3), declared=False, goals=(1e-6, 1e-4)),
    Scenario("20 % spurious", SensorModel(), spurious=0.2, goals=(1e-14, 1e-6)),
    Scenario("20 % missed", SensorModel(missed=0.2), goals=(1e-6, 1e-2)),
    Scenario("20 % both", SensorModel(missed=0.2), spurious=0.2, goals=(1e-3, 1e-1)),
    Scenario("10 ms late", SensorModel(delay=0.01), goals=(1e-4, 1e-2)),
)
HARDER = (
    ("far_end", Scenario("20 % both", SensorModel(missed=0.2), spurious=0.2)),
    ("far_end", Scenario("impacts only", SensorModel(impacts_only=True))),
    ("random", Scenario("20 % both", SensorModel(missed=0.2), spurious=0.2)),
    ("three_mass", Scenario("10 % mislabelled", SensorModel(mislabelled=0.1))),
)
"""Systems and scenarios of the last table; ``random`` is a new chain in every run."""


class Job(NamedTuple):
    """A run to be made."""

    model: str
    scenario: Scenario
    seed: int
    seconds: int


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedPlant:
    """A plant's run.

    Attributes:
        system: of the plant.
        start: its state at the epoch, shape (2n,).
        run: its impacts and states.
    """

    system: System
    start: Vector
    run: Run

    def messages(self, scenario: Scenario, seed: int) -> tuple[SensorMessage, ...]:
        """The messages of the sensor, in the order of arrival."""
        last, switchings = int(self.run.stamps[-1]), self.run.switchings
        rate = scenario.spurious * len(self.run.impacts) / seconds_between(EPOCH, last)
        sensor = replace(scenario.sensor, spurious=rate)
        return simulate_sensor(sensor, self.system, switchings, epoch=EPOCH, last=last, seed=seed)

    def detections(self, scenario: Scenario, seed: int) -> list[tuple[int, Switching, bool]]:
        """All switchings: stamp without the delay, the switching, whether it was detected.

        The draws of one fault do not change those of another: the rest is as in ``messages``.
        """
        sensing = SensorSimulation(scenario.sensor, self.system, epoch=EPOCH, seed=seed)
        delay = from_seconds(scenario.sensor.delay)
        found = []
        for each in self.run.switchings:
            if each.switches:
                sensing.detect(each)
                sent = [sensed.event.stamp for sensed in sensing.due(each.instant.stamp + delay)]
                stamp = sent[0] - delay if sent else each.instant.stamp
                found.append((max(stamp, EPOCH), each, bool(sent)))
        return sorted(found, key=lambda each: each[0])

    def clear_samples(self, scenario: Scenario) -> np.ndarray:
        """Samples far enough from any impact, as indices of the run's stamps."""
        margin = from_seconds(5 * scenario.sensor.jitter + scenario.sensor.delay + _BESIDE)
        impacts = np.array([each.instant.stamp for each in self.run.impacts], dtype=np.int64)
        near = np.abs(self.run.stamps[:, None] - impacts).min(axis=1, initial=2 * margin) <= margin
        return np.flatnonzero(~near)


@dataclass(frozen=True, slots=True)
class TroubleResult:
    """One run.

    Attributes:
        model: name.
        scenario: name.
        seed: of the initial error and the sensor.
        start: the initial V, J.
        ratios: V at the end over the initial V, by law and for the ``oracle``.
        nees: normalised estimation error squared of ``minimum-variance`` at the end, over 2n.
        flagged: samples at which ``synchronized`` was true.
        wrong: of these, samples at which V was above the threshold.
    """

    model: str
    scenario: str
    seed: int
    start: float
    ratios: dict[str, float]
    nees: float
    flagged: int
    wrong: int


@lru_cache(maxsize=4)
def simulated_plant(name: str, seconds: int, seed: int = 0) -> SimulatedPlant:
    """Simulate a sample model, a model file, ``far_end``, or a ``random`` chain."""
    if name == "random":
        system, start = drawn(name, np.random.default_rng([2014, seed]))
    else:
        model = parse_model(FAR_END, name) if name == "far_end" else read_model(name)
        system, start = model.system, np.concatenate(model.initial_state())
    stamps = grid(EPOCH, EPOCH + seconds * NS_PER_S, RATE)
    return SimulatedPlant(
        system, start, simulate(Plant(system, *np.split(start, 2), epoch=EPOCH), stamps)
    )


def outcome(job: Job) -> TroubleResult:
    """Run the observers and the oracle on the messages of one sensor."""
    name, scenario, seed, seconds = job
    case = simulated_plant(name, seconds, seed if name == "random" else 0)
    system = case.system
    x = case.start + np.random.default_rng(seed).normal(size=2 * system.n)
    messages, samples = case.messages(scenario, seed), case.clear_samples(scenario)
    end, truth = int(case.run.stamps[samples[-1]]), case.run.states[samples[-1]]
    robust = _observer(MinimumVariance(system, scenario.uncertainty()), x)
    flagged, wrong = flags(robust, case, messages, samples)
    last = robust.estimate(end)
    geometric = _observer(Geometric(system), x)
    for each in messages:
        if each.arrival <= end:
            geometric.receive(each.event)
    final = geometric.estimate(end)
    states = {
        "minimum-variance": np.concatenate([last.q, last.u]),
        "oracle": oracle(case, scenario, seed, x, end),
        "geometric": np.concatenate([final.q, final.u]),
    }
    V0 = float(energy(system, x - case.start))
    return TroubleResult(
        model=name,
        scenario=scenario.name,
        seed=seed,
        start=V0,
        ratios={law: float(energy(system, state - truth)) / V0 for law, state in states.items()},
        nees=nees(last.covariance, states["minimum-variance"] - truth),
        flagged=flagged,
        wrong=wrong,
    )


def _observer(law: Law, x: Vector) -> Observer:
    return Observer(law.system, law, *np.split(x, 2), epoch=EPOCH)


def flags(
    observer: Observer,
    case: SimulatedPlant,
    messages: Sequence[SensorMessage],
    samples: np.ndarray,
) -> tuple[int, int]:
    """The number of samples with ``synchronized``, and of those where it was wrong.

    Args:
        observer: a new one; afterwards it has received all events up to the last sample.
        case: the truth.
        messages: of the sensor, in the order of arrival.
        samples: where estimates are compared, as indices of the truth's stamps.
    """
    flagged, wrong, done = 0, 0, 0
    for k in samples.tolist():
        stamp = int(case.run.stamps[k])
        while done < len(messages) and messages[done].arrival <= stamp:
            observer.receive(messages[done].event)
            done += 1
        now = observer.estimate(stamp)
        if now.synchronized:
            differences = np.concatenate([now.q, now.u]) - case.run.states[k]
            then = observer.estimate(now.last_event)
            moving = energy(case.system, np.concatenate([then.q, then.u]))
            flagged += 1
            wrong += int(energy(case.system, differences) > Options.agreed * moving)
    return flagged, wrong


def oracle(case: SimulatedPlant, scenario: Scenario, seed: int, x: Vector, end: int) -> Vector:
    """The oracle's state at the stamp ``end``, from the initial state ``x``."""
    system, index = case.system, case.system.contact_names.index
    clock = MinimumVariance(system, Uncertainty(clock_error=scenario.sensor.jitter)).clocks[0]
    filter_, since = ImpactFilter(system), 0.0
    state = filter_.begin(GaussianState.of(x[None], Uncertainty().root(system.n)))
    for stamp, switching, detected in case.detections(scenario, seed):
        if stamp > end:
            break
        t = seconds_between(EPOCH, stamp) if detected else -switching.instant.until(EPOCH)
        state = filter_.predict(since, state).prior(t - since)
        switches = [(index(each.contact), each.kind) for each in switching.switches]
        change = ContactChange.of(t, state.closed, switches)
        prior = filter_.conditioning.joint_prior(change, state, clock if detected else 0.0)
        state = filter_.conditioning.after_jump(
            change, filter_.conditioning.joint_posterior(change, prior) if detected else prior
        )
        since = t
    return filter_.predict(since, state).state(seconds_between(EPOCH, end) - since)


def nees(covariance: Matrix, error: Vector) -> float:
    """Normalised estimation error squared, over its degrees of freedom above rounding."""
    unsure = np.diag(covariance) > 0  # a contact at rest leaves no uncertainty
    deviations = np.sqrt(np.diag(covariance)[unsure])
    correlation = covariance[np.ix_(unsure, unsure)] / np.outer(deviations, deviations)
    values, axes = np.linalg.eigh(correlation)
    kept = values > _ROUNDED * values[-1]
    normal = (axes.T @ (error[unsure] / deviations))[kept]
    return float(np.mean(normal**2 / values[kept]))


def cells(scenario: Scenario, group: Sequence[TroubleResult]) -> list[str]:
    """The row of one model in one scenario, without its name."""
    found = []
    if scenario.goals:
        found.append("{:.0e}/{:.0e}".format(*scenario.goals))
    summed = {law: summary([each.ratios[law] for each in group]) for law in group[0].ratios}
    ours = summed.pop("minimum-variance")
    found.append("{:.1e}/{:.1e}".format(*ours))
    found += ["{:.0e}/{:.0e}".format(*each) for each in summed.values()]
    worse = sum(each.ratios["minimum-variance"] > each.ratios["geometric"] for each in group)
    flagged, wrong = sum(e.flagged > 0 for e in group), sum(e.wrong > 0 for e in group)
    mean = statistics.fmean(each.nees for each in group)
    found += [f"{worse}/{len(group)}", f"{wrong}/{flagged}", f"{mean:.2g}"]
    if scenario.goals:
        above = [goal < value for goal, value in zip(scenario.goals, ours, strict=True)]
        found.append(("", "worst", "median", "both")[2 * above[0] + above[1]])
    return found


def summary(ratios: Sequence[float]) -> tuple[float, float]:
    """Median and worst."""
    return statistics.median(ratios), max(ratios)


def print_table(
    rows: Sequence[tuple[Scenario, Sequence[TroubleResult]]], title: str, console: Console
) -> None:
    """One table; with goals where the scenarios have them."""
    table = Table(
        box=box.SIMPLE_HEAD,
        title=title,
        title_justify="left",
        padding=(0, 1, 0, 0),
        pad_edge=False,
    )
    with_goals = rows[0][0].goals is not None
    table.add_column("scenario" if with_goals else "system and scenario", no_wrap=True)
    headings = ["min.-variance", "oracle", "geometric", "worse", "flag", "NEES"]
    for heading in ["goal", *headings, "short"] if with_goals else headings:
        table.add_column(heading, justify="right", no_wrap=True)
    for scenario, group in rows:
        name = scenario.name if with_goals else f"{group[0].model}, {scenario.name}"
        table.add_row(name, *cells(scenario, group))
    console.print(table)


def print_bound(group: Sequence[TroubleResult], seconds: int, console: Console) -> None:
    """The mean V of runs with jitter, and its Cramer-Rao bound."""
    final = sum(each.ratios["minimum-variance"] * each.start for each in group)
    console.print(
        f"  {group[0].scenario}: mean V / mean V0 {final / sum(each.start for each in group):.1e};"
        f" no unbiased estimator can expect less than {least(group[0].model, seconds):.1e}",
        highlight=False,
    )


def run(jobs: Sequence[Job], workers: int) -> list[TroubleResult]:
    """Run ``jobs`` in so many processes, in their order."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # threads only wait for small matrices
    context, console = multiprocessing.get_context("spawn"), Console(stderr=True)
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        try:
            found = pool.map(outcome, jobs)
            return list(track(found, "runs", total=len(jobs), console=console, transient=True))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def jobs_of(
    models: Sequence[str], runs: int, seconds: int
) -> dict[tuple[str, Scenario], list[Job]]:
    """All runs of every model and scenario."""
    plan = {(name, each): runs for name in models if name != "harder" for each in SCENARIOS}
    if "harder" in models:
        plan |= dict.fromkeys(HARDER, min(runs, FEW))
    return {
        (name, each): [
            Job(name, each, seed, seconds if each.goals else max(seconds // 2, 1))
            for seed in range(count)
        ]
        for (name, each), count in plan.items()
    }


def main(args: Sequence[str] | None = None) -> int:
    """Run the scenarios and print the tables.

    Returns:
        0; 2 for wrong use.
    """
    parser = argparse.ArgumentParser(prog="./dev bench troubles", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    tables = (*MODELS, "harder")
    parser.add_argument("--runs", type=int, default=40, metavar="N", help="(default 40)")
    parser.add_argument("--seconds", type=int, default=60, metavar="S", help="(default 60)")
    parser.add_argument("--models", nargs="+", choices=tables, default=tables, metavar="MODEL")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, metavar="N")
    parser.add_argument("--json", type=new_file, metavar="FILE", help="write every run to FILE")
    given = parser.parse_args(args)
    if min(given.runs, given.seconds, given.workers) < 1:
        parser.error("arguments --runs, --seconds, --workers: expected numbers above 0")
    groups = jobs_of(given.models, given.runs, given.seconds)
    try:
        outcomes = run([job for group in groups.values() for job in group], given.workers)
    except ImpactObserverError as error:
        parser.error(str(error))
    found, console = iter(outcomes), Console(width=WIDTH)
    rows = [(each, list(islice(found, len(group)))) for (_, each), group in groups.items()]
    for name in dict.fromkeys(given.models):
        mine = [row for row in rows if (row[1][0].model if row[0].goals else "harder") == name]
        seconds = given.seconds if mine[0][0].goals else max(given.seconds // 2, 1)
        print_table(mine, f"{name}, {seconds} s", console)
        for scenario, group in mine:
            if scenario.goals and scenario.sensor.jitter:
                print_bound(group, given.seconds, console)
    console.print(LEGEND, highlight=False)
    if given.json:
        document = {"seconds": given.seconds, "runs": [asdict(each) for each in outcomes]}
        given.json.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
