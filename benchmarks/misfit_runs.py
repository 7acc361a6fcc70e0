# SPDX-License-Identifier: Apache-2.0
"""Runs of the laws on plants that are not the model, and how wrong and how sure they are."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import SkippedError
from benchmarks.impacts import energy
from benchmarks.misfit_motion import EPOCH, Array, Recording
from benchmarks.misfit_plants import Group, plants
from impact_observer import Options, make_observer
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.model import System
from impact_observer.stamps import from_seconds

GEOMETRIC, FILTER = "geometric", "minimum-variance"
LONGER = {"two_mass": 1.5, "three_mass": 3.5, "one_stop": 2.2}
"""Factors of the length of runs, by model: nearly all runs have 60 impacts or more then."""
BEGIN = from_seconds(10.0)
"""From the epoch on until errors count, ns."""
EVERY = 3
"""Of the samples of a recording, those that are compared."""
ALLOWED = 10.0
"""Deviations by which an estimate may be wrong while ``synchronized`` is true."""


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


def length(system: System, seconds: float) -> float:
    """The length of a run of a plant of this model, s; ``seconds`` where impacts are frequent."""
    return seconds * LONGER.get(system.name, 1.0)


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


def expected_energy(system: System, covariances: Array) -> Array:
    """E[V] under covariances of shape (samples, 2n, 2n), J."""
    n = system.n
    of_q, of_u = covariances[:, :n, :n], covariances[:, n:, n:]
    return np.asarray((np.tensordot(of_q, system.K) + np.tensordot(of_u, system.M)) / 2)


def wrongly_synchronized(system: System, errors: Array, found: Followed) -> NDArray[np.bool_]:
    """Samples with ``synchronized`` whose V is above ``ALLOWED**2`` times its expectation."""
    expected = expected_energy(system, found.covariances)
    return np.asarray(found.synchronized & (energy(system, errors) > ALLOWED**2 * expected))


def outcome(job: Job) -> Outcome | str:
    """Run both laws; or why the run is skipped."""
    (plant,) = (each for each in plants() if each.name == job.plant)
    system = plant.model
    try:
        recording = plant.run(job.seed, length(system, job.seconds))
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
