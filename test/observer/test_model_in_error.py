# SPDX-License-Identifier: Apache-2.0
"""Observers of plants that are nearly the model: honest, and they warn."""

from collections.abc import Iterable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from systems import EPOCH, run, sample, started

from benchmarks.rigs import fast
from impact_observer.events import ImpactEvent, Remark
from impact_observer.model import System, parse_model
from impact_observer.observer import Observer, make_observer
from impact_observer.options import Options
from impact_observer.plant import Plant, Run, simulate
from impact_observer.stamps import NS_PER_S, grid

START = (np.array([0.3, -0.2]), np.array([0.4, -0.5]))
SECONDS = 60.0
TRUSTED = dict.fromkeys(("missed", "spurious", "mislabelled"), 0.0)
TRUSTING = {"model_error": 0.0, "clock_error": 0.0, **TRUSTED}


def bouncier(model: System, factor: float) -> System:
    """Its restitutions are larger by a factor."""
    contacts = (replace(c, restitution=factor * c.restitution) for c in model.contacts)
    return replace(model, contacts=tuple(contacts))


@cache
def wrong() -> Run:
    """A plant whose restitution is 3 % larger than that of two_mass."""
    return run(bouncier(sample("two_mass").system, 1.03), *START, seconds=SECONDS, rate=5.0)


def watching(**options: float | tuple[str, ...]) -> Observer:
    """An observer of two_mass that starts at zero."""
    chosen = Options(law="minimum-variance", history=1e4, epoch=EPOCH, **options)  # type: ignore[arg-type]
    return make_observer(sample("two_mass").system, chosen)


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


@cache
def watched() -> Observer:
    """An observer with its defaults, after the events of that plant."""
    return fed(watching(), wrong().events)


def fed(watcher: Observer, events: Iterable[ImpactEvent]) -> Observer:
    """The observer after it has received ``events``."""
    for each in events:
        watcher.receive(each)
    return watcher


@pytest.mark.slow
def test_a_wrong_restitution_is_warned_of_and_deviations_contain_it() -> None:
    """Whatever is declared of the sensor: by default, and where no fault is possible."""
    last = watched().estimate(wrong().events[-1].stamp)
    assert last.misfit
    assert watched().remarks[Remark.MISFIT] > 0
    assert 0.1 < z_of(watched(), wrong()) < 3
    trusting = fed(watching(**TRUSTING), wrong().events)
    assert z_of(trusting, wrong()) < 3
    assert trusting.estimate(wrong().events[-1].stamp).misfit


@pytest.mark.slow
@pytest.mark.parametrize("late", [0, 5_000_000])
def test_a_restitution_that_is_asked_for_is_found(late: int) -> None:
    """From a value that is 3 % off; also beside a delay of 5 ms, which is estimated too."""
    delay = 0.02 if late else 0.0
    watcher = watching(estimate_parameters=("restitution=0.05",), clock_offset_error=delay)
    fed(watcher, (replace(each, stamp=each.stamp + late) for each in wrong().events))
    last = watcher.estimate(wrong().events[-1].stamp + late)
    learned = {name: value for name, value, _ in last.parameters}
    assert learned["restitution.stop"] == pytest.approx(1.03 * 0.7, abs=1e-4)
    assert learned.get("clock_offset", 0.0) == pytest.approx(1e-9 * late, abs=1e-6)
    assert not last.misfit


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
        {"clock_error": 0.0, "relative model error": 0.0}, abs=1e-8
    )
    assert watcher.remarks[Remark.MISFIT] == 0


@pytest.mark.long
def test_warning_ends_when_the_model_fits_again() -> None:
    """The restitution is right after 18 periods of the force, for a minute."""
    model, watcher = sample("two_mass").system, watching()
    switched = EPOCH + round(18 * 2 * np.pi / 2.5 * NS_PER_S)
    before = simulate(started(bouncier(model, 1.03), *START), np.array([switched]))
    after = Plant(model, *np.split(before.states[-1], 2), epoch=switched)
    later = simulate(after, grid(switched, switched + 60 * NS_PER_S, 1.0))
    for each in before.events:
        watcher.receive(each)
    assert watcher.estimate(switched).misfit
    for each in later.events:
        watcher.receive(replace(each, epoch=EPOCH, sequence=each.sequence + len(before.events)))
    last = watcher.estimate(switched + 60 * NS_PER_S)
    assert not last.misfit
    assert last.synchronized


@pytest.mark.slow
def test_stamps_of_a_periodic_motion_are_rounded_periodically_and_that_is_no_misfit() -> None:
    """The estimate becomes sharper than 1 ns, and its innovations depend on each other then."""
    drill = parse_model(fast(size=1.0), "drill")
    plant = Plant(drill.system, *drill.initial_state(), epoch=EPOCH)
    hits = simulate(plant, grid(EPOCH, EPOCH + 5 * NS_PER_S, 1.0)).events
    chosen = Options(law="minimum-variance", epoch=EPOCH)
    watcher = fed(make_observer(drill.system, chosen), hits)
    assert len(hits) > 150
    assert watcher.remarks[Remark.MISFIT] == 0


@pytest.mark.slow
def test_a_wrong_model_with_a_table_that_moves_is_observed() -> None:
    """Its restitution is 40 % off."""
    text = """
        name: shaken
        bodies: [{name: x, mass: 1}]
        grounds: [{name: table, motion: {harmonics: [{amplitude: 0.1, frequency: 3}]}}]
        springs: [{between: [table, x], stiffness: 5, damping: 0.1}]
        stops: [{name: plate, between: [table, x], gap: 0.1, restitution: 0.7}]
    """
    model = parse_model(text, "shaken").system
    truth = run(bouncier(model, 0.6), np.array([0.2]), np.zeros(1), seconds=30.0, rate=10.0)
    observer = make_observer(model, Options("minimum-variance", epoch=EPOCH, history=1e4))
    for event in truth.events:
        observer.receive(event)
    error = observer.estimate(int(truth.stamps[-1])).q - truth.states[-1, :1]
    assert np.abs(error).max() < 0.05


PLANE = """
name: plane
coordinates: [x, y]
mass: [[1, 0], [0, 1]]
damping: [[0.1, 0], [0, 0.2]]
stiffness: [[12, -1.5], [-1.5, 15]]
forcing:
  harmonics: [{frequency: 3, cosine: [2, 4], sine: [0, 0]}]
contacts: [{name: stop, direction: [0, -1], gap: 0.25, restitution: 0.8}]
"""


@pytest.mark.long
def test_what_the_impacts_hardly_see_stays_wide_in_a_misfit() -> None:
    """The force on x is 12 % larger; the stop hits y."""
    model = parse_model(PLANE, "plane").system
    forcing = replace(model.forcing, cosine=model.forcing.cosine * [1.12, 1.0])
    plant = replace(model, forcing=forcing)
    truth = run(plant, *START, seconds=120.0, rate=5.0)
    observer = make_observer(model, Options("minimum-variance", epoch=EPOCH, history=1e4))
    for event in truth.events:
        observer.receive(event)
    found = [observer.estimate(stamp) for stamp in truth.stamps[-200:].tolist()]
    errors = np.array([np.concatenate([each.q, each.u]) for each in found]) - truth.states[-200:]
    deviations = np.array([np.sqrt(np.diag(each.covariance)) for each in found])
    assert found[-1].misfit
    assert np.mean(np.abs(errors) <= 3 * deviations) > 0.9
    assert np.max(np.median(deviations, axis=0)) < 1.0 * np.max(np.abs(truth.states))
