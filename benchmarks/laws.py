# SPDX-License-Identifier: Apache-2.0
"""How far each law reduces the error of a wrong initial state: ``./dev bench laws``.

Two tables, without timing. The first has V over the initial V just after the (2n + 2)-th impact
and after 30 s, as medians over 20 seeds; README and docs/laws.md quote it. The second has how
often ``synchronized`` was wrong: true while V was above the threshold of the observer.

Events are ideal, their stamps rounded to 1 ns. The plant starts at the model's initial state, and
the estimate of each seed at that state plus ``default_rng(seed).normal(2n)``: initial errors are
standard normal in every coordinate, the observer's default.
"""

import argparse
import json
import math
import statistics
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.harness import new_file
from benchmarks.impacts import energy
from impact_observer.errors import ImpactObserverError
from impact_observer.events import ImpactEvent, Kind
from impact_observer.filter.uncertainty import Uncertainty
from impact_observer.io.pairing import Samples, samples_of
from impact_observer.model import Model, System, parse_model, read_model
from impact_observer.observer import Observer, law_named, replay
from impact_observer.observer.laws import BUILT_IN
from impact_observer.options import Options
from impact_observer.plant import Plant, simulate
from impact_observer.stamps import from_seconds, grid, seconds_between
from impact_observer.states import Estimate, Stamps, Vector

FAR_END = """
name: far_end
bodies: [{name: x1, mass: 1}, {name: x2, mass: 1}, {name: x3, mass: 1}, {name: x4, mass: 1}]
springs:
  - {between: [ground, x1], stiffness: 50, damping: 0.05}
  - {between: [x1, x2], stiffness: 50, damping: 0.05}
  - {between: [x2, x3], stiffness: 50, damping: 0.05}
  - {between: [x3, x4], stiffness: 50, damping: 0.05}
forces: [{body: x4, amplitude: 5, frequency: 5}]
stops: [{name: stop, body: x1, limit: 0.02, side: above, restitution: 0.8}]
initial_state: {position: [0, -0.1, 0.05, 0.1], velocity: [0.5, 0, -0.5, 0.3]}
"""
"""Hard for a synchronization test that compares replicas: ten events a second, most with little
information, so that agreement over many events in a row proves nothing; persistent contacts; and
three masses whose motion reaches the contact only through a chain of weakly damped springs. A ball
would be no test: V does not depend on its height, and it comes to rest.
"""

IDEAL = Uncertainty(clock_error=0.0)
"""Stamps are only rounded; missed and spurious impacts are left at their defaults."""
MODELS = ("two_mass", "three_mass", "far_end")
EPOCH = 1_000_000_000
RATE = 10.0
SEEDS_OF_MEDIAN = 20
END = 30.0
"""Time of the first table's last column, s."""
_BESIDE = 1_000
"""V is read so long after an impact, ns, since the rounded stamp may precede it."""


@dataclass(frozen=True, slots=True, eq=False)
class TrueMotion:
    """A plant's run.

    Attributes:
        system: of the plant.
        start: its state at the epoch, shape (2n,).
        events: of an ideal sensor.
        truth: the states on the grid, at the events and just after them.
        regular: which of these are on the grid, shape (samples,).
        marks: the samples of the first table, by heading.
    """

    system: System
    start: Vector
    events: tuple[ImpactEvent, ...]
    truth: Samples
    regular: np.ndarray
    marks: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class LawResult:
    """One run of one law.

    Attributes:
        model: name.
        law: name.
        seed: of the initial error.
        ratios: V over the initial V, by mark.
        synchronized: when the flag was first true, s since the epoch; None for never.
        below: since when V stayed below the threshold, s since the epoch; None for never.
        wrong: samples at which the flag was true and V above the threshold.
        excess: the largest V over the threshold while the flag was true.
    """

    model: str
    law: str
    seed: int
    ratios: dict[str, float]
    synchronized: float | None
    below: float | None
    wrong: int
    excess: float


def true_motion(name: str, seconds: float) -> TrueMotion:
    """Simulate a sample model, a model file, or ``far_end``, for ``seconds``."""
    model = parse_model(FAR_END, name) if name == "far_end" else read_model(name)
    regular = grid(EPOCH, EPOCH + from_seconds(seconds), RATE)
    events = _run(model, regular)[0]
    at_events = np.array([event.stamp for event in events], dtype=np.int64)
    stamps = np.unique(np.concatenate([regular, at_events, at_events + _BESIDE]))
    stamps = stamps[stamps <= regular[-1]]
    impacts = [e.stamp for e in events if any(s.kind is not Kind.OPEN for s in e.switches)]
    n = model.system.n
    marks = {f"{END:g} s": EPOCH + from_seconds(END)} if seconds >= END else {}
    if len(impacts) >= 2 * n + 2:
        marks = {"impact 2n+2": impacts[2 * n + 1] + _BESIDE, **marks}
    return TrueMotion(
        model.system,
        np.concatenate(model.initial_state()),
        events,
        samples_of(stamps, _run(model, stamps)[1]),
        np.isin(stamps, regular),
        {mark: int(np.searchsorted(stamps, stamp)) for mark, stamp in marks.items()},
    )


def _run(model: Model, stamps: Stamps) -> tuple[tuple[ImpactEvent, ...], Vector]:
    plant = Plant(model.system, *model.initial_state(), epoch=EPOCH)
    run = simulate(plant, stamps)
    return run.events, run.states


def outcome(name: str, case: TrueMotion, law: str, seed: int) -> LawResult:
    """Run a law with its default ensemble from a wrong start, and compare with the truth."""
    system, n = case.system, case.system.n
    x = case.start + np.random.default_rng(seed).normal(size=2 * n)
    observer = Observer(system, law_named(law)(system, IDEAL), x[:n], x[n:])
    replayed = replay(observer, case.events, case.truth["stamp"])
    estimates = [each for each in replayed if isinstance(each, Estimate)]
    states = np.array([np.concatenate([each.q, each.u]) for each in estimates])
    V = energy(system, states - case.truth["x"])
    where = np.searchsorted(case.truth["stamp"], [each.last_event for each in estimates])
    threshold = (
        Options.agreed * energy(system, states)[where]
    )  # of the motion just after the last event
    flagged = np.array([each.synchronized for each in estimates]) & case.regular
    above = threshold < V
    excess = V[flagged] / np.maximum(threshold[flagged], np.finfo(float).tiny)
    V0 = float(energy(system, x - case.start))
    last = int(np.flatnonzero(above)[-1]) if above.any() else -1
    return LawResult(
        model=name,
        law=law,
        seed=seed,
        ratios={mark: float(V[index]) / V0 for mark, index in case.marks.items()},
        synchronized=_first(case.truth["stamp"][flagged]),
        below=_first(case.truth["stamp"][last + 1 :]),
        wrong=int(np.count_nonzero(flagged & above)),
        excess=float(np.max(excess, initial=0.0)),
    )


def _first(stamps: Stamps) -> float | None:
    """Seconds from the epoch to the first of ``stamps``; None where there is none."""
    return seconds_between(EPOCH, int(stamps[0])) if stamps.size else None


def reductions(outcomes: Iterable[LawResult]) -> list[dict[str, object]]:
    """The first table: medians over the first seeds."""
    rows = []
    for (model, law), group in _grouped(outcomes).items():
        counted = [each for each in group if each.seed < SEEDS_OF_MEDIAN]
        medians = {
            mark: statistics.median(each.ratios[mark] for each in counted)
            for mark in counted[0].ratios
        }
        rows.append({"model": model, "law": law, "seeds": len(counted), "V_ratio": medians})
    return rows


def flags(outcomes: Sequence[LawResult]) -> list[dict[str, object]]:
    """The second table: how often the flag was wrong, and when it was first true."""
    groups = _grouped(outcomes)
    for (_, law), group in list(groups.items()):
        groups.setdefault(("all", law), []).extend(group)
    rows: list[dict[str, object]] = []
    for (model, law), group in groups.items():
        rows.append(
            {
                "model": model,
                "law": law,
                "runs": len(group),
                "came": sum(each.synchronized is not None for each in group),
                "wrong": sum(each.wrong > 0 for each in group),
                "largest_excess": max(each.excess for each in group),
                "median_below": _median(each.below for each in group),
                "median_time": _median(each.synchronized for each in group),
            }
        )
    return rows


def _median(times: Iterable[float | None]) -> float | None:
    """The median of times; None counts as later than all others."""
    found = statistics.median_high(math.inf if time is None else time for time in times)
    return found if math.isfinite(found) else None


def _grouped(outcomes: Iterable[LawResult]) -> dict[tuple[str, str], list[LawResult]]:
    groups: dict[tuple[str, str], list[LawResult]] = {}
    for each in outcomes:
        groups.setdefault((each.model, each.law), []).append(each)
    return groups


def print_tables(outcomes: Sequence[LawResult], console: Console) -> None:
    """Both tables."""
    marks = list(dict.fromkeys(mark for each in outcomes for mark in each.ratios))
    table = _new_table(f"median V/V0, at most {SEEDS_OF_MEDIAN} seeds")
    for mark in marks:
        table.add_column(mark, justify="right")
    for row in reductions(outcomes):
        ratios = row["V_ratio"]
        assert isinstance(ratios, dict)
        cells = [f"{ratios[mark]:.1e}" if mark in ratios else "" for mark in marks]
        table.add_row(str(row["model"]), str(row["law"]), *cells)
    console.print(table)
    table = _new_table("runs in which `synchronized` was wrong")
    for heading in ("runs", "came", "wrong", "V/limit", "V below", "flag"):
        table.add_column(heading, justify="right")
    for row in flags(outcomes):
        cells = [str(row[key]) for key in ("model", "law", "runs", "came", "wrong")]
        times = [_shown(row["median_below"]), _shown(row["median_time"])]
        table.add_row(*cells, f"{row['largest_excess']:.2g}", *times)
    console.print(table)
    console.print(
        "V below the limit, the observer's threshold, and flag: median s;"
        " V/limit: the largest while the flag was true"
    )


def _new_table(title: str) -> Table:
    table = Table(box=box.SIMPLE_HEAD, title=title, title_justify="left", collapse_padding=True)
    for heading in ("model", "law"):
        table.add_column(heading, no_wrap=True)
    return table


def _shown(time: object) -> str:
    return "never" if time is None else f"{time:.1f}"


def main(args: Sequence[str] | None = None) -> int:
    """Run the laws and print both tables.

    Returns:
        0; 2 for wrong use.
    """
    parser = argparse.ArgumentParser(prog="./dev bench laws", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--runs", type=int, default=67, metavar="N", help="a model (default 67)")
    parser.add_argument("--seconds", type=float, default=60.0, metavar="S", help="(default 60)")
    parser.add_argument("--models", nargs="+", default=MODELS, metavar="MODEL")
    parser.add_argument("--laws", nargs="+", default=tuple(BUILT_IN), metavar="LAW")
    parser.add_argument("--json", type=new_file, metavar="FILE", help="write every run to FILE")
    given = parser.parse_args(args)
    if given.runs < 1 or not given.seconds > 0:
        parser.error("argument --runs, --seconds: expected numbers above 0")
    try:
        cases = {name: true_motion(name, given.seconds) for name in given.models}
        jobs = [
            (name, law, seed) for name in cases for law in given.laws for seed in range(given.runs)
        ]
        console = Console(stderr=True)
        outcomes = [
            outcome(name, cases[name], law, seed)
            for name, law, seed in track(jobs, "runs", console=console, transient=True)
        ]
    except ImpactObserverError as error:
        parser.error(str(error))
    print_tables(outcomes, Console())
    if given.json:
        document = {
            "seconds": given.seconds,
            "reductions": reductions(outcomes),
            "flags": flags(outcomes),
            "runs": [asdict(each) for each in outcomes],
        }
        given.json.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
