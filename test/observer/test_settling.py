# SPDX-License-Identifier: Apache-2.0
"""The last bounces before a rest, which the clock does not resolve."""

import numpy as np
import pytest
from settling_runs import DRILL, EPOCH, nees_of_run, simulated, start_of

from impact_observer.dynamics.lyapunov import distance
from impact_observer.events import Kind
from impact_observer.observer import make_observer, replay
from impact_observer.options import Options
from impact_observer.plant.sensor import SensorModel, simulate_sensor
from impact_observer.stamps import from_seconds
from impact_observer.states import Estimate


@pytest.mark.parametrize("seed", [29, 51])
def test_without_a_rest_of_the_plant_the_covariance_explains_the_errors(seed: int) -> None:
    """Where a contact were closed, NEES would be 1e3 to 3e5 times the number of states."""
    found = nees_of_run(seed)
    assert found.size > 10
    assert np.max(found) < 10


@pytest.mark.long
def test_the_filter_keeps_the_track_where_the_clock_does_not_resolve_the_last_bounces() -> None:
    """A drill that comes to rest on its rock again and again; stamps err by 0.1 ms."""
    run = simulated(DRILL, 1, 15.0)
    sent = simulate_sensor(
        SensorModel(jitter=1e-4),
        DRILL,
        run.switchings,
        epoch=EPOCH,
        last=int(run.stamps[-1]),
        seed=1,
    )
    events = [each.event for each in sent]
    kinds = [switch.kind for each in events for switch in each.switches]
    assert kinds.count(Kind.CLOSE) > 5
    observer = make_observer(DRILL, Options(law="minimum-variance"))
    found = [each for each in replay(observer, events, run.stamps) if isinstance(each, Estimate)]
    errors = np.array([np.concatenate([each.q, each.u]) for each in found]) - run.states
    V = distance(DRILL, *np.split(errors, 2, axis=1))
    impacts = np.array([each.instant.stamp for each in run.impacts])
    clear = np.min(np.abs(run.stamps[:, None] - impacts), axis=1) > from_seconds(5.05e-4)
    clear &= run.stamps >= EPOCH + from_seconds(5.0)
    start = distance(DRILL, *np.split(start_of(DRILL, 1), 2))
    assert np.max(V[clear]) < 1e-4 * start
