"""What wrong events do to an estimate, and what they need do: ``./dev bench troubles``.

A table a model, without any timing. Each scenario is a sensor with a trouble; each run of it
begins with an initial error that is standard normal in every coordinate. V over the initial V at
the end, median and worst, of

- ``minimum-variance``, told the clock's error where the scenario says so and, where the sensor is
  late, that stamps may be late by 20 ms; all else as it comes, and the same in every scenario;
- an oracle: the same filter told which events are spurious, which contact was hit, and when one
  was missed. From that it learns nothing but to jump where the plant does (and that a contact
  then rests, where it does). It knows the delay, and the clock's error;
- ``geometric``, which is told of no trouble.

Beside them what is aimed at, in how many runs ``minimum-variance`` ended worse than
``geometric``, in how many ``synchronized`` was ever true while V was above what the observer takes
for agreement, and the normalised estimation error squared of the published covariance at the end,
over 2n: 1 is honest. For jitter alone also what the Cramer-Rao bound lets any unbiased estimator
expect, as mean V over the mean initial V (``benchmarks/covariance.py``). A last table has harder
systems, half as long. What docs/laws.md says of wrong events rests on these.

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
from benchmarks.laws import FAR_END
from impact_observer.dynamics.lyapunov import distance
from impact_observer.errors import ImpactObserverError
from impact_observer.estimation.contact_change import ContactChange
from impact_observer.estimation.gaussian_state import GaussianState
from impact_observer.estimation.impact_filter import ImpactFilter
from impact_observer.estimation.uncertainty import Uncertainty
from impact_observer.model import System, parse_model, read_model
from impact_observer.observer import AGREED, Law, Observer
from impact_observer.observer.laws.geometric import Geometric
from impact_observer.observer.laws.minimum_variance import MinimumVariance
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
"""Standard deviation that is declared of what stamps are late by, s."""
FEW = 10
"""Most runs of a scenario in the table of harder systems."""
WIDTH = 100
"""Of the tables, in columns."""
LEGEND = """\
median/worst of V over the initial V at the end; worse: runs that ended worse than geometric;
flag: runs in which `synchronized` was wrong, of those in which it came; NEES: over 2n, mean;
short: of which goals"""
_BESIDE = 1e-6
"""V is read at least so far from an impact, s."""
_ROUNDED = 1e-12
"""Eigenvalues of a correlation matrix that are rounding, relative to the largest."""


@dataclass(frozen=True, slots=True)
class Scenario:
    """A sensor with a trouble, and what is declared of it.

    Attributes:
        name: of the scenario.
        sensor: but for what it invents.
        spurious: spurious impacts, over the true ones.
        declared: that the clock's error is told.
        goals: aimed at: median and worst of V over the initial V; none for harder systems.
    """

    name: str
    sensor: SensorModel
    spurious: float = 0.0
    declared: bool = True
    goals: tuple[float, float] | None = None

    def uncertainty(self) -> Uncertainty:
        """What ``minimum-variance`` is told."""
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
    """A run to be done."""

    model: str
    scenario: Scenario
    seed: int
    seconds: int


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A plant's run.

    Attributes:
        system: what moved.
        start: its state at the epoch, shape (2n,).
        run: what it did.
    """

    system: System
    start: Vector
    run: Run

    def told(self, scenario: Scenario, seed: int) -> tuple[SensorMessage, ...]:
        """All that the sensor tells, in the order of arrival."""
        last, switchings = int(self.run.stamps[-1]), self.run.switchings
        rate = scenario.spurious * len(self.run.impacts) / seconds_between(EPOCH, last)
        sensor = replace(scenario.sensor, spurious=rate)
        return simulate_sensor(sensor, self.system, switchings, epoch=EPOCH, last=last, seed=seed)

    def felt(self, scenario: Scenario, seed: int) -> list[tuple[int, Switching, bool]]:
        """Stamps of all that has happened, on a clock that is not late, and whether it was told.

        What one trouble draws changes no draw of another: the rest is as in ``told``.
        """
        sensing = SensorSimulation(scenario.sensor, self.system, epoch=EPOCH, seed=seed)
        delay = from_seconds(scenario.sensor.delay)
        found = []
        for each in self.run.switchings:
            if each.switches:
                sensing.detect(each)
                heard = [sensed.event.stamp for sensed in sensing.due(each.instant.stamp + delay)]
                stamp = heard[0] - delay if heard else each.instant.stamp
                found.append((max(stamp, EPOCH), each, bool(heard)))
        return sorted(found, key=lambda each: each[0])

    def beside(self, scenario: Scenario) -> np.ndarray:
        """Samples that lie far enough from any impact, as indices of the run's stamps."""
        differences = from_seconds(5 * scenario.sensor.jitter + scenario.sensor.delay + _BESIDE)
        impacts = np.array([each.instant.stamp for each in self.run.impacts], dtype=np.int64)
        near = (
            np.abs(self.run.stamps[:, None] - impacts).min(axis=1, initial=2 * differences)
            <= differences
        )
        return np.flatnonzero(~near)


@dataclass(frozen=True, slots=True)
class Outcome:
    """One run.

    Attributes:
        model: name.
        scenario: name.
        seed: of the initial error and the sensor.
        start: V at first, J.
        ratios: V at the end over that, of ``minimum-variance``, ``oracle`` and ``geometric``.
        nees: normalised estimation error squared of ``minimum-variance`` at the end, over 2n.
        flagged: samples at which it said ``synchronized``.
        wrong: those of them at which V was above the threshold.
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
def case_of(name: str, seconds: int, seed: int = 0) -> Case:
    """Simulate a sample model, a model file, ``far_end``, or a ``random`` chain."""
    if name == "random":
        system, start = drawn(name, np.random.default_rng([2014, seed]))
    else:
        model = parse_model(FAR_END, name) if name == "far_end" else read_model(name)
        system, start = model.system, np.concatenate(model.initial_state())
    stamps = grid(EPOCH, EPOCH + seconds * NS_PER_S, RATE)
    return Case(system, start, simulate(Plant(system, *np.split(start, 2), epoch=EPOCH), stamps))


def outcome(job: Job) -> Outcome:
    """Run the observers and the oracle on what one sensor told."""
    name, scenario, seed, seconds = job
    case = case_of(name, seconds, seed if name == "random" else 0)
    system = case.system
    x = case.start + np.random.default_rng(seed).normal(size=2 * system.n)
    told, samples = case.told(scenario, seed), case.beside(scenario)
    end, truth = int(case.run.stamps[samples[-1]]), case.run.states[samples[-1]]
    robust = _observer(MinimumVariance(system, scenario.uncertainty()), x)
    flagged, wrong = flags(robust, case, told, samples)
    last = robust.estimate(end)
    geometric = _observer(Geometric(system), x)
    for each in told:
        if each.arrival <= end:
            geometric.receive(each.event)
    final = geometric.estimate(end)
    states = {
        "minimum-variance": np.concatenate([last.q, last.u]),
        "oracle": oracle(case, scenario, seed, x, end),
        "geometric": np.concatenate([final.q, final.u]),
    }
    V0 = _energy(system, x - case.start)
    return Outcome(
        model=name,
        scenario=scenario.name,
        seed=seed,
        start=V0,
        ratios={law: _energy(system, state - truth) / V0 for law, state in states.items()},
        nees=surprise(last.covariance, states["minimum-variance"] - truth),
        flagged=flagged,
        wrong=wrong,
    )


def _observer(law: Law, x: Vector) -> Observer:
    return Observer(law.system, law, *np.split(x, 2), epoch=EPOCH)


def _energy(system: System, x: Vector) -> float:
    """Kinetic and elastic, J, of a state (q, u); of a difference it is ``V``."""
    return float(distance(system, *np.split(x, 2)))


def flags(
    observer: Observer, case: Case, told: Sequence[SensorMessage], samples: np.ndarray
) -> tuple[int, int]:
    """At how many samples an observer was ``synchronized``, and at how many of them wrongly.

    Args:
        observer: has seen nothing yet; has seen all up to the last sample then.
        case: the truth.
        told: what it hears, in the order of arrival.
        samples: where to ask, as indices of the truth's stamps.
    """
    flagged, wrong, done = 0, 0, 0
    for k in samples.tolist():
        stamp = int(case.run.stamps[k])
        while done < len(told) and told[done].arrival <= stamp:
            observer.receive(told[done].event)
            done += 1
        now = observer.estimate(stamp)
        if now.synchronized:
            differences = np.concatenate([now.q, now.u]) - case.run.states[k]
            then = observer.estimate(now.last_event)
            moving = _energy(case.system, np.concatenate([then.q, then.u]))
            flagged += 1
            wrong += _energy(case.system, differences) > AGREED * moving
    return flagged, wrong


def oracle(case: Case, scenario: Scenario, seed: int, x: Vector, end: int) -> Vector:
    """What one knows at the stamp ``end`` who is told what every event is, from ``x`` on."""
    system, index = case.system, case.system.contact_names.index
    clock = MinimumVariance(system, Uncertainty(clock_error=scenario.sensor.jitter)).clocks[0]
    filter_, since = ImpactFilter(system), 0.0
    state = filter_.begin(GaussianState.of(x[None], Uncertainty().root(system.n)))
    for stamp, switching, heard in case.felt(scenario, seed):
        if stamp > end:
            break
        t = seconds_between(EPOCH, stamp) if heard else -switching.instant.until(EPOCH)
        state = filter_.predict(since, state).prior(t - since)
        switches = [(index(each.contact), each.kind) for each in switching.switches]
        change = ContactChange.of(t, state.closed, switches)
        prior = filter_.joint_prior(change, state, clock if heard else 0.0)
        state = filter_.posterior(
            change, filter_.joint_posterior(change, prior) if heard else prior
        )
        since = t
    return filter_.predict(since, state).state(seconds_between(EPOCH, end) - since)


def surprise(covariance: Matrix, error: Vector) -> float:
    """Normalised error squared over its degrees of freedom: those that are more than rounding."""
    unsure = np.diag(covariance) > 0  # a contact at rest leaves nothing to know
    deviations = np.sqrt(np.diag(covariance)[unsure])
    correlation = covariance[np.ix_(unsure, unsure)] / np.outer(deviations, deviations)
    values, axes = np.linalg.eigh(correlation)
    kept = values > _ROUNDED * values[-1]
    normal = (axes.T @ (error[unsure] / deviations))[kept]
    return float(np.mean(normal**2 / values[kept]))


def cells(scenario: Scenario, group: Sequence[Outcome]) -> list[str]:
    """What the runs of one model in one scenario come to: a row, without its name."""
    found = []
    if scenario.goals:
        found.append("{:.0e}/{:.0e}".format(*scenario.goals))
    summed = {law: summary([each.ratios[law] for each in group]) for law in group[0].ratios}
    ours = summed.pop("minimum-variance")
    found.append("{:.1e}/{:.1e}".format(*ours))
    found += ["{:.0e}/{:.0e}".format(*each) for each in summed.values()]
    worse = sum(each.ratios["minimum-variance"] > each.ratios["geometric"] for each in group)
    came, wrong = sum(e.flagged > 0 for e in group), sum(e.wrong > 0 for e in group)
    nees = statistics.fmean(each.nees for each in group)
    found += [f"{worse}/{len(group)}", f"{wrong}/{came}", f"{nees:.2g}"]
    if scenario.goals:
        above = [goal < value for goal, value in zip(scenario.goals, ours, strict=True)]
        found.append(("", "worst", "median", "both")[2 * above[0] + above[1]])
    return found


def summary(ratios: Sequence[float]) -> tuple[float, float]:
    """Median and worst."""
    return statistics.median(ratios), max(ratios)


def print_table(
    rows: Sequence[tuple[Scenario, Sequence[Outcome]]], title: str, console: Console
) -> None:
    """One table; what is aimed at only where there is such a thing."""
    table = Table(
        box=box.SIMPLE_HEAD,
        title=title,
        title_justify="left",
        padding=(0, 1, 0, 0),
        pad_edge=False,
    )
    aimed = rows[0][0].goals is not None
    table.add_column("scenario" if aimed else "system and scenario", no_wrap=True)
    headings = ["min.-variance", "oracle", "geometric", "worse", "flag", "NEES"]
    for heading in ["goal", *headings, "short"] if aimed else headings:
        table.add_column(heading, justify="right", no_wrap=True)
    for scenario, group in rows:
        name = scenario.name if aimed else f"{group[0].model}, {scenario.name}"
        table.add_row(name, *cells(scenario, group))
    console.print(table)


def print_bound(group: Sequence[Outcome], seconds: int, console: Console) -> None:
    """The mean of jittered runs, beside what is to be expected of the best estimator."""
    final = sum(each.ratios["minimum-variance"] * each.start for each in group)
    console.print(
        f"  {group[0].scenario}: mean V / mean V0 {final / sum(each.start for each in group):.1e};"
        f" no unbiased estimator can expect less than {least(group[0].model, seconds):.1e}",
        highlight=False,
    )


def run(jobs: Sequence[Job], workers: int) -> list[Outcome]:
    """Run ``jobs`` in as many processes, the order kept."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # threads for small matrices only wait
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
    """Run what is asked for.

    Returns:
        0; 2 for wrong use.
    """
    parser = argparse.ArgumentParser(prog="./dev bench troubles", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    known = (*MODELS, "harder")
    parser.add_argument("--runs", type=int, default=40, metavar="N", help="(default 40)")
    parser.add_argument("--seconds", type=int, default=60, metavar="S", help="(default 60)")
    parser.add_argument("--models", nargs="+", choices=known, default=known, metavar="MODEL")
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
