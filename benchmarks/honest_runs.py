# SPDX-License-Identifier: Apache-2.0
"""Runs of the rows of ``honest``: how wrong the default observer is, and how sure."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.honest_rows import ROWS, Case, case
from benchmarks.impacts import energy
from benchmarks.misfit_motion import EPOCH, Array
from benchmarks.troubles import nees
from impact_observer.errors import ImpactObserverError
from impact_observer.events import ImpactEvent
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.impact_filter import EventQuery, ImpactFilter
from impact_observer.filter.likelihood import UNMEASURED
from impact_observer.model import System
from impact_observer.observer import make_observer, replay
from impact_observer.options import Options
from impact_observer.stamps import from_seconds
from impact_observer.states import Estimate

SETTLED = 0.25
"""From which part of a run on errors count."""
BESIDE = 0.005
"""Distance from an impact at which samples count, s."""
FAR, LARGE = 10.0, 0.02
"""Error of an estimate that should not be synchronized: in deviations; over the motion."""
ROUNDING = 1e-15
"""Least deviation, over the motion of a component."""
QUANTILE, PENALTY = 1.959964, 40.0
"""Half the width of a 95 % interval in deviations; what an error outside of it costs."""
ODDS = math.log(1000.0)
"""Of the likelihoods where a misfit is visible: the chance of it in an exact plant is 0.001."""
_STAMP_ROUNDING = 1e-9 / math.sqrt(12)


class Job(NamedTuple):
    """A run to be made, of a row by its place in ``ROWS``."""

    row: int
    seed: int


class Outcome(NamedTuple):
    """A run; averages are over samples after settling, arrays over components, shape (2n,).

    Attributes:
        row: name.
        seed: of the run.
        size: of the misfit.
        impacts: how many.
        visible: whether the impacts tell the misfit.
        z: median of the largest |error| over its deviation.
        within: share of samples within three deviations.
        wrong: share of samples that are wrongly synchronized.
        synchronized: share of samples that are synchronized.
        error: rms error over the rms of the motion, by the energy.
        geometric: the same of geometric.
        score: mean 95 % interval score.
        geometric_score: that of geometric, given its rms error.
        warned: when a warning began after the misfit did, s; None without one.
        nees: normalised estimation error squared, over 2n.
        deviation: median deviation over the motion, the mean of components.
    """

    row: str
    seed: int
    size: float
    impacts: int
    visible: bool
    z: float
    within: list[float]
    wrong: float
    synchronized: float
    error: float
    geometric: float
    score: list[float]
    geometric_score: list[float]
    warned: float | None
    nees: float
    deviation: float


def estimates(made: Case, options: Options) -> list[Estimate]:
    """At the samples of a run."""
    observer = make_observer(made.model, options)
    found = replay(observer, made.events, made.stamps)
    return [each for each in found if isinstance(each, Estimate)]


def interval_score(errors: Array, deviations: Array) -> Array:
    """Mean score of 95 % intervals (Gneiting and Raftery 2007), by component, shape (2n,)."""
    half = QUANTILE * deviations
    return np.asarray(np.mean(2 * half + PENALTY * np.maximum(np.abs(errors) - half, 0.0), axis=0))


def outcome(job: Job) -> Outcome:
    """Run both laws."""
    row = ROWS[job.row]
    misfit, made = row.misfit, case(row.misfit, row.rig, job.seed)
    system, truth = made.model, made.states
    n = system.n
    seconds = (made.stamps - EPOCH) / 1e9
    near = np.concatenate([made.hits, [event.stamp for event in made.events]])
    distance = np.min(np.abs(made.stamps[:, None] - near), axis=1)
    counted = distance > from_seconds(BESIDE + 5 * misfit.jitter)
    counted &= seconds >= SETTLED * seconds[-1]
    found = estimates(made, misfit.declared)
    other = estimates(made, Options(law="geometric", epoch=EPOCH))
    errors, theirs = (
        np.array([np.concatenate([each.q, each.u]) for each in which])[counted] - truth[counted]
        for which in (found, other)
    )
    covariances = np.array([np.reshape(each.covariance, (2 * n, 2 * n)) for each in found])[
        counted
    ]
    size = np.sqrt(np.mean(truth**2, axis=0))
    deviations = np.maximum(np.sqrt(np.diagonal(covariances, axis1=1, axis2=2)), ROUNDING * size)
    ratios = np.abs(errors) / deviations
    motion, V = float(np.mean(energy(system, truth))), energy(system, errors)
    flagged = np.array([each.synchronized for each in found])[counted]
    far = (np.max(ratios, axis=1) > FAR) | (LARGE**2 * motion < V)
    warned = (t for t, each in zip(seconds.tolist(), found, strict=True) if each.misfit)
    their_rms = np.sqrt(np.mean(theirs**2, axis=0))
    return Outcome(
        row.name,
        job.seed,
        made.size,
        len(made.hits),
        is_visible(made, misfit.jitter, misfit.declared),
        float(np.median(np.max(ratios, axis=1))),
        np.mean(ratios <= 3.0, axis=0).tolist(),
        float(np.mean(flagged & far)),
        float(np.mean(flagged)),
        math.sqrt(np.mean(V) / motion),
        math.sqrt(np.mean(energy(system, theirs)) / motion),
        interval_score(errors, deviations).tolist(),
        interval_score(theirs, np.broadcast_to(their_rms, theirs.shape)).tolist(),
        next((t - misfit.since for t in warned if t >= misfit.since), None),
        float(np.mean([nees(P, e) for P, e in zip(covariances, errors, strict=True)]))
        if misfit.exact
        else math.nan,
        float(np.mean(np.median(deviations, axis=0) / size)),
    )


def is_visible(made: Case, jitter: float, options: Options) -> bool:
    """Whether a likelihood-ratio test that knows the misfit, and the ``jitter``, s, detects it.

    Kalman filters that trust the events start with a deviation of one about the true state. The
    model as declared is compared with the true linear plant, and with a scale of its innovations
    that is fitted; the misfit is visible where one of them is ``ODDS`` likelier.
    """
    declared = math.hypot(max(options.clock_error, 0.0), _STAMP_ROUNDING)
    try:
        likelihood, squares = innovations(made.model, made.start[0], made.events, declared)
    except (ImpactObserverError, ArithmeticError, np.linalg.LinAlgError):
        return True
    scale = max(float(np.mean(squares)), 1.0) if squares.size else 1.0
    if squares.size * (scale - 1 - math.log(scale)) / 2 > ODDS:
        return True
    if not made.truth.is_linear:
        return False
    true, _ = innovations(
        made.truth.system, made.start[1], made.events, math.hypot(jitter, _STAMP_ROUNDING)
    )
    return true - likelihood > ODDS


def innovations(
    system: System, x: Array, events: Sequence[ImpactEvent], clock: float
) -> tuple[float, Array]:
    """Log-likelihood of ``events``, and squares of their normalised innovations.

    The state is ``x`` at the epoch, with a deviation of one; stamps have the deviation ``clock``.
    """
    filter_, since, index = ImpactFilter(system), 0.0, system.contact_names.index
    state = filter_.begin(GaussianState.of(x[None], np.eye(x.size)))
    total, squares = 0.0, []
    for event in events:
        t = (event.stamp - EPOCH) / 1e9
        state = filter_.predict(since, state).prior(t - since)
        switches = [(index(each.contact), each.kind) for each in event.switches]
        change = ContactChange.of(t, state.closed, switches)
        query = EventQuery(change, state, clock, UNMEASURED)
        (likelihood,) = filter_.likelihoods([query])
        total += likelihood.density
        squares += [each**2 for each in likelihood.innovations.values()]
        (state,) = filter_.posteriors([query._replace(likelihood=likelihood)])
        since = t
    return total, np.array(squares)
