# SPDX-License-Identifier: Apache-2.0
"""The last bounces before a rest, which the clock does not resolve."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from settling_runs import DRILL, EPOCH, nees_of_run, simulated, start_of

from impact_observer.dynamics.lyapunov import distance
from impact_observer.events import Kind
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.hypotheses import Hypothesis
from impact_observer.filter.impact_filter import EventQuery, ImpactFilter
from impact_observer.filter.settling import Rest, rest_after, settled
from impact_observer.observer import make_observer, replay
from impact_observer.observer.event_order import EventKey, disorder, interpret
from impact_observer.options import Options
from impact_observer.plant import Plant, simulate
from impact_observer.plant.sensor import SensorModel, simulate_sensor
from impact_observer.stamps import from_seconds
from impact_observer.states import Estimate, Vector

ROCK = 0
LATER = 0.03
"""When the contact rests after all bounces, s."""


def at_rest() -> Vector:
    """A state of the drill in which the bit is pressed on the rock, shape (2n,)."""
    run = simulated(DRILL, 0, 30.0)
    found: Vector = next(each.after for each in run.switchings if each.closed == (ROCK,))
    return found


def bouncing(speed: float) -> Vector:
    """The same, but for a contact speed, m/s."""
    n, w = DRILL.n, DRILL.W[:, ROCK]
    kick = np.linalg.solve(DRILL.M, w)
    x = at_rest()
    x[n:] += kick * (speed / w.dot(kick))
    return x


def state_later(x: Vector) -> Vector:
    """The plant's state ``LATER``, shape (2n,)."""
    plant = Plant(DRILL, *np.split(x, 2), epoch=EPOCH)
    run = simulate(plant, np.array([EPOCH + from_seconds(LATER)]))
    assert run.switchings[-1].closed == (ROCK,) or not run.switchings
    return np.asarray(run.states[0])


def hit(filter_: ImpactFilter, speed: float) -> EventQuery:
    """A hit at t = 0 that leaves the contact the ``speed``, of a state that is known well."""
    eps, clock = float(DRILL.eps[ROCK]), 1e-9
    x, root = bouncing(-speed / eps), 1e-9 * np.eye(2 * DRILL.n)
    state = filter_.begin(GaussianState.of(x[None], root))
    return EventQuery(ContactChange(0.0, (), (ROCK,), ()), state, clock)


@pytest.mark.parametrize("speed", [4e-3, 1e-3])
def test_bounces_and_a_plastic_impact_lead_to_the_same_rest(speed: float) -> None:
    """They differ by what is added as an error, found here by simulating every bounce."""
    filter_ = ImpactFilter(DRILL)
    asked = hit(filter_, speed)
    (after,) = filter_.posteriors([asked])
    bounced, rested = state_later(bouncing(speed)), state_later(at_rest())
    flight = 2 * speed / filter_.fall(0.0, ROCK, after)
    found = settled(filter_, asked._replace(clock=1e-3 * flight), after, 0.0)
    assert found is None
    found = settled(filter_, asked._replace(clock=flight), after, 0.0)
    assert found is not None
    assert found.state.closed == (ROCK,)
    added = found.state.root[:, -1]
    carried = filter_.members.given.moving.phase((ROCK,)).transition(LATER) @ added
    # The flight is taken for longer by the clock's deviation, here as long as itself: by 2^3.
    assert np.linalg.norm(bounced - rested) == pytest.approx(np.linalg.norm(carried) / 8, rel=0.05)


def test_a_contact_that_is_not_pressed_or_hits_for_long_does_not_settle() -> None:
    """Nor one whose flight before was much longer than the clock's error."""
    filter_ = ImpactFilter(DRILL)
    asked = hit(filter_, 1e-3)
    (after,) = filter_.posteriors([asked])
    asked = asked._replace(clock=1e-4)
    assert settled(filter_, asked, after, 0.0) is not None
    assert settled(filter_, asked, after, 0.1) is None
    pulled = after._replace(x=after.x + 10.0 * np.eye(2 * DRILL.n)[DRILL.n - 1])
    assert filter_.fall(0.0, ROCK, pulled) < 0
    assert settled(filter_, asked, pulled, 0.0) is None
    approaching = pulled._replace(x=pulled.x + 9.0 * np.eye(2 * DRILL.n)[-1])
    assert filter_.speed(ROCK, approaching) < 0
    assert settled(filter_, asked, approaching, 0.0) is None


def test_a_contact_of_unknown_speed_does_not_settle() -> None:
    """Then the mean of the next flight says nothing, and the clock resolves others."""
    filter_ = ImpactFilter(DRILL)
    asked = hit(filter_, 1e-3)._replace(clock=1e-4)
    (after,) = filter_.posteriors([asked])
    assert settled(filter_, asked, after, 0.0) is not None
    vague = after.with_error(np.eye(2 * DRILL.n))
    assert filter_.speed_deviation(ROCK, vague) == pytest.approx(1.0, rel=1e-3)
    assert settled(filter_, asked, vague, 0.0) is None


@pytest.mark.parametrize("seed", [29, 51])
def test_without_a_rest_of_the_plant_the_covariance_explains_the_errors(seed: int) -> None:
    """Where a contact were closed, NEES would be 1e3 to 3e5 times the number of states."""
    found = nees_of_run(seed)
    assert found.size > 10
    assert np.max(found) < 10


def test_the_rest_comes_when_all_bounces_are_over() -> None:
    """The simulated plant's last switching, but for the change of its acceleration meanwhile."""
    filter_, speed = ImpactFilter(DRILL), 2e-3
    x = bouncing(speed)
    run = simulate(
        Plant(DRILL, *np.split(x, 2), epoch=EPOCH), np.array([EPOCH + from_seconds(LATER)])
    )
    last = (run.switchings[-1].instant.stamp - EPOCH) * 1e-9
    root = np.zeros((2 * DRILL.n, 0))
    flight = 2 * speed / filter_.fall(0.0, ROCK, GaussianState.of(x[None], root))
    rest = rest_after(filter_, ROCK, 0.0, flight, 1e-6)
    assert rest.t == pytest.approx(last, rel=1e-3)
    assert rest.deviation == pytest.approx(math.hypot(1e-6, rest.t / 2))


def test_the_density_of_bounces_is_one() -> None:
    """Its integral over all stamps that may be bounces."""
    rest = Rest(2.0, 1e-3)

    def density(t: float) -> float:
        found = rest.log_density(t)
        return 0.0 if found is None else math.exp(found)

    assert quad(density, 1.99, 2.01, points=[2.0])[0] == pytest.approx(1.0, abs=1e-6)
    assert rest.log_density(2.0061) is None


def test_stamps_in_a_wrong_order_refute_a_clock_without_error() -> None:
    """Of two clocks the one whose error could have swapped them becomes likelier."""
    state = GaussianState.of(np.zeros((1, 2)), np.eye(2))
    exact, coarse = (Hypothesis(state, clock).disordered(1e-4) for clock in (1e-6, 1e-4))
    assert coarse.weight == pytest.approx(math.log(0.5 * math.erfc(0.5)))
    assert exact.weight == -50.0


def test_the_disorder_of_an_event_is_how_late_its_stamp_is() -> None:
    """Beside that of an event with a higher number, of the same contact only."""
    latest = {0: (7, 1_000_000), 1: (3, 900_000)}
    late = EventKey(1_250_000, 6, ((0, Kind.IMPACT),))
    assert disorder(late, interpret(late, (), latest), latest) == pytest.approx(250e-6)
    for number, contact in ((8, 0), (6, 1), (0, 0)):
        event = EventKey(1_250_000, number, ((contact, Kind.IMPACT),))
        assert disorder(event, interpret(event, (), latest), latest) == 0.0


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
