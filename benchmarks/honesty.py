# SPDX-License-Identifier: Apache-2.0
"""Is the default observer honest where the plant is not the model: a row for each wrong plant.

``misfit_plants`` has 54 wrong plants, half of them for tuning and half held back, and exact ones
as control. ``minimum-variance`` and ``geometric`` have their defaults and start at zero. Samples
count after a quarter of a run, farther than 5 ms from an impact:

- z: largest |error| over its deviation, median; about 1 where the covariance is honest;
- within: share of samples of the worst component within 3 deviations;
- error: root mean square over that of the motion, by the energy;
- over geometric: the error over that of ``geometric``;
- wrongly synchronized: share of samples with ``synchronized`` and an error above 10 deviations or
  above 2 % of the motion;
- warned: 1 where the observer warned that the model does not explain the impacts.
"""

from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.checkout import Checkout, Figure, Figures, Row
from benchmarks.misfit_motion import EPOCH, RATE, Recording
from benchmarks.misfit_plants import WrongPlant, plants
from impact_observer.io.reader import BagReader
from impact_observer.model import Model, System

SECONDS = 60.0
SETTLED = 0.25
"""From which part of a run on errors count."""
FAR, LARGE = 10.0, 0.02
"""Error of an estimate that should not be synchronized: in deviations; over the motion."""
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
    """

    stamps: NDArray[np.int64]
    states: Array
    deviations: Array
    synchronized: NDArray[np.bool_]
    warned: bool


def write_times(folder: Path, recording: Recording, system: System) -> None:
    """The model and a table of the impact times, as from a rig."""
    (folder / "model.yaml").write_text(Model(system).text(), "utf-8")
    pairs = zip(recording.stamps.tolist(), recording.contacts.tolist(), strict=True)
    lines = [f"{stamp},{system.contact_names[contact]}" for stamp, contact in pairs]
    (folder / "times.csv").write_text("\n".join(["time,contact", *lines, ""]), "utf-8")


def observed(checkout: Checkout, folder: Path, law: str) -> Estimates:
    """Estimates of a law at the samples of the truth."""
    name = f"observed_{law}"
    done = checkout.run(folder, "observe", "bag", "--law", law, "--rate", RATE, "-o", name)
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
    )


def energy(system: System, x: Array) -> Array:
    """Kinetic and elastic energy of states (q, u), shape (samples, 2n); of errors it is V."""
    q, u = np.split(x, 2, axis=1)
    parts = np.einsum("ki,ij,kj->k", u, system.M, u) + np.einsum("ki,ij,kj->k", q, system.K, q)
    return np.asarray(parts / 2)


def honest(checkout: Checkout, folder: Path, seed: int, *, wrong: WrongPlant) -> Figures:
    """The figures of a run of a wrong plant."""
    system = wrong.model
    recording = wrong.run(seed, SECONDS)
    write_times(folder, recording, system)
    seconds = EPOCH / 1e9
    times = ("--time-unit", "ns", "--time-zero", "0", "--epoch", seconds)
    checkout.run(folder, "import", "times.csv", "--model", "model.yaml", *times, "-o", "bag")
    found, other = (observed(checkout, folder, law) for law in ("minimum-variance", "geometric"))
    kept = recording.away() & (recording.sample_stamps >= EPOCH + SETTLED * SECONDS * 1e9)
    counted = np.intersect1d(recording.sample_stamps[kept], found.stamps)
    truth = recording.states[np.searchsorted(recording.sample_stamps, counted)]
    mine, theirs = (np.searchsorted(each.stamps, counted) for each in (found, other))
    errors = found.states[mine] - truth
    size = np.sqrt(np.mean(truth**2, axis=0))
    ratios = np.abs(errors) / np.maximum(found.deviations[mine], _ROUNDING * size)
    V, motion = energy(system, errors), float(np.mean(energy(system, truth)))
    far = (np.max(ratios, axis=1) > FAR) | (LARGE**2 * motion < V)
    error = float(np.sqrt(np.mean(V) / motion))
    geometric = float(np.sqrt(np.mean(energy(system, other.states[theirs] - truth)) / motion))
    return {
        "z": Figure(float(np.median(np.max(ratios, axis=1)))),
        "within": Figure(float(np.min(np.mean(ratios <= 3, axis=0)))),
        "error": Figure(error),
        "over geometric": Figure(error / geometric),
        "wrongly synchronized": Figure(float(np.mean(found.synchronized[mine] & far))),
        "warned": Figure(float(found.warned)),
    }


ROWS = tuple(
    Row(f"{each.name}, {each.group}", each.what, partial(honest, wrong=each)) for each in plants()
)
"""Rows of ``./dev bench honesty``."""
