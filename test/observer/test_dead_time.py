# SPDX-License-Identifier: Apache-2.0
"""A sensor's dead time that is declared: the hits in it are no missed detections."""

import math
from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from systems import EPOCH, run, sample

from impact_observer.batch.smoothing import smoothed_runs
from impact_observer.events import ImpactEvent, Kind, Ruling, Verdict, final_rulings
from impact_observer.filter.between_events import BetweenEvents
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.hypotheses import Hypothesis
from impact_observer.filter.impact_filter import ImpactFilter
from impact_observer.filter.ledger import Ledger, MissedSwitch
from impact_observer.observer import Options, make_observer, replay
from impact_observer.plant import Run, SensorModel, simulate_sensor
from impact_observer.states import Estimate

DEAD = 0.6
"""Of the sensor, s: 21 of the 46 hits of a minute are lost in it."""


def recorded(jitter: float) -> tuple[Run, list[ImpactEvent]]:
    """A minute of two_mass, and what a sensor with a dead time reports of it."""
    model = sample("two_mass")
    made = run(model.system, *model.initial_state(), seconds=60.0, rate=10.0)
    sensor, last = SensorModel(dead_time=DEAD, jitter=jitter), int(made.stamps[-1])
    messages = simulate_sensor(
        sensor, model.system, made.switchings, epoch=EPOCH, last=last, seed=3
    )
    return made, sorted((each.event for each in messages), key=lambda each: each.stamp)


def observed(
    made: Run, events: Sequence[ImpactEvent], options: Options
) -> tuple[list[Estimate], list[Verdict]]:
    """The estimates at the stamps of a run, and the verdicts."""
    observer = make_observer(sample("two_mass").system, options)
    every = [*replay(observer, list(events), made.stamps)]
    estimates = [each for each in every if isinstance(each, Estimate)]
    return estimates, [each for each in every if isinstance(each, Verdict)]


def declared(dead_time: float, jitter: float) -> Options:
    """Everything else at its default but the clock, which is known."""
    return Options(
        law="minimum-variance", dead_time=dead_time, clock_error=jitter, ensemble=1, history=100.0
    )


@cache
def filtering() -> ImpactFilter:
    """Of two_mass."""
    return ImpactFilter(sample("two_mass").system)


def between(missed: float, dead_time: float) -> BetweenEvents:
    """Of two_mass."""
    return BetweenEvents(
        filtering(),
        None,
        trusts_events=False,
        missed=missed,
        dead_time=dead_time,
        most=64,
        keeps_exact=False,
    )


STATE = GaussianState(np.zeros(4), np.zeros(0), np.eye(4), np.zeros((4, 0)), ())


@given(st.floats(0.0, 0.9), st.floats(1e-3, 10.0), st.floats(1e-9, 0.1), st.floats(0.0, 20.0))
def test_a_hit_is_unreported_as_often_as_it_is_in_the_dead_time_or_missed(
    missed: float, dead_time: float, clock: float, ago: float
) -> None:
    """The stamp has a normal error, so the dead time ends by a normal distribution."""
    here = between(missed, dead_time)
    h = Hypothesis(STATE, clock, ledger=Ledger(reported={0: 3.0}))
    dead = here.dead(h, 0, Kind.IMPACT, 3.0 + ago)
    assert dead == pytest.approx(stats.norm.cdf((dead_time - ago) / clock), abs=1e-6)
    chance = 1 - (1 - dead) * (1 - missed)
    assert math.exp(here.log_missed(dead)) == pytest.approx(chance, abs=1e-12)


def test_without_a_report_or_a_dead_time_a_hit_is_only_missed() -> None:
    """Then its probability is the one that is declared, to the last bit."""
    h = Hypothesis(STATE, 1e-3)
    assert between(0.1, 0.5).dead(h, 0, Kind.IMPACT, 3.0) == 0.0
    assert between(0.1, 0.0).log_missed(0.0) == math.log(0.1)
    assert between(0.0, 0.0).log_missed(0.0) == -math.inf


def test_the_end_of_a_rest_is_as_unreported_as_its_beginning() -> None:
    """A rest that began in the dead time ends without a report, whenever it ends."""
    here, begun = between(0.1, 0.5), MissedSwitch(0, Kind.CLOSE, 0.2, 4.0, is_dead=True)
    ledger = Ledger(reported={0: 3.0}, missed=(begun,))
    silent = Hypothesis(STATE, 1e-3, ledger=ledger)
    told = ledger._replace(missed=(begun._replace(is_dead=False),))
    seen = silent._replace(ledger=told)
    assert here.dead(silent, 0, Kind.OPEN, 9.0) == 1.0
    assert here.dead(seen, 0, Kind.OPEN, 3.1) == 0.0


@pytest.mark.long
@pytest.mark.parametrize("jitter", [0.0, 1e-3])
def test_hits_in_a_declared_dead_time_are_no_misfit(jitter: float) -> None:
    """All are inserted and none is doubted; undeclared they are warned of."""
    made, events = recorded(jitter)
    estimates, verdicts = observed(made, events, declared(DEAD, jitter))
    others, _ = observed(made, events, declared(0.0, jitter))
    assert not any(each.misfit for each in estimates)
    assert any(each.misfit for each in others)
    rulings = [*final_rulings(verdicts).values()]
    assert rulings.count(Ruling.INSERTED) >= 20
    assert not rulings.count(Ruling.REJECTED)
    inserted = [each for each in verdicts if each.ruling is Ruling.INSERTED]
    assert all("in the dead time" in each.reason for each in inserted)
    half = len(made.stamps) // 2
    errors = np.array([[*each.q, *each.u] for each in estimates]) - made.states
    deviations = np.sqrt([np.diag(np.asarray(each.covariance)) for each in estimates])
    z = np.abs(errors / deviations)[half:]
    assert 0.2 < np.median(z) < 3.0
    assert np.max(np.abs(errors[half:])) < max(0.02 * jitter / 1e-3, 1e-8)


@pytest.mark.long
def test_a_smoothed_recording_knows_the_dead_time() -> None:
    """Impacts that the sensor could not report are inserted, and the model fits."""
    _, events = recorded(1e-3)
    (motion,) = smoothed_runs(sample("two_mass").system, events, declared(DEAD, 1e-3))
    inserted = sum(not each.is_measured for each in motion.fit.problem.moments.each)
    assert inserted >= 20
    assert not motion.misfit
