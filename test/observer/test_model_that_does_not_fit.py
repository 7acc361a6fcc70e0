# SPDX-License-Identifier: Apache-2.0
"""A model whose fit left shifts: deviations contain these, and estimates do not depend on them."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from impact_observer.model import Model, read_model
from impact_observer.observer import Observer, Options, make_observer
from impact_observer.plant import Plant, Run, simulate
from impact_observer.stamps import NS_PER_S, grid

Array = NDArray[np.float64]
EPOCH, LATE = NS_PER_S, 4_000_000
DECLARED = Options(
    "minimum-variance",
    "0.1,-0.2,0.5,0",
    "0.1",
    epoch=EPOCH,
    clock_error=1e-4,
    model_error=0.0,
    history=60.0,
)
VERDICT = {"fits": False, "residual": 1e-3, "shift": LATE / NS_PER_S, "interval": 1.3}


@pytest.fixture(scope="module")
def run() -> Run:
    """Two masses for half a minute, the true states ten times a second."""
    model = read_model("two_mass")
    plant = Plant(model.system, *model.initial_state(), epoch=EPOCH)
    return simulate(plant, grid(EPOCH, EPOCH + 30 * NS_PER_S, 10.0))


def late(model: Model, run: Run) -> Observer:
    """An observer that is told of all impacts too late."""
    observer = make_observer(model, DECLARED)
    for each in run.events:
        observer.receive(replace(each, stamp=each.stamp + LATE))
    return observer


def states_between_impacts(observer: Observer, run: Run) -> tuple[Array, Array, Array]:
    """Estimates, their deviations and the truth, after six impacts; shape (samples, 2n) each."""
    hits = np.array([each.stamp for each in run.events])
    away = np.abs(run.stamps[:, None] - hits).min(axis=1) > 2 * LATE
    kept = away & (run.stamps > hits[5]) & (run.stamps < hits[-1])
    made = [observer.estimate(stamp) for stamp in run.stamps[kept].tolist()]
    x = np.array([np.append(each.q, each.u) for each in made])
    return x, np.sqrt([np.diag(each.covariance) for each in made]), run.states[kept]


def test_deviations_contain_the_shift_that_a_fit_left(run: Run) -> None:
    """All impacts come 4 ms late. The estimates are the same, and surer than right without it."""
    model = read_model("two_mass")
    plain, marked = late(model, run), late(replace(model, provenance=VERDICT), run)
    x, deviations, truth = states_between_impacts(plain, run)
    again, wider, _ = states_between_impacts(marked, run)
    np.testing.assert_array_equal(again, x)
    assert np.mean(np.abs(x - truth) <= 2 * wider) > 0.9
    assert np.all(wider < 0.2 * np.max(np.abs(truth), axis=0) + deviations)
