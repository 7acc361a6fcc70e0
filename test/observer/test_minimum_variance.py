# SPDX-License-Identifier: Apache-2.0
"""The minimum-variance law: how fast its error falls, and whether its covariance is consistent."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from systems import (
    EPOCH,
    PRESSED,
    Harmonic,
    chain,
    estimates,
    forcing,
    run,
    sample,
    system,
    without_faults,
)

from impact_observer.dynamics import Phases, lyapunov
from impact_observer.events import ImpactEvent, Kind, Ruling, Switch
from impact_observer.model import Forcing, System
from impact_observer.model.force_samples import Samples
from impact_observer.observer import Belief, Observer, law_named
from impact_observer.observer.contact_change import ContactChange
from impact_observer.observer.laws.minimum_variance import MinimumVariance
from impact_observer.plant import Plant, Run, Switching, simulate
from impact_observer.stamps import NS_PER_S, Elapsed, seconds_between

Array = NDArray[np.float64]
BOTH = pytest.mark.parametrize("name", ["two_mass", "three_mass"])
JITTER = 1e-3

HAMMER = system(
    np.diag([1.0, 0.5]),
    [[0.1, -0.1], [-0.1, 0.1]],
    [[8.0, -8.0], [-8.0, 8.0]],
    contacts=[([1, 0], 0.4, 0.7), ([0, -1], 0.5, 0.6)],
    force=forcing(2, 0.0, [Harmonic(1.7, [1.5, 0], [0, 0.5])]),
)
"""Two masses, joined by a spring, that fly between two stops."""
DRILL = system(
    np.diag([1.2, 0.8]),
    np.diag([12.0, 20.0]),
    np.diag([9e3, 6e4]),
    contacts=[([-1, 1], 1.5e-3, 0.6)],
    force=forcing(2, 0.0, [Harmonic(138.0, [60.0, 0], [0, 0])]),
)
"""A hammer that is driven against a bit, which it hits 44 times a second."""


@cache
def case(name: str) -> tuple[System, Array]:
    """A system by its name, and where its plant starts, (q, u)."""
    if name == "pressed":
        return PRESSED, np.zeros(4)
    if name == "hammer":
        return HAMMER, np.array([0.0, 0.0, 1.0, -0.5])
    found = sample(name)
    return found.system, np.concatenate(found.initial_state())


@cache
def truth(name: str, seconds: float) -> Run:
    """A run of it."""
    model, start = case(name)
    return run(model, start[: model.n], start[model.n :], seconds=seconds, rate=25.0)


@cache
def states(name: str, stamps: tuple[int, ...]) -> Array:
    """True states at stamps that are no impact's, shape (samples, 2n)."""
    model, start = case(name)
    plant = Plant(model, start[: model.n], start[model.n :], epoch=EPOCH)
    return simulate(plant, np.array(stamps)).states


def watching(
    model: System, x: Array, *, clock: float = 0.0, law: str = "minimum-variance", **options: float
) -> Observer:
    """An observer that starts at ``x``."""
    ensemble = int(options.pop("ensemble", 1))
    made = law_named(law)(model, without_faults(clock_error=clock, **options))
    return Observer(
        model, made, x[: model.n], x[model.n :], epoch=EPOCH, history=1e4, ensemble=ensemble
    )


def jittered(events: Sequence[ImpactEvent], rng: np.random.Generator) -> list[ImpactEvent]:
    """The events with wrong stamps."""
    wrong = np.rint(rng.normal(0.0, JITTER * NS_PER_S, len(events))).astype(int)
    stamps = np.maximum([each.stamp for each in events] + wrong, EPOCH + 1)
    return [replace(each, stamp=at) for each, at in zip(events, stamps.tolist(), strict=True)]


def errors(name: str, watcher: Observer, *stamps: int) -> Array:
    """Estimate less truth at stamps that are no impact's, shape (samples, 2n)."""
    return np.asarray(estimates(watcher, np.array(stamps)) - states(name, stamps))


def root(watcher: Observer, stamp: int) -> Array:
    """A root of the covariance at ``stamp``: P itself would be rounding."""
    timeline = watcher.timeline
    assert timeline is not None
    entry = timeline.entry_at(stamp)
    since = Elapsed(entry.since - watcher.epoch)
    prediction = watcher.law.predict(since, entry.belief, entry.closed)
    found = prediction.root(seconds_between(entry.key.stamp, stamp))
    assert found is not None
    return found


def nees(watcher: Observer, stamp: int, error: Array) -> float:
    """Normalised estimation error squared, over 2n."""
    found = np.linalg.lstsq(root(watcher, stamp), error, rcond=None)[0]
    return float(found @ found) / error.size


def after(events: Sequence[ImpactEvent], k: int) -> int:
    """A stamp 6 ms after the k-th impact: on the same side of it for truth and estimate."""
    stamp = events[k - 1].stamp + 6_000_000
    assert stamp < events[k].stamp - 6_000_000
    return stamp


@pytest.mark.parametrize("name", ["two_mass", pytest.param("three_mass", marks=pytest.mark.slow)])
def test_error_is_rounding_after_twice_as_many_impacts_as_coordinates(name: str) -> None:
    """Stamps of 1 ns, 2n + 2 impacts, median of 20 wrong starts."""
    (model, start), events = case(name), truth(name, 30.0).events
    first = events[: 2 * model.n + 2]
    stamp, ratios = events[len(first) - 1].stamp + 1_000_000, []
    for seed in range(20):
        wrong = np.random.default_rng(seed).normal(size=2 * model.n)
        watcher = watching(model, start + wrong)
        for each in first:
            watcher.receive(each)
        left = errors(name, watcher, stamp)[0]
        V = [float(lyapunov.distance(model, *np.split(each, 2))) for each in (left, wrong)]
        ratios.append(V[0] / V[1])
    assert np.median(ratios) <= 1e-14
    assert max(ratios) <= 1e-12


@pytest.mark.long
@BOTH
def test_covariance_is_consistent_with_the_errors(name: str) -> None:
    """NEES and innovations for stamp errors of 1 ms and initial errors as declared.

    Means of 40 runs just after the 2n-th and two later impacts, as near to 1 as 40 runs can
    show.
    """
    (model, start), events = case(name), truth(name, 30.0).events
    stamps = [after(events, k) for k in (2 * model.n, 2 * model.n + 5, 15)]
    squares, innovations = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        watcher = watching(model, start + rng.normal(size=2 * model.n), clock=JITTER)
        for each in jittered(events[:15], rng):
            innovations += [verdict.innovation for verdict in watcher.receive(each)]
        wrong = errors(name, watcher, *stamps)
        squares.append([nees(watcher, s, each) for s, each in zip(stamps, wrong, strict=True)])
    for mean in np.mean(squares, axis=0):  # of 2n squares of normal numbers each
        assert 0.3 <= mean <= 1.4
    assert 0.8 <= np.mean(np.square(innovations)) <= 1.2
    assert np.max(innovations) < 5


@pytest.mark.slow
@BOTH
def test_error_under_jitter_is_far_below_that_of_geometric(name: str) -> None:
    """Stamps with jitter of 1 ms; the median V of 8 runs is less than a hundredth."""
    (model, start), whole = case(name), truth(name, 30.0)
    found: dict[tuple[str, float], list[float]] = {}
    for seed in range(8):
        for law, clock in (("geometric", 0.0), ("minimum-variance", JITTER)):
            rng = np.random.default_rng(seed)
            watcher = watching(model, start + rng.normal(size=2 * model.n), clock=clock, law=law)
            for each in jittered(whole.events, rng):
                watcher.receive(each)
            stamp = after(whole.events, len(whole.events) - 1)
            left = errors(name, watcher, stamp)[0]
            V = float(lyapunov.distance(model, *np.split(left, 2)))
            found.setdefault((law, clock), []).append(V)
    medians = {law: np.median(V) for (law, _), V in found.items()}
    assert medians["minimum-variance"] < 1e-2 * medians["geometric"]


def followed(model: System, law: MinimumVariance, x: Array, switchings: list[Switching]) -> Belief:
    """The belief just after the last impact, with exact instants instead of stamps."""
    belief, t = law.begin(x[None], law.uncertainty.root(model.n), ()), 0.0
    for each in switchings:
        now = -each.instant.until(EPOCH)
        belief = law.predict(t, belief, ()).belief(now - t)
        belief, t = law.correct(ContactChange(now, (), each.contacts, ()), belief), now
    return belief


@pytest.mark.parametrize("count", [1, 3, 5])
def test_filter_is_batch_least_squares_over_all_events(count: int) -> None:
    """Exact instants: the rows ``w^T Phi .. J .. Phi`` stacked, and the start nearest to them.

    The remaining error is its projection onto their null space. The oracle propagates states and
    has no filter; it also reflects positions at an impact.
    """
    model, phase = sample("three_mass").system, Phases(sample("three_mass").system).phase()
    n, law = model.n, MinimumVariance(model, without_faults())
    switchings = list(truth("three_mass", 30.0).switchings[:count])
    guess = np.random.default_rng(3).normal(size=2 * n)
    F, x, t, rows, values = np.eye(2 * n), guess, 0.0, [], []
    for each in switchings:
        now, (i,) = -each.instant.until(EPOCH), each.contacts
        F, x = phase.transition(now - t) @ F, phase.start(t, x).state(now - t)
        w, t = np.concatenate([model.W[:, i], np.zeros(n)]), now
        gap = float(model.gap(x[:n])[i])
        rows.append(w @ F)
        values.append(gap)
        push = np.linalg.solve(model.M, model.W[:, i])
        J = np.eye(n) - (1 + model.eps[i]) * np.outer(push, model.W[:, i] / (push @ model.W[:, i]))
        F = np.kron(np.eye(2), J) @ F
        push = (J - np.eye(n)) @ model.W[:, i] / (model.W[:, i] @ model.W[:, i])
        x = np.concatenate([x[:n] + push * gap, J @ x[n:]])
    left = np.linalg.lstsq(np.array(rows), -np.array(values), rcond=None)[0]
    unknown = F @ (np.eye(2 * n) - np.linalg.pinv(np.array(rows)) @ np.array(rows)) @ F.T
    belief = followed(model, law, guess, switchings)
    assert belief.root is not None
    np.testing.assert_allclose(belief.x, x + F @ left, atol=2e-7)
    np.testing.assert_allclose(belief.root @ belief.root.T, unknown, atol=2e-8)


@pytest.mark.slow
def test_estimate_converges_through_persistent_contact() -> None:
    """P is zero along closed contacts, and nothing is NaN."""
    whole = truth("pressed", 11.5)
    for seed in range(2):
        rng = np.random.default_rng(seed)
        watcher = watching(PRESSED, rng.normal(size=4), clock=0.0, ensemble=3)
        for each in whole.events:
            watcher.receive(each)
        asked = [watcher.estimate(stamp) for stamp in whole.stamps.tolist()]
        for estimate in asked:
            assert np.all(np.isfinite(estimate.covariance))
            for name in estimate.closed:
                W = np.kron(np.eye(2), PRESSED.W[:, PRESSED.contact_names.index(name)])
                assert np.max(np.abs(W @ estimate.covariance @ W.T)) <= 1e-10
        away = np.array([np.concatenate([e.q, e.u]) for e in asked]) - whole.states
        assert np.max(np.abs(away[-50:])) < 1e-12


@pytest.mark.slow
def test_estimate_of_a_ball_converges_through_accumulation_to_rest() -> None:
    """K = 0 and 170 impacts within eight seconds; two of them determine the state."""
    model, whole = sample("bouncing_ball").system, truth("bouncing_ball", 10.0)
    watcher = watching(model, np.array([1.7, 0.4]), ensemble=3)
    for each in whole.events:
        watcher.receive(each)
    differences = np.abs(estimates(watcher, whole.stamps) - whole.states).max(axis=1)
    assert np.max(differences[50:200]) < 1e-7
    end = watcher.estimate(int(whole.stamps[-1]))
    assert end.closed == ("floor",)
    assert np.max(np.abs([end.q, end.u])) < 1e-12
    assert np.max(np.abs(end.covariance)) < 1e-15


@pytest.mark.parametrize("clock", [0.0, JITTER])
def test_position_of_a_free_body_is_estimated(clock: float) -> None:
    """K is singular: V does not measure the position, the impacts do."""
    whole, start = truth("hammer", 20.0), case("hammer")[1]
    rng = np.random.default_rng(1)
    watcher = watching(HAMMER, start + rng.normal(size=4), clock=clock)
    for each in jittered(whole.events, rng) if clock else whole.events:
        watcher.receive(each)
    stamp = int(whole.stamps[-1])
    wrong = errors("hammer", watcher, stamp)[0]
    assert np.max(np.abs(wrong)) < (1e-3 if clock else 1e-9)
    assert nees(watcher, stamp, wrong) < 3


def test_release_where_the_force_jumps_measures_nothing() -> None:
    """Its load need not have come down to zero; the same for contacts that open together.

    A step of a table, alone or beside another one, is such a jump.
    """
    t = np.array([0.0, 0.5, 9.0])
    steps = Samples(t, np.array([[-3.0], [3.0], [3.0]]), "previous")
    added = steps.plus(Samples(t, np.zeros((3, 1)), "linear"))
    jumping, both = (
        system(1, 0.1, 1, contacts=[([1], 0.0, 0.5)], force=Forcing.of_samples(each))
        for each in (steps, added)
    )
    for model, closed in ((jumping, (0,)), (both, (0,)), (PRESSED, (0, 1))):
        law = MinimumVariance(model, without_faults())
        x = np.zeros((1, 2 * model.n))
        start = law.begin(x, law.uncertainty.root(model.n), closed)
        flight = law.predict(0.0, start, closed)
        opened = law.correct(ContactChange(0.5, closed, (), ()), flight.belief(0.5))
        assert not opened.innovations
        before = flight.root(0.5)
        assert opened.root is not None
        assert before is not None
        np.testing.assert_allclose(opened.root @ opened.root.T, before @ before.T, atol=1e-9)


def test_contacts_closed_at_the_start_hold_at_once() -> None:
    """Nearest in the declared covariance, which is singular along them."""
    law = MinimumVariance(PRESSED, without_faults(deviation=np.array([1.0, 2.0, 1.0, 0.5])))
    belief = law.begin(np.array([[0.3, 0.4, 1, 2], [0, 0, 0, 0]]), law.uncertainty.root(2), (0,))
    np.testing.assert_allclose(belief.x, [0.3, 0.1, 1, 0], atol=1e-13)
    assert belief.root is not None
    P = belief.root @ belief.root.T
    np.testing.assert_allclose(P, np.diag([1.0, 0, 1.0, 0]), atol=1e-13)


@pytest.mark.slow
def test_model_error_lets_covariance_grow_and_leaves_the_estimate() -> None:
    """The variance of a free ball's velocity grows by ``w^2 t``; not at all for w = 0."""
    model, x = sample("bouncing_ball").system, np.array([1.0, 0.5])
    exact, doubting = watching(model, x), watching(model, x, model_error=0.2)
    stamp = EPOCH + 2 * NS_PER_S
    one, two = exact.estimate(stamp), doubting.estimate(stamp)
    assert (one.q, one.u) == (two.q, two.u)
    np.testing.assert_allclose(
        two.covariance - one.covariance,
        0.04 * np.array([[8 / 3, 2.0], [2.0, 2.0]]),
        atol=1e-12,
    )
    for each in truth("bouncing_ball", 10.0).events:
        doubting.receive(each)
    end = doubting.estimate(EPOCH + 10 * NS_PER_S)
    assert np.max(np.abs([end.q, end.u])) < 1e-12
    assert np.max(np.abs(end.covariance)) < 1e-20


@pytest.mark.parametrize("damping", [1e3, 1e6])
def test_stiff_damping_does_not_overflow_backwards_in_time(damping: float) -> None:
    """Motions fade by a factor of ten million within the clock error of 0.01 s."""
    model = chain(2, damping=damping, contacts=[([0, -1], 0.1, 0.5)])
    watcher = watching(model, np.array([0.2, 0.3, 1, 1]), clock=0.01, ensemble=3)
    for k in range(1, 6):
        stamp = EPOCH + k * NS_PER_S // 2
        watcher.receive(ImpactEvent(stamp, (Switch("c1"),), k, 0, EPOCH))
        end = watcher.estimate(stamp + NS_PER_S // 4)
        assert np.all(np.isfinite(np.concatenate([end.q, end.u, end.covariance.ravel()])))
        assert np.max(np.abs(end.q)) < 1.0


def test_instant_stays_within_the_samples_of_the_force() -> None:
    """Impacts just after the first and just before the last sample, with a clock error."""
    samples = Samples(np.array([0.0, 1.0]), np.array([[-1.0], [1.0]]), "linear")
    model = system(1, 0.1, 1, contacts=[([1], 0.5, 0.5)], force=Forcing.of_samples(samples))
    for gap in (-0.2, 0.2):
        watcher = watching(model, np.array([gap - 0.5, -1.0]), clock=0.1)
        for k, stamp in enumerate((1, NS_PER_S - 1)):
            watcher.receive(ImpactEvent(EPOCH + stamp, (Switch("c1"),), k + 1, 0, EPOCH))
        end = watcher.estimate(EPOCH + NS_PER_S)
        assert np.all(np.isfinite([end.q, end.u]))


@pytest.mark.parametrize("speed", [-1e-9, 0.0, 1e-9])
def test_grazing_impact_divides_by_nothing(speed: float) -> None:
    """Contact speed zero, or hardly positive."""
    model = sample("two_mass").system
    law = MinimumVariance(model, without_faults(clock_error=JITTER))
    x = np.array([[0.1, 0.5, 0.0, -speed]])
    belief = law.correct(ContactChange(1.0, (), (0,), ()), law.begin(x, 0.1 * np.eye(4), ()))
    assert belief.root is not None
    assert np.all(np.isfinite(belief.root))
    assert np.all(np.isfinite(belief.x))


def test_contacts_that_hit_together_share_one_instant() -> None:
    """Two beads and a wall: both gaps correct the state and the stamp's error."""
    beads = system(
        np.eye(2),
        np.zeros((2, 2)),
        np.zeros((2, 2)),
        contacts=[([1, 0], 0.0, 0.5), ([-1, 1], 0.0, 0.5)],
        force=forcing(2, -1.0),
    )
    law = MinimumVariance(beads, without_faults(clock_error=JITTER))
    start = law.begin(np.array([[0.2, -0.1, -1.0, -2.0]]), law.uncertainty.root(2), ())
    belief = law.correct(ContactChange(0.5, (), (0, 1), ()), start)
    assert sorted(belief.innovations) == [0, 1]
    assert belief.root is not None
    assert np.max(np.linalg.norm(beads.W.T @ belief.root[:2], axis=1)) < 0.01
    assert np.max(np.abs(beads.gap(belief.x[:2]))) < 0.01


def test_same_stop_given_twice_is_one_stop() -> None:
    """Redundant contacts hit, close, stay and open as one."""
    once = system(1, 0.1, 1, contacts=[([1], 0.0, 0.5)], force=forcing(1, -2.0))
    contacts = [([1], 0.0, 0.5), ([2], 0.0, 0.5)]
    twice = system(1, 0.1, 1, contacts=contacts, force=forcing(1, -2.0))
    found = []
    for model, names in ((once, ("c1",)), (twice, ("c1", "c2"))):
        watcher = watching(model, np.array([0.7, 0.4]), clock=1e-4)
        for k, kind in enumerate((Kind.IMPACT, Kind.CLOSE, Kind.OPEN, Kind.IMPACT)):
            switches = tuple(Switch(name, kind) for name in names)
            stamp = EPOCH + (k + 1) * NS_PER_S // 2
            watcher.receive(ImpactEvent(stamp, switches, k + 1, 0, EPOCH))
        end = watcher.estimate(EPOCH + 9 * NS_PER_S // 4)
        found.append(np.concatenate([end.q, end.u]))
    np.testing.assert_allclose(found[0], found[1], atol=1e-2)


def test_impact_of_a_closed_contact_implies_a_missed_opening() -> None:
    """It is applied, and nothing is NaN."""
    watcher = watching(PRESSED, np.zeros(4))
    for k, kind in enumerate((Kind.CLOSE, Kind.IMPACT, Kind.IMPACT)):
        event = ImpactEvent(EPOCH + (k + 1) * NS_PER_S, (Switch("c1", kind),), k + 1, 0, EPOCH)
        assert watcher.receive(event)[0].ruling is Ruling.APPLIED
    end = watcher.estimate(EPOCH + 4 * NS_PER_S)
    assert end.closed == ()
    assert np.all(np.isfinite(np.concatenate([end.q, end.u, end.covariance.ravel()])))


def test_state_and_root_are_those_of_the_predicted_belief() -> None:
    """In flight and in contact."""
    law = MinimumVariance(PRESSED, without_faults(model_error=0.1))
    for closed in ((), (0,), (0, 1)):
        belief = law.begin(np.array([[0.3, 0.1, -1.0, 2.0]]), law.uncertainty.root(2), closed)
        prediction = law.predict(0.3, belief, closed)
        for s in (0.0, 0.4, 3.0):
            whole, root = prediction.belief(s), prediction.root(s)
            np.testing.assert_allclose(prediction.state(s), whole.x, atol=1e-14)
            own = whole.root
            assert root is not None
            assert own is not None
            np.testing.assert_allclose(root @ root.T, own @ own.T, atol=1e-13)
