# SPDX-License-Identifier: Apache-2.0
"""Near an impact with an uncertain instant the covariance contains both velocities."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from systems import EPOCH, event, sample

from impact_observer.batch.smoothing import smoothed_runs
from impact_observer.observer import Observer, make_observer
from impact_observer.options import Options
from impact_observer.plant import Plant, SensorModel, simulate, simulate_sensor
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Estimate

Array = NDArray[np.float64]
JITTER = 1e-3
G, EPS = 9.81, 0.9
"""Of the sample ball, m/s2."""
DECLARED = Options("minimum-variance", clock_error=JITTER, epoch=EPOCH, history=1e4)
ALL_TRUE = replace(DECLARED, model_error=0.0, missed=0.0, spurious=0.0, mislabelled=0.0)
DRAWS = 100_000


def observer_of_ball(spread: float, clock: float = JITTER) -> Observer:
    """Of a ball that falls from rest at 1 m, where height and speed have this ``spread``."""
    declared = replace(ALL_TRUE, initial_state="1,0", initial_deviation=f"{spread}")
    model = sample("bouncing_ball").system
    return make_observer(model, replace(declared, clock_error=clock))


def balls(spread: float) -> tuple[Array, Array, Array, Array]:
    """Drawn balls: when each hits, s, its speeds before and after that, m/s, and its stamp, s."""
    rng = np.random.default_rng(7)
    height, speed = np.array([[1.0], [0.0]]) + spread * rng.normal(size=(2, DRAWS))
    fall = np.sqrt(speed**2 + 2 * G * height)
    hits = (speed + fall) / G
    return hits, -fall, EPS * fall, hits + JITTER * rng.normal(size=DRAWS)


def speeds(drawn: tuple[Array, Array, Array, Array], t: float) -> Array:
    """The speeds of drawn balls ``t`` seconds after their start, m/s."""
    hits, before, after, _ = drawn
    return np.where(t < hits, before, after) - G * (t - hits)


def deviation(estimate: Estimate) -> float:
    """Of the speed, m/s."""
    assert estimate.covariance is not None
    return float(np.sqrt(estimate.covariance[1, 1]))


@pytest.mark.parametrize("spread", [1e-4, 1e-2])
@pytest.mark.parametrize("away", [-3.0, -1.5, -0.5, 0.5, 1.5, 3.0])
def test_speed_before_an_event_has_the_error_of_drawn_balls(spread: float, away: float) -> None:
    """Of balls whose hit is not reported yet, ``away`` deviations of stamps from the mean hit."""
    drawn = balls(spread)
    t = np.sqrt(2 / G) + away * JITTER
    watcher = observer_of_ball(spread)
    watcher.receive(event(0.5, "floor", sequence=1))  # of which an earlier estimate knows nothing
    found = watcher.estimate(EPOCH + round(t * NS_PER_S))
    errors = (speeds(drawn, t) - found.u[0])[drawn[3] > t]
    assert errors.size > 100
    assert deviation(found) == pytest.approx(np.sqrt(np.mean(errors**2)), rel=0.2)


@pytest.mark.parametrize("spread", [1e-4, 1e-2])
@pytest.mark.parametrize("since", [0.0, 0.5, 1.0, 2.0, 4.0])
@pytest.mark.parametrize("late", [-1.0, 0.0, 1.0])
def test_speed_after_an_event_has_the_error_of_drawn_balls(
    spread: float, since: float, late: float
) -> None:
    """Of balls with about the same stamp, by deviations of stamps after the event.

    The stamp is ``late`` by some deviations of stamps.
    """
    drawn = balls(spread)
    stamp = np.sqrt(2 / G) + late * JITTER
    watcher, t = observer_of_ball(spread), stamp + since * JITTER
    watcher.receive(event(stamp, "floor", sequence=1))
    found = watcher.estimate(EPOCH + round(t * NS_PER_S))
    weights = np.exp(-(((drawn[0] - stamp) / JITTER) ** 2) / 2)
    square = np.average((speeds(drawn, t) - found.u[0]) ** 2, weights=weights)
    assert deviation(found) == pytest.approx(np.sqrt(square), rel=0.25, abs=5e-3)


def test_exact_stamps_tell_the_side() -> None:
    """At the stamp of an event the speed is that after the impact, and certain."""
    watcher = observer_of_ball(1e-9, 0.0)
    hit = event(float(np.sqrt(2 / G)), "floor", sequence=1)
    watcher.receive(hit)
    assert deviation(watcher.estimate(hit.stamp)) < 1e-7


@pytest.mark.slow
@pytest.mark.parametrize("name", ["two_mass", pytest.param("three_mass", marks=pytest.mark.long)])
def test_samples_about_jittered_stamps_are_within_three_deviations(name: str) -> None:
    """Nine samples of ten of each component, as observed and smoothed, of four runs."""
    model, within = sample(name), list[tuple[Array, Array]]()
    x, last = np.concatenate(model.initial_state()), EPOCH + 20 * NS_PER_S
    for seed in range(4):
        rng = np.random.default_rng(seed)
        run = simulate(Plant(model.system, *np.split(x, 2), epoch=EPOCH), np.array([last]))
        sensor = SensorModel(jitter=JITTER)
        sent = simulate_sensor(
            sensor, model.system, run.switchings, epoch=EPOCH, last=last, seed=seed
        )
        events = [each.event for each in sent]
        stamps = np.repeat([each.stamp for each in events], 5)
        stamps = np.unique(stamps + (3e6 * rng.uniform(-1, 1, stamps.size)).astype(np.int64))
        truth = simulate(Plant(model.system, *np.split(x, 2), epoch=EPOCH), stamps).states
        start = ",".join(f"{each:.17g}" for each in x + rng.normal(size=x.size))
        declared = replace(DECLARED, initial_state=start, initial_deviation="1")
        watcher = make_observer(model, declared)
        for each in events:
            watcher.receive(each)
        (motion,) = smoothed_runs(model, events, declared)
        observed = [watcher.estimate(int(each)) for each in stamps]
        smoothed = [one for some in motion.estimates(stamps) for one in some]
        within.append((share_within(observed, truth), share_within(smoothed, truth)))
    assert np.min(np.mean(within, axis=0)) > 0.9


def share_within(found: list[Estimate], truth: Array) -> Array:
    """The share of the samples within three deviations, of each component."""
    errors = np.array([np.append(each.q, each.u) for each in found]) - truth
    variances = np.array([np.diag(np.asarray(each.covariance)) for each in found])
    return np.asarray(np.mean(errors**2 < 9 * variances, axis=0))
