# SPDX-License-Identifier: Apache-2.0
"""Recordings that the model does not explain: a restitution that scatters from hit to hit."""

from dataclasses import replace

import numpy as np
import pytest
from drills import DRILL, Drill, events
from systems import EPOCH

from impact_observer.filter.contradiction import Declared, contradictions
from impact_observer.model import parse_model
from impact_observer.options import Options
from impact_observer.smooth import SmoothedMotion, smoothed_runs
from impact_observer.states import Estimate, Vector


def declared(clock: float) -> Options:
    """The start of a drill whose motion is known to a few millimetres."""
    return Options(
        law="minimum-variance",
        epoch=EPOCH,
        clock_error=clock,
        missed=0.0,
        spurious=0.0,
        mislabelled=0.0,
        initial_state="0,0,0,0",
        initial_deviation="0.005,0.005,0.6,0.6",
    )


def share_within(
    motion: SmoothedMotion, drill: Drill, hits: list[tuple[float, Vector]]
) -> tuple[float, list[Estimate]]:
    """The share of states within two deviations of the true ones, and the estimates.

    Estimates within 0.5 ms of a hit are left out.
    """
    instants = np.array([t for t, _ in hits])
    times = np.arange(0.3, 1.15, 0.01)
    times = times[np.abs(times[:, None] - instants).min(axis=1) > 5e-4]
    stamps = EPOCH + np.rint(1e9 * times).astype(np.int64)
    found = [each for batch in motion.estimates(stamps) for each in batch]
    inside = list[bool]()
    for t, each in zip(times.tolist(), found, strict=True):
        since, x = hits[int(np.searchsorted(instants, t)) - 1]
        error = np.append(each.q, each.u) - drill.flown(x, since, t - since).ravel()
        inside += (np.abs(error) < 2 * np.sqrt(np.diag(each.covariance))).tolist()
    return float(np.mean(inside)), found


@pytest.mark.slow
@pytest.mark.parametrize("clock", [1e-4, pytest.param(1e-5, marks=pytest.mark.long)])
def test_states_hold_the_truth_where_a_restitution_scatters(clock: float) -> None:
    """The motion that is the likeliest has a restitution six declared deviations off.

    Its states are wrong by ten deviations; those of the filter are published.
    """
    drill = Drill(scatter=0.02)
    hits = drill.recorded(1.2, 1)
    (motion,) = smoothed_runs(parse_model(DRILL, "drill"), events(hits, clock), declared(clock))
    share, found = share_within(motion, drill, hits)
    assert share > 0.8
    names = {each.declared.name for each in motion.contradictions}
    assert "damping.ground-hammer" in names
    assert "the states are the filter's" in motion.fallback
    assert not any(each.synchronized for each in found)
    assert all(each.misfit for each in found)
    assert names.isdisjoint(name for each in found for name, *_ in each.parameters)
    assert {each.law for each in found} == {"smoother"}
    speeds = [drill.speed_after(x) for t, x in hits if t > 0]
    impacts = [*motion.impact_estimates()]
    errors = [each.speed_after - speed for each, speed in zip(impacts, speeds, strict=True)]
    assert np.mean(np.abs(errors) < [2 * each.speed_after_deviation for each in impacts]) > 0.9


@pytest.mark.slow
def test_a_restitution_that_is_the_same_at_every_hit_is_learned() -> None:
    """All parameters are off by about one declared deviation: the smoothed states are used."""
    drill = Drill(scatter=0.0)
    hits = drill.recorded(1.2, 1)
    (motion,) = smoothed_runs(parse_model(DRILL, "drill"), events(hits, 1e-4), declared(1e-4))
    share, found = share_within(motion, drill, hits)
    assert share > 0.8
    assert not motion.contradictions
    assert not motion.fallback
    assert all(each.synchronized for each in found)


@pytest.mark.slow
def test_an_error_of_the_model_that_is_declared_explains_a_restitution_that_scatters() -> None:
    """The remedy that the warning names."""
    drill = Drill(scatter=0.02)
    hits = drill.recorded(1.2, 1)
    options = replace(declared(1e-4), model_error=0.3)
    (motion,) = smoothed_runs(parse_model(DRILL, "drill"), events(hits, 1e-4), options)
    share, _ = share_within(motion, drill, hits)
    assert share > 0.8
    assert not motion.fallback


def test_values_far_from_the_declared_ones_or_outside_their_bounds_are_contradictions() -> None:
    """Declared 0.6 +- 0.1 from 0 to 1; a value beyond a bound by less than its error is none."""
    restitution = Declared("restitution.hit", 0.6, 0.1, 0.0, 1.0)
    for value, deviation, expected in [
        (0.25, 0.01, False),
        (0.15, 0.01, True),
        (0.99, 0.01, False),
        (1.01, 0.01, True),
        (1.01, 0.2, True),
    ]:
        learned = [("restitution.hit", value, deviation), ("bounce error", 1.0, 0.0)]
        assert bool(contradictions(learned, [restitution])) is expected
    damping = Declared("damping.ground-bit", 5.0, 3.0, 0.0, np.inf)
    assert not contradictions([("damping.ground-bit", -1.0, 2.0)], [damping])
    (found,) = contradictions([("damping.ground-bit", -1.0, 0.1)], [damping])
    assert found.is_outside
    assert found.far == pytest.approx(2.0)
