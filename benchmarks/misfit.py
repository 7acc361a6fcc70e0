"""The laws on plants that are not the model: ``./dev bench misfit``.

``benchmarks/misfit_plants.py`` has the plants. ``geometric`` and ``minimum-variance`` have their
defaults, start at zero, and receive the impacts of an ideal sensor: the onsets, to 1 ns. A table
for each group of plants, a row for each run:

- z: |error| over standard deviation of minimum-variance, the median of samples and coordinates
  after 10 s;
- flag: share of samples at which ``synchronized`` was true and the error above 10 deviations,
  V > 100 E[V];
- geometric, min.-variance: the error, square root of the median V over the mean energy of the
  motion, after 10 s; and its ratio;
- warning: events until minimum-variance warns that the model does not explain the impacts.

Samples within 5 ms of a contact do not count. Below each table are the goals; exact plants have
none. Plants with fewer than an impact a second run up to 2.3 times longer.

``--exact N`` counts false alarms on exact models instead (``benchmarks/misfit_alarms.py``).
"""

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from fnmatch import fnmatch
from typing import NamedTuple, get_args

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks import misfit_alarms
from benchmarks.harness import SkippedError, new_file
from benchmarks.impacts import energy
from benchmarks.misfit_motion import EPOCH, Array, Recording
from benchmarks.misfit_plants import Group, plants
from impact_observer import Options, make_observer
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.model import System
from impact_observer.stamps import from_seconds

GEOMETRIC, FILTER = "geometric", "minimum-variance"
LONGER = {"two_mass": 1.5, "three_mass": 2.3, "one_stop": 2.2}
"""Factors of the length of runs, by model: 60 impacts or more in what are 60 s for others."""
BEGIN = from_seconds(10.0)
"""From the epoch on until errors count, ns."""
EVERY = 3
"""Of the samples of a recording, those that are compared."""
ALLOWED = 10.0
"""Deviations by which an estimate may be wrong while ``synchronized`` is true."""
SOON = 40
"""Events within which a warning is expected."""
NOTICEABLE = 0.01
"""Error of minimum-variance above which one is."""


class Followed(NamedTuple):
    """What a law estimated during a recording.

    Attributes:
        states: (q, u) at the samples, shape (samples, 2n).
        covariances: shape (samples, 2n, 2n); (samples, 0, 0) of a law without any.
        synchronized: shape (samples,).
        warned: events until the first warning; None without one.
    """

    states: Array
    covariances: Array
    synchronized: NDArray[np.bool_]
    warned: int | None


class Job(NamedTuple):
    """A run to be made, of the plant of this name."""

    plant: str
    seed: int
    seconds: float


@dataclass(frozen=True, slots=True)
class Outcome:
    """A run.

    Attributes:
        plant: name.
        group: of the plant.
        kind: of the misfit.
        seed: of the run.
        impacts: how many.
        z: median of |error| over standard deviation.
        flag: share of samples with ``synchronized`` and an error above ``ALLOWED`` deviations.
        geometric: relative error.
        filtered: that of minimum-variance.
        warned: events until the first warning; None without one.
    """

    plant: str
    group: Group
    kind: str
    seed: int
    impacts: int
    z: float
    flag: float
    geometric: float
    filtered: float
    warned: int | None

    @property
    def ratio(self) -> float:
        """The error of minimum-variance over that of geometric."""
        return self.filtered / self.geometric


class Goal(NamedTuple):
    """A goal of a group, what was found, and whether that meets it."""

    text: str
    found: str
    is_met: bool


def events(system: System, recording: Recording) -> Iterator[ImpactEvent]:
    """What an ideal sensor reports."""
    hits = zip(recording.stamps.tolist(), recording.contacts.tolist(), strict=True)
    for k, (stamp, contact) in enumerate(hits, start=1):
        switches = (Switch(system.contact_names[contact], Kind.IMPACT),)
        yield ImpactEvent(stamp, switches, k, 1, EPOCH)


def followed(system: System, recording: Recording, options: Options) -> Followed:
    """The estimates at every ``EVERY``-th sample, each after the events up to its stamp."""
    observer = make_observer(system, options)
    waiting, warned = list(events(system, recording))[::-1], None
    estimates = []
    for stamp in recording.sample_stamps[::EVERY].tolist():
        while waiting and waiting[-1].stamp <= stamp:
            event = waiting.pop()
            observer.receive(event)
            if warned is None and observer.estimate(event.stamp).misfit:
                warned = event.sequence
        estimates.append(observer.estimate(stamp))
    return Followed(
        np.array([np.concatenate([each.q, each.u]) for each in estimates]),
        np.array([each.covariance for each in estimates]),
        np.array([each.synchronized for each in estimates]),
        warned,
    )


def relative_error(system: System, states: Array, truth: Array) -> float:
    """Square root of the median V over the mean energy of the motion; states (samples, 2n)."""
    V, motion = energy(system, states - truth), energy(system, truth)
    return float(np.sqrt(np.median(V) / np.mean(motion)))


def consistency(errors: Array, covariances: Array) -> float:
    """Median of |error| over standard deviation; shapes (samples, 2n), (samples, 2n, 2n)."""
    deviations = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.nanmedian(np.abs(errors) / deviations))


def wrongly_synchronized(system: System, errors: Array, found: Followed) -> NDArray[np.bool_]:
    """Samples with ``synchronized`` whose V is above ``ALLOWED**2`` times its expectation."""
    n = system.n
    of_q, of_u = found.covariances[:, :n, :n], found.covariances[:, n:, n:]
    expected = (np.tensordot(of_q, system.K) + np.tensordot(of_u, system.M)) / 2
    return np.asarray(found.synchronized & (energy(system, errors) > ALLOWED**2 * expected))


def outcome(job: Job) -> Outcome | str:
    """Run both laws; or why the run is skipped."""
    (plant,) = (each for each in plants() if each.name == job.plant)
    system = plant.model
    try:
        recording = plant.run(job.seed, job.seconds * LONGER.get(system.name, 1.0))
    except SkippedError as why:
        return f"{plant.name}: skipped: {why}"
    at, truth = recording.sample_stamps[::EVERY], recording.states[::EVERY]
    away = recording.away()[::EVERY]
    late = away & (at >= EPOCH + BEGIN)
    runs = {
        law: followed(system, recording, Options(law=law, epoch=EPOCH))
        for law in (GEOMETRIC, FILTER)
    }
    error = {
        law: relative_error(system, each.states[late], truth[late]) for law, each in runs.items()
    }
    ours = runs[FILTER]
    differences = ours.states - truth
    return Outcome(
        plant.name,
        plant.group,
        plant.kind,
        job.seed,
        recording.stamps.size,
        consistency(differences[late], ours.covariances[late]),
        float(np.mean(wrongly_synchronized(system, differences, ours)[away])),
        error[GEOMETRIC],
        error[FILTER],
        ours.warned,
    )


def goals(outcomes: Sequence[Outcome]) -> list[Goal]:
    """The goals for wrong plants; none where there is no such plant."""
    wrong = [each for each in outcomes if each.kind != "exact"]
    if not wrong:
        return []
    z, ratio = np.array([each.z for each in wrong]), np.array([each.ratio for each in wrong])
    honest, near = np.mean((z >= 0.3) & (z <= 3)), np.mean(ratio <= 1.3)
    flag, worst = np.mean([each.flag for each in wrong]), max(each.flag for each in wrong)
    due = [each for each in wrong if each.filtered > NOTICEABLE]
    soon = sum(each.warned is not None and each.warned <= SOON for each in due)
    return [
        Goal("median z in [0.3, 3] on nine of ten", f"{honest:.0%}", bool(honest >= 0.9)),
        Goal("never above 5", f"largest {np.max(z):.1f}", bool(np.max(z) <= 5)),
        Goal(
            f"synchronized, error above {ALLOWED:g} deviations: at most 1 % of samples",
            f"{flag:.1%}, of one run up to {worst:.0%}",
            bool(flag <= 0.01),
        ),
        Goal("error at most 1.3 of geometric's on nine of ten", f"{near:.0%}", bool(near >= 0.9)),
        Goal("median ratio below 0.8", f"{np.median(ratio):.2f}", bool(np.median(ratio) < 0.8)),
        Goal(
            f"warning within {SOON} events where the error exceeds {NOTICEABLE:.0%}",
            f"{soon} of {len(due)}",
            soon == len(due),
        ),
    ]


def table(outcomes: Sequence[Outcome], title: str) -> Table:
    """A row for each run."""
    found = Table(
        box=box.SIMPLE_HEAD,
        title=title,
        title_justify="left",
        padding=(0, 1, 0, 0),
        pad_edge=False,
    )
    found.add_column("plant", no_wrap=True)
    headings = ("seed", "impacts", "z", "flag", GEOMETRIC, "min.-variance", "ratio", "warning")
    for heading in headings:
        found.add_column(heading, justify="right", no_wrap=True)
    for each in outcomes:
        found.add_row(
            each.plant,
            str(each.seed),
            str(each.impacts),
            f"{each.z:.2f}",
            f"{100 * each.flag:.1f} %",
            f"{100 * each.geometric:.2g} %",
            f"{100 * each.filtered:.2g} %",
            f"{each.ratio:.2f}",
            "" if each.warned is None else str(each.warned),
        )
    return found


def print_group(outcomes: Sequence[Outcome], group: Group, console: Console) -> None:
    """The table of a group, and its goals."""
    console.print(table(outcomes, group))
    for goal in goals(outcomes):
        met = "met" if goal.is_met else "missed"
        console.print(f"  {met:6} {goal.text}: {goal.found}", highlight=False)
    console.print()


def run(jobs: Sequence[Job], workers: int) -> Iterator[Outcome]:
    """The runs that can be made, in their order, by so many processes."""
    console = Console(stderr=True)
    made = Parallel(workers, return_as="generator")(delayed(outcome)(job) for job in jobs)
    for each in track(made, "runs", total=len(jobs), console=console, transient=True):
        if isinstance(each, Outcome):
            yield each
        else:
            console.print(each, highlight=False)


def arguments(args: Sequence[str] | None) -> argparse.Namespace:
    """The arguments, checked."""
    parser = argparse.ArgumentParser(prog="./dev bench misfit", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("names", nargs="*", metavar="PLANT", help="names or patterns: 'drill-*'")
    parser.add_argument("--group", choices=get_args(Group), help="(default: both)")
    parser.add_argument("--seeds", type=int, default=1, metavar="N", help="a plant (default 1)")
    parser.add_argument("--seconds", type=float, default=60.0, metavar="S", help="(default 60)")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="processes (default 2)")
    parser.add_argument("--json", type=new_file, metavar="FILE", help="write every run to FILE")
    parser.add_argument(
        "--exact", type=int, default=0, metavar="N", help="false alarms in N events instead"
    )
    given = parser.parse_args(args)
    if min(given.seeds, given.jobs) < 1 or not given.seconds > 10 or given.exact < 0:
        parser.error("expected --seeds, --jobs and --exact above 0, --seconds above 10")
    given.plants = [
        each
        for each in plants()
        if given.group in {None, each.group}
        and (not given.names or any(fnmatch(each.name, name) for name in given.names))
    ]
    if not given.plants:
        parser.error(f"no plant is named {' or '.join(given.names)} in that group")
    return given


def main(args: Sequence[str] | None = None) -> int:
    """Run the plants and print the tables.

    Returns:
        0; 2 for wrong use.
    """
    given, console = arguments(args), Console(width=max(Console().width, 110))
    if given.exact:
        counts = misfit_alarms.run(given.exact, given.jobs)
        misfit_alarms.print_table(counts, console)
        document = {"exact": [asdict(each) for each in counts]}
    else:
        jobs = [
            Job(each.name, seed, given.seconds)
            for each in given.plants
            for seed in range(given.seeds)
        ]
        outcomes = list(run(jobs, given.jobs))
        for group in get_args(Group):
            if members := [each for each in outcomes if each.group == group]:
                print_group(members, group, console)
        document = {"seconds": given.seconds, "runs": [asdict(each) for each in outcomes]}
    if given.json:
        given.json.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
