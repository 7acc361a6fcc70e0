"""Observers of plants that are nearly the model: honest, and they warn."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from systems import EPOCH, run, sample, started

from impact_observer.events import Remark
from impact_observer.model import System
from impact_observer.observer import Observer, make_observer
from impact_observer.options import Options
from impact_observer.plant import Plant, Run, simulate
from impact_observer.stamps import NS_PER_S, grid

Array = NDArray[np.float64]
START = (np.array([0.3, -0.2]), np.array([0.4, -0.5]))
SECONDS = 60.0
TRUSTING = dict.fromkeys(("model_error", "clock_error", "missed", "spurious", "mislabelled"), 0.0)


def bouncier(model: System, factor: float) -> System:
    """Its restitutions are larger by a factor."""
    contacts = (replace(c, restitution=factor * c.restitution) for c in model.contacts)
    return replace(model, contacts=tuple(contacts))


@cache
def wrong() -> Run:
    """A plant whose restitution is 3 % larger than that of two_mass."""
    return run(bouncier(sample("two_mass").system, 1.03), *START, seconds=SECONDS, rate=20.0)


def watching(**options: float) -> Observer:
    """An observer of two_mass that starts at zero."""
    chosen = Options(law="minimum-variance", history=1e4, epoch=EPOCH, **options)  # type: ignore[arg-type]
    return make_observer(sample("two_mass").system, chosen, ())


def z_of(watcher: Observer, truth: Run) -> float:
    """Median error over standard deviation, after 10 s, farther than 5 ms from impacts."""
    hits = np.array([each.stamp for each in truth.events])
    found = []
    for stamp, x in zip(truth.stamps.tolist(), truth.states, strict=True):
        if stamp < EPOCH + 10 * NS_PER_S or np.min(np.abs(hits - stamp)) < 5_000_000:
            continue
        now = watcher.estimate(stamp)
        errors = np.concatenate([now.q, now.u]) - x
        found.append(np.abs(errors) / np.sqrt(np.diag(now.covariance)))
    return float(np.median(found))


@pytest.mark.slow
def test_wrong_restitution_is_learned_and_warned_of() -> None:
    """Errors are as large as declared; with an exact model declared they are not."""
    watcher, trusting = watching(), watching(**TRUSTING)
    for each in wrong().events:
        watcher.receive(each)
        trusting.receive(each)
    last = watcher.estimate(wrong().events[-1].stamp)
    assert last.misfit
    assert not last.synchronized
    learned = {name: value for name, value, _ in last.parameters}
    assert learned["bounce error"] > 0.003 or learned["model error"] > 0.001
    assert watcher.remarks[Remark.MISFIT] > 0
    assert 0.2 < z_of(watcher, wrong()) < 3
    assert z_of(trusting, wrong()) > 10


@pytest.mark.slow
def test_exact_model_has_no_error_and_is_synchronized() -> None:
    """Nothing is learned of it, and nothing warns."""
    plant, watcher = run(sample("two_mass").system, *START, seconds=20.0), watching()
    for each in plant.events:
        watcher.receive(each)
        assert not watcher.estimate(each.stamp).misfit
    last = watcher.estimate(plant.events[-1].stamp)
    assert last.synchronized
    assert {name: value for name, value, _ in last.parameters if "error" in name} == pytest.approx(
        {"clock_error": 0.0, "model error": 0.0, "bounce error": 0.0}, abs=1e-8
    )
    assert watcher.remarks[Remark.MISFIT] == 0


@pytest.mark.slow
def test_warning_ends_when_the_model_fits_again() -> None:
    """The restitution is right after 24 periods of the force, for a minute and a half."""
    model, watcher = sample("two_mass").system, watching()
    switched = EPOCH + round(24 * 2 * np.pi / 2.5 * NS_PER_S)
    before = simulate(started(bouncier(model, 1.03), *START), np.array([switched]))
    after = Plant(model, *np.split(before.states[-1], 2), epoch=switched)
    later = simulate(after, grid(switched, switched + 90 * NS_PER_S, 1.0))
    for each in before.events:
        watcher.receive(each)
    assert watcher.estimate(switched).misfit
    for each in later.events:
        watcher.receive(replace(each, epoch=EPOCH, sequence=each.sequence + len(before.events)))
    last = watcher.estimate(switched + 90 * NS_PER_S)
    assert not last.misfit
    assert last.synchronized
