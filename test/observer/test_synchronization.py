# SPDX-License-Identifier: Apache-2.0
"""Convergence without ground truth: ensemble, synchronization and certified bound."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import ArrayLike
from systems import EPOCH, Array, chain, event, examples, run, sample, system, systems, vectors
from systems import observer as observer_of

from impact_observer.dynamics import lyapunov, mechanism_of
from impact_observer.errors import DynamicsError, ImpactLawError
from impact_observer.events import Ruling
from impact_observer.model import System
from impact_observer.observer import Observer, ReplicaLaw, law_named
from impact_observer.observer.belief import Belief
from impact_observer.observer.contact_change import ContactChange
from impact_observer.observer.laws import BUILT_IN
from impact_observer.observer.synchronization import (
    REQUIRED_EVENTS,
    Synchronization,
    SynchronizationTest,
)
from impact_observer.observer.uncertainty import Uncertainty
from impact_observer.options import Options
from impact_observer.plant import Run
from impact_observer.stamps import NS_PER_S

LAWS = pytest.mark.parametrize("law", BUILT_IN)
CERTIFIED = pytest.mark.parametrize("law", ["geometric", "unilateral"])
LONG = 1000.0
"""A history that keeps all events, s."""
THREE_MASS = sample("three_mass")
TRUTH = run(THREE_MASS.system, *THREE_MASS.initial_state(), seconds=30.0, rate=10.0)


def started(
    model: System, law: str, start: Array, deviation: float, **options: object
) -> Observer:
    """An observer at ``start`` with a declared ``deviation`` of that."""
    made = law_named(law)(model, Uncertainty(deviation))
    return Observer(model, made, *np.split(start, 2), epoch=EPOCH, history=LONG, **options)  # type: ignore[arg-type]


def observer(model: System, law: str, x: ArrayLike, **options: object) -> Observer:
    """An observer with the default ensemble."""
    return observer_of(model, law, x, **{"ensemble": Options.ensemble, **options})


def random_start(seed: int) -> Array:
    """The initial state of the plant with a standard normal error."""
    return np.asarray(TRUTH.states[0] + np.random.default_rng(seed).normal(size=6))


def distances(watcher: Observer, plant: Run = TRUTH) -> list[float]:
    """``V`` at each state of the plant's run, after the events at or before it."""
    events, found = list(reversed(plant.events)), []
    for stamp, x in zip(plant.stamps.tolist(), plant.states, strict=True):
        while events and events[-1].stamp <= stamp:
            watcher.receive(events.pop())
        estimate = watcher.estimate(stamp)
        found.append(V(watcher.system, x, np.concatenate([estimate.q, estimate.u])))
    return found


def V(model: System, one: Array, two: Array) -> float:  # noqa: N802
    """The Lyapunov distance of two states."""
    return float(lyapunov.distance(model, *np.split(one - two, 2)))


@pytest.mark.slow
@LAWS
def test_estimate_does_not_depend_on_the_ensemble(law: str) -> None:
    """It has the same bits with one replica and with hundreds."""
    bits = set()
    for count in (1, 2, 10, 20 if law == "unilateral" else 300):  # which moves each by itself
        watcher = observer(THREE_MASS.system, law, random_start(1), epoch=EPOCH, ensemble=count)
        for each in TRUTH.events[:8]:
            watcher.receive(each)
        found = watcher.estimate(TRUTH.events[8].stamp)
        bits.add(found.q.tobytes() + found.u.tobytes())
    assert len(bits) == 1


@pytest.mark.slow
def test_convergence_is_the_largest_distance_of_two_replicas() -> None:
    """Of every pair; of very many replicas an upper bound of it, less than four times as much.

    The energy beside it is that of the estimate.
    """
    for count in (2, 10, 400):
        watcher = observer(
            THREE_MASS.system, "geometric", random_start(2), epoch=EPOCH, ensemble=count
        )
        for each in TRUTH.events[:3]:
            watcher.receive(each)
        timeline = watcher.timeline
        assert timeline is not None
        replicas = timeline.entries[-1].belief.replicas
        energy = float(lyapunov.distance(THREE_MASS.system, *np.split(replicas[0], 2)))
        assert timeline.entries[-1].synchronization.energy == pytest.approx(energy, rel=1e-12)
        pairs = replicas[:, None] - replicas
        largest = float(np.max(lyapunov.distance(THREE_MASS.system, *np.split(pairs, 2, axis=-1))))
        found = watcher.estimate(TRUTH.events[2].stamp + 1000).convergence
        if count < 100:
            assert found == pytest.approx(largest, rel=1e-12)
        else:
            assert largest <= found <= 4 * largest


def test_replicas_must_agree_for_several_events_before_synchronization() -> None:
    """Replicas that begin together are synchronized after so many events, not before."""
    watcher = started(THREE_MASS.system, "geometric", TRUTH.states[0], deviation=1e-6)
    for count, each in enumerate(TRUTH.events[: 2 * REQUIRED_EVENTS], start=1):
        watcher.receive(each)
        assert watcher.estimate(each.stamp).synchronized is (count >= REQUIRED_EVENTS)


@pytest.mark.parametrize(
    ("law", "deviation", "first", "last"),
    [
        ("geometric", 1e-6, "agreement at 1 of 3 impacts in a row", ""),
        ("geometric", 1.0, "replicas differ by over ", "replicas differ by over "),
        ("minimum-variance", 1.0, "", ""),
        ("open-loop", 1e-9, "open-loop uses no events", "open-loop uses no events"),
    ],
)
def test_an_estimate_that_is_not_synchronized_has_a_reason(
    law: str, deviation: float, first: str, last: str
) -> None:
    """And one that is has none, at each event and between."""
    watcher = started(THREE_MASS.system, law, TRUTH.states[0], deviation)
    found = []
    for each in TRUTH.events[:20]:
        watcher.receive(each)
        for stamp in (each.stamp, each.stamp + 1_000_000):
            found.append(watcher.obstacle(stamp))
            assert watcher.estimate(stamp).synchronized is (not found[-1])
    assert found[0].startswith(first)
    assert found[-1].startswith(last)
    assert bool(found[-1]) is bool(last)


def test_law_without_events_is_never_synchronized() -> None:
    """Damping brings open-loop replicas to each other, but not to the plant."""
    watcher = started(THREE_MASS.system, "open-loop", TRUTH.states[0], deviation=1e-9)
    distances(watcher)
    last = watcher.estimate(int(TRUTH.stamps[-1]))
    assert last.convergence < 1e-15
    assert not last.synchronized


def test_impact_far_from_all_replicas_ends_synchronization() -> None:
    """An impact is reported at a stop from which all replicas are far."""
    watcher = started(THREE_MASS.system, "geometric", TRUTH.states[0], deviation=1e-9)
    distances(watcher)
    stamp = int(TRUTH.stamps[-1])
    assert watcher.estimate(stamp).synchronized
    gap = THREE_MASS.system.gap(TRUTH.states[-1][:3])
    farthest = THREE_MASS.system.contact_names[int(np.argmax(gap))]
    watcher.receive(event(30.0, farthest, sequence=1000))
    assert not watcher.estimate(stamp).synchronized


@pytest.mark.slow
@CERTIFIED
@examples(8)
@given(st.data())
def test_certified_bound_holds_on_random_systems(law: str, data: st.DataObject) -> None:
    """From an initial state within the declared uncertainty."""
    model = data.draw(systems(contacts=(1, 2), gaps=(0.0, 1.0), common_restitution=True))
    x = np.concatenate([data.draw(vectors(model.n, -0.5, 0.5)), data.draw(vectors(model.n))])
    assume(np.all(model.gap(x[: model.n]) >= 0))
    start = x + data.draw(vectors(2 * model.n))
    watcher = observer(model, law, start, epoch=EPOCH, ensemble=1)
    try:
        plant = run(model, x[: model.n], x[model.n :], seconds=4.0, rate=5.0)
        found = distances(watcher, plant)
    except ImpactLawError:
        assume(False)
        return
    bounds = [watcher.estimate(int(stamp)).bound for stamp in plant.stamps]
    size = 1e-9 * (1 + bounds[0])
    assert all(v <= bound + size for v, bound in zip(found, bounds, strict=True))


def test_refuted_bound_is_dropped() -> None:
    """A wrong start with a small declared deviation: nothing is certified in the end."""
    watcher = started(THREE_MASS.system, "geometric", random_start(5), deviation=1e-3)
    distances(watcher)
    assert watcher.estimate(EPOCH).bound > 0
    assert watcher.estimate(int(TRUTH.stamps[-1])).bound == -1.0


def test_law_that_corrects_no_gap_certifies_nothing() -> None:
    """Kinematic constraints do not use the position of the replica."""
    watcher = observer(THREE_MASS.system, "kinematic", random_start(5), epoch=EPOCH, history=LONG)
    distances(watcher)
    assert {watcher.estimate(int(stamp)).bound for stamp in TRUTH.stamps} == {-1.0}


def test_nothing_is_certified_after_an_impact_that_may_raise_V() -> None:  # noqa: N802
    """Two contacts that are not M-orthogonal, with restitution 1 and 0, hit at once."""
    corner = [([1, 0], 0.1, 1.0), ([1, 1], 0.1, 0.0)]
    watcher = observer(chain(2, contacts=corner), "geometric", [0, 0, -1, -1], epoch=EPOCH)
    watcher.receive(event(0.5, "c1", sequence=1))
    assert watcher.estimate(EPOCH + NS_PER_S).bound > 0
    watcher.receive(event(0.9, "c1", "c2", sequence=2))
    assert watcher.estimate(EPOCH + NS_PER_S).bound == -1.0


def test_covariance_given_with_a_state_spreads_the_replicas() -> None:
    """A small one makes them agree at once; without one, the initial covariance is used."""
    watcher = observer(THREE_MASS.system, "geometric", random_start(6), epoch=EPOCH)
    wide = watcher.estimate(EPOCH).convergence
    x = random_start(6)[:3], random_start(6)[3:]
    watcher.set_state(EPOCH + NS_PER_S, *x, covariance=1e-8 * np.eye(6))
    narrow = watcher.estimate(EPOCH + NS_PER_S).convergence
    assert narrow == pytest.approx(1e-8 * wide, rel=1e-6)
    watcher.set_state(EPOCH + NS_PER_S, *x)
    assert watcher.estimate(EPOCH + NS_PER_S).convergence == pytest.approx(wide, rel=1e-12)


def test_replica_whose_impact_has_no_solution_keeps_its_state() -> None:
    """The estimate is made without it, and does not agree with it."""
    stops = [([1.0], 0.0, 0.0), ([-1.0], 0.0, 1.0)]  # no play between them
    watcher = observer(chain(1, contacts=stops), "kinematic", [0.0, 0.0], epoch=EPOCH)
    assert watcher.receive(event(1.0, "c1", "c2", sequence=1))[0].ruling is Ruling.APPLIED
    found = watcher.estimate(EPOCH + NS_PER_S)
    assert found.u.tolist() == [0.0]
    assert found.convergence > 1e-3


@pytest.mark.slow
def test_ball_at_rest_is_synchronized() -> None:
    """Differences fall below its largest energy as far as stamps of 1 ns allow."""
    ball = sample("bouncing_ball")
    plant = run(ball.system, *ball.initial_state(), seconds=12.0, rate=1.0)
    watcher = observer(ball.system, "geometric", [1.3, 0.2], epoch=EPOCH, history=LONG)
    distances(watcher, plant)
    last = watcher.estimate(int(plant.stamps[-1]))
    assert last.closed == ("floor",)
    assert last.synchronized


@pytest.mark.parametrize(("law", "finds_the_height"), [("kinematic", False), ("geometric", True)])
def test_a_rigid_motion_that_is_off_is_not_synchronized(law: str, finds_the_height: bool) -> None:
    """A ball on a table that moves: V has no part of a wrong height, but gaps at impacts do."""
    ball = sample("ball_on_table")
    position, velocity = ball.initial_state()
    plant = run(ball.system, position, velocity, seconds=20.0, rate=100.0)
    start = np.concatenate([position + 0.1, velocity - 0.2])
    watcher = started(ball.system, law, start, 0.3)
    flags = []
    for each in plant.events:
        watcher.receive(each)
        flags.append(watcher.estimate(each.stamp).synchronized)
    last = watcher.estimate(int(plant.stamps[-1]))
    error = abs(last.q[0] - plant.states[-1, 0])
    assert (error < 1e-6) == finds_the_height
    assert last.synchronized == finds_the_height
    assert any(flags) == finds_the_height


def test_each_part_of_a_system_must_agree() -> None:
    """Nothing couples a hammer and a door: hits of one say nothing of the other."""
    uncoupled = system(
        np.eye(2), 0.1 * np.eye(2), np.eye(2), contacts=[([1, 0], 1, 0.5), ([0, 1], 1, 0.5)]
    )
    test = SynchronizationTest(uncoupled, mechanism_of(uncoupled))
    result = Synchronization(0.0, 1.0, 1.0)
    x = np.array([-1.0, -1.0, 1.0, 1.0])  # on both stops
    belief = Belief.of(np.tile(x, (10, 1)))
    for t, hit in enumerate([(0,)] * 5 + [(1,)] * REQUIRED_EVENTS):
        assert test.obstacle(result)
        result = test.after_event(result, ContactChange(t, (), hit, ()), x, belief)
        if hit == (0,) and min(result.agreed) == 0 < REQUIRED_EVENTS <= max(result.agreed):
            assert test.obstacle(result).endswith("0 of 3 impacts in a row of c2")
    assert not test.obstacle(result)


def test_a_contact_that_opens_is_no_impact_and_ends_no_agreement() -> None:
    """Of laws without covariance, where a motion is rigid and nothing is hit."""
    ball = sample("bouncing_ball").system
    test = SynchronizationTest(ball, mechanism_of(ball))
    before = Synchronization(0.0, 1.0, 1.0, (2,), hits={0: 0.5})
    belief = Belief.of(np.tile([0.0, 1.0], (10, 1)))
    found = test.after_event(before, ContactChange(1.0, (0,), (), ()), np.zeros(2), belief)
    assert found.agreed == (2,)


@pytest.mark.filterwarnings("ignore:invalid value")
def test_estimate_that_is_not_finite_is_refused() -> None:
    """A law that overflows ends with one line; the event is not applied."""

    class Overflowing(ReplicaLaw):
        name = "overflowing"

        def impact(self, x: Array, active: tuple[int, ...], closed: tuple[int, ...]) -> Array:
            del active, closed
            return np.full_like(x, np.inf)

    law = Overflowing(THREE_MASS.system)
    watcher = Observer(THREE_MASS.system, law, np.zeros(3), np.zeros(3), epoch=EPOCH)
    with pytest.raises(DynamicsError, match="the estimate is not finite any more"):
        watcher.receive(TRUTH.events[0])
    assert np.all(np.isfinite(watcher.estimate(TRUTH.events[0].stamp).q))


def test_refuted_bound_ends_synchronization() -> None:
    """Replicas with too small a spread agree at once, but not with the plant."""
    watcher = started(THREE_MASS.system, "geometric", random_start(5), deviation=1e-6)
    distances(watcher)
    last = watcher.estimate(int(TRUTH.stamps[-1]))
    assert last.inconsistent
    assert last.convergence < 1e-10
    assert not last.synchronized
