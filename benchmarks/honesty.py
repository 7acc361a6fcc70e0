# SPDX-License-Identifier: Apache-2.0
"""Is the default observer honest where the plant is not the model: a row for each wrong plant.

``misfit_plants`` has wrong plants, half of them for tuning and half held back, and exact ones as
control. ``--plants FOLDER`` adds recordings made elsewhere: each of its folders has
``events.csv``, ``model.yaml``, and the true states in ``truth_h.csv``. ``minimum-variance`` and
``geometric`` have their defaults and start at zero. Samples count after a quarter of a run,
farther than 5 ms from an impact:

- within: share of all numbers of the state within 2 deviations;
- error: root mean square over that of the motion, by the energy;
- over geometric: the error over that of ``geometric``;
- width: median of the published deviations, over the root mean squares of the motion;
- synchronized: share of samples;
- wrongly synchronized: share of samples with ``synchronized`` and an error above 15 % of the
  motion;
- warned: 1 where the observer warned that the model does not explain the impacts;
- processor: time of the law beyond that of ``geometric``, s for a recorded second.
"""

import shutil
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmarks.checkout import Checkout, Figure, Figures, Row
from benchmarks.misfit_motion import EPOCH, RATE, Recording
from benchmarks.misfit_plants import WrongPlant, plants
from impact_observer.io.reader import BagReader
from impact_observer.model import Model, System
from impact_observer.model.model_file import model_of

SECONDS = 60.0
SETTLED = 0.25
"""From which part of a run on errors count."""
LARGE = 0.15
"""Error of an estimate that should not be synchronized, over the motion."""
_ROUNDING = 1e-15
"""Least deviation, over the motion of a component."""

Array = NDArray[np.float64]


class Estimates(NamedTuple):
    """What a checkout estimated.

    Attributes:
        stamps: ns, shape (samples,).
        states: (q, u), shape (samples, 2n).
        deviations: standard deviations, shape (samples, 2n); empty of a law without covariance.
        synchronized: shape (samples,).
        warned: whether the command warned of a misfit.
        seconds: processor time of the command.
    """

    stamps: NDArray[np.int64]
    states: Array
    deviations: Array
    synchronized: NDArray[np.bool_]
    warned: bool
    seconds: float


def write_times(folder: Path, recording: Recording, system: System) -> None:
    """The model and a table of the impact times, as from a rig."""
    (folder / "model.yaml").write_text(Model(system).text(), "utf-8")
    pairs = zip(recording.stamps.tolist(), recording.contacts.tolist(), strict=True)
    lines = [f"{stamp},{system.contact_names[contact]}" for stamp, contact in pairs]
    (folder / "times.csv").write_text("\n".join(["time,contact", *lines, ""]), "utf-8")


def observed(checkout: Checkout, folder: Path, law: str, *, at_truth: bool = False) -> Estimates:
    """Estimates of a law at the samples of the truth, which the bag has if ``at_truth``."""
    name = f"observed_{law}"
    rate = () if at_truth else ("--rate", RATE)
    done = checkout.run(folder, "observe", "bag", "--law", law, *rate, "-o", name)
    with BagReader(folder / name) as reader:
        messages = [message for _, message in reader.messages("/observer/state")]
    size = 2 * len(messages[0].name)
    squares = [np.reshape(each.covariance, (-1, size)) for each in messages]
    return Estimates(
        np.array([10**9 * each.header.stamp.sec + each.header.stamp.nanosec for each in messages]),
        np.array([np.concatenate([each.position, each.velocity]) for each in messages]),
        np.array([np.sqrt(np.maximum(np.diagonal(each), 0.0)) for each in squares]),
        np.array([each.synchronized for each in messages]),
        "warning: at " in done.output,
        done.seconds,
    )


def energy(system: System, x: Array) -> Array:
    """Kinetic and elastic energy of states (q, u), shape (samples, 2n); of errors it is V."""
    q, u = np.split(x, 2, axis=1)
    parts = np.einsum("ki,ij,kj->k", u, system.M, u) + np.einsum("ki,ij,kj->k", q, system.K, q)
    return np.asarray(parts / 2)


def figures(system: System, recording: Recording, found: Estimates, other: Estimates) -> Figures:
    """The figures of ``minimum-variance`` and ``geometric``, ``found`` and the ``other``."""
    stamps, first = recording.sample_stamps, int(recording.sample_stamps[0])
    seconds = (int(stamps[-1]) - first) / 1e9
    kept = recording.away() & (stamps >= first + SETTLED * seconds * 1e9)
    counted = np.intersect1d(stamps[kept], found.stamps)
    truth = recording.states[np.searchsorted(stamps, counted)]
    mine, theirs = (np.searchsorted(each.stamps, counted) for each in (found, other))
    errors, size = found.states[mine] - truth, np.sqrt(np.mean(truth**2, axis=0))
    deviations = np.maximum(found.deviations[mine], _ROUNDING * size)
    V, motion = energy(system, errors), float(np.mean(energy(system, truth)))
    error = float(np.sqrt(np.mean(V) / motion))
    geometric = float(np.sqrt(np.mean(energy(system, other.states[theirs] - truth)) / motion))
    is_synchronized = found.synchronized[mine]
    return {
        "within": Figure(float(np.mean(np.abs(errors) <= 2 * deviations))),
        "error": Figure(error),
        "over geometric": Figure(error / geometric),
        "width": Figure(float(np.median(deviations / size))),
        "synchronized": Figure(float(np.mean(is_synchronized))),
        "wrongly synchronized": Figure(float(np.mean(is_synchronized & (LARGE**2 * motion < V)))),
        "warned": Figure(float(found.warned)),
        "processor": Figure((found.seconds - other.seconds) / seconds, "s/s"),
    }


def honest(checkout: Checkout, folder: Path, seed: int, *, wrong: WrongPlant) -> Figures:
    """The figures of a run of a wrong plant."""
    system = wrong.model
    recording = wrong.run(seed, SECONDS)
    write_times(folder, recording, system)
    times = ("--time-unit", "ns", "--time-zero", "0", "--epoch", EPOCH / 1e9)
    checkout.run(folder, "import", "times.csv", "--model", "model.yaml", *times, "-o", "bag")
    found, other = (observed(checkout, folder, law) for law in ("minimum-variance", "geometric"))
    return figures(system, recording, found, other)


def elsewhere(checkout: Checkout, folder: Path, _: int, *, plant: Path) -> Figures:
    """The figures of a recording that was made elsewhere."""
    for name in ("events.csv", "model.yaml", "truth_h.csv"):
        shutil.copy(plant / name, folder)
    system = model_of(folder / "model.yaml", "").system
    given = ("--model", "model.yaml", "--truth", "truth_h.csv", "--sort", "-o", "bag")
    checkout.run(folder, "import", "events.csv", *given)
    found, other = (
        observed(checkout, folder, law, at_truth=True) for law in ("minimum-variance", "geometric")
    )
    truth, events = pd.read_csv(plant / "truth_h.csv"), pd.read_csv(plant / "events.csv")
    start = int(found.stamps[0]) - round(1e9 * float(truth.time[0]))
    stamps, hits = (
        start + np.rint(1e9 * each.time.to_numpy()).astype(np.int64) for each in (truth, events)
    )
    states = truth.to_numpy()[:, 1:]
    contacts = np.zeros(hits.size, dtype=np.intp)
    recording = Recording(np.sort(hits), contacts, np.sort(hits), stamps, states)
    return figures(system, recording, found, other)


def elsewhere_rows(folder: Path) -> Iterator[Row]:
    """A row for each folder with a recording."""
    for path in sorted(folder.glob("*/events.csv")):
        plant = path.parent.resolve()
        yield Row(plant.name, "a recording made elsewhere", partial(elsewhere, plant=plant))


ROWS = tuple(
    Row(f"{each.name}, {each.group}", each.what, partial(honest, wrong=each)) for each in plants()
)
"""Rows of ``./dev bench honesty``."""
