# SPDX-License-Identifier: Apache-2.0
"""The sensor's clock steps: all later stamps are off by the same duration."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from systems import EPOCH, run, sample

from impact_observer.dynamics.lyapunov import distance
from impact_observer.events import ImpactEvent
from impact_observer.observer import make_observer, replay
from impact_observer.options import Options
from impact_observer.plant import Run
from impact_observer.stamps import NS_PER_S, from_seconds
from impact_observer.states import Estimate

STEP = EPOCH + 30 * NS_PER_S
"""When the clock steps."""
WARNED = STEP + 10 * NS_PER_S
"""By when the observer has found the step."""


@cache
def whole_run(name: str) -> Run:
    """A minute of a sample model."""
    model = sample(name)
    return run(model.system, *model.initial_state(), seconds=60.0, rate=50.0)


def stepped(name: str, by: float, jitter: float = 0.0) -> list[ImpactEvent]:
    """Its events by a clock that is ahead by ``by`` s from ``STEP`` on; stamps jitter, s."""
    events, random = whole_run(name).events, np.random.default_rng(3)
    late = [(each.stamp >= STEP) * by + jitter * random.normal() for each in events]
    return [
        replace(each, stamp=each.stamp + from_seconds(dt))
        for each, dt in zip(events, late, strict=True)
    ]


def found_of(name: str, events: Sequence[ImpactEvent], jitter: float = 0.0) -> list[Estimate]:
    """Estimates at the samples of the run."""
    declared = Options(law="minimum-variance", clock_error=jitter or -1.0)
    made = replay(make_observer(sample(name), declared), events, whole_run(name).stamps)
    return [each for each in made if isinstance(each, Estimate)]


@pytest.mark.slow
@pytest.mark.parametrize("jitter", [0.0, 1e-3])
@pytest.mark.parametrize("by", [0.1, -0.1])
def test_within_ten_seconds_the_error_is_below_a_twentieth_of_the_motion(
    by: float, jitter: float
) -> None:
    """The truth is the plant's, in the time of the plant, before the clock has stepped and after.

    The warning says by how much, and ends; 19 of 20 errors are within three deviations.
    """
    whole, system = whole_run("two_mass"), sample("two_mass").system
    found = found_of("two_mass", stepped("two_mass", by, jitter), jitter)
    errors = np.array([np.concatenate([each.q, each.u]) for each in found]) - whole.states
    hits = np.array([each.instant.stamp for each in whole.switchings])
    away = np.min(np.abs(whole.stamps[:, None] - hits), axis=1) > from_seconds(5e-3 + 5 * jitter)
    counted = away & (whole.stamps > WARNED)
    motion = np.mean(distance(system, *np.split(whole.states, 2, axis=1)))
    V = distance(system, *np.split(errors[counted], 2, axis=1))
    assert np.max(V) < 0.05**2 * motion
    variances = [np.diag(np.reshape(each.covariance, (4, 4))) for each in found]
    near = np.abs(errors[counted]) <= 3 * np.sqrt(np.array(variances)[counted])
    assert np.mean(near, axis=0).min() > 0.95
    warned = {each.misfit for each in found if each.misfit}
    assert len(warned) == 1
    shift = float(warned.pop().split("stepped by ")[1].split()[0])
    assert shift == pytest.approx(by, abs=4 * jitter + 1e-5)
    first = next(each for each in found if each.misfit)
    assert STEP < first.stamp < WARNED
    assert not first.synchronized
    offsets = [each.clock_offset for each in (found[0], found[-1])]
    np.testing.assert_allclose(offsets, [0.0, by], atol=2 * jitter + 1e-8)


def test_a_clock_that_steps_back_is_right_again() -> None:
    """After two steps the offset is the sum of both."""
    events = stepped("two_mass", 0.2)
    again = STEP + 12 * NS_PER_S
    events = [
        replace(each, stamp=each.stamp - (each.stamp > again) * from_seconds(0.2))
        for each in events
    ]
    found = found_of("two_mass", events)
    assert found[-1].clock_offset == pytest.approx(0.0, abs=1e-8)
    x = np.concatenate([found[-1].q, found[-1].u])
    np.testing.assert_allclose(x, whole_run("two_mass").states[-1], atol=1e-6)


def test_late_events_of_a_stepped_clock_change_nothing() -> None:
    """Events that come in another order give the same estimates in every bit."""
    events, model = stepped("two_mass", -0.1), sample("two_mass")
    swapped = [*events]
    for k in range(0, len(events) - 1, 2):
        swapped[k], swapped[k + 1] = swapped[k + 1], swapped[k]
    stamps = whole_run("two_mass").stamps[1500::100].tolist()
    made = []
    for some in (events, swapped):
        observer = make_observer(model, Options(law="minimum-variance", history=20.0))
        for each in some:
            observer.receive(each)
        made.append([observer.estimate(stamp) for stamp in stamps if stamp > STEP + 10 * NS_PER_S])
    for one, other in zip(*made, strict=True):
        np.testing.assert_array_equal(one.q, other.q)
        np.testing.assert_array_equal(one.covariance, other.covariance)
