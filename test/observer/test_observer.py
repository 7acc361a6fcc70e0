# SPDX-License-Identifier: Apache-2.0
"""The observer: estimates depend on the events received, and on nothing else."""

from itertools import permutations

import numpy as np
import pytest
from numpy.typing import NDArray
from systems import (
    EPOCH,
    chain,
    estimates,
    event,
    flow_of,
    observer,
    reachable,
    run,
    sample,
    system,
)

from impact_observer.dynamics import lyapunov
from impact_observer.errors import ImpactLawError, UsageError
from impact_observer.events import ImpactEvent, Ruling
from impact_observer.model import System
from impact_observer.observer import Observer
from impact_observer.observer.laws.kinematic import Kinematic
from impact_observer.plant import Run
from impact_observer.stamps import NS_PER_S

Array = NDArray[np.float64]
TWO_MASS = sample("two_mass").system


def true_run(name: str, seconds: float, rate: float = 100.0) -> Run:
    """A run of a sample model from its own initial state."""
    model = sample(name)
    return run(model.system, *model.initial_state(), seconds=seconds, rate=rate)


def random_start(n: int, seed: int) -> Array:
    """The initial state ``random:SEED``."""
    return np.random.default_rng(seed).normal(size=2 * n)


def rulings_of(watcher: Observer, run: Run) -> list[Ruling]:
    """The verdicts on all events of a run."""
    return [verdict.ruling for each in run.events for verdict in watcher.receive(each)]


def distances(model: System, watcher: Observer, run: Run) -> Array:
    """``V`` at the samples of a run, both sides after all events at or before them."""
    difference = estimates(watcher, run.stamps) - run.states
    return np.asarray(lyapunov.distance(model, difference[:, : model.n], difference[:, model.n :]))


def state(watcher: Observer, seconds: float) -> list[float]:
    """The estimate at ``seconds`` since ``EPOCH``."""
    found = watcher.estimate(EPOCH + round(seconds * NS_PER_S))
    return [*found.q.tolist(), *found.u.tolist()]


@pytest.mark.parametrize("name", ["two_mass", pytest.param("three_mass", marks=pytest.mark.slow)])
def test_geometric_law_ends_closer_than_kinematic(name: str) -> None:
    """The paper's claim, in the median of 20 initial states after 30 s."""
    model, truth = sample(name).system, true_run(name, 30.0, rate=1.0)
    ratios = {}
    for law in ("kinematic", "geometric"):
        ends = []
        for seed in range(20):
            watcher = observer(model, law, random_start(model.n, seed), epoch=EPOCH, history=100.0)
            rulings_of(watcher, truth)
            V = distances(model, watcher, truth)
            ends.append(V[-1] / V[0])
        ratios[law] = np.median(ends)
    assert ratios["geometric"] < ratios["kinematic"]


def test_open_loop_is_the_flow_without_contact() -> None:
    """Events have no effect."""
    x, truth = random_start(2, 3), true_run("two_mass", 8.0)
    watcher = observer(TWO_MASS, "open-loop", x)
    rulings_of(watcher, truth)
    motion = flow_of(TWO_MASS).start(0.0, x)
    for seconds in (0.25, truth.impacts[0].instant.stamp / NS_PER_S - 5, 7.5):
        np.testing.assert_allclose(state(watcher, seconds), motion.state(seconds), atol=1e-12)


@pytest.mark.slow
def test_geometric_observer_of_a_ball_finds_its_height() -> None:
    """K = 0: each bounce determines the height exactly, and the speed converges with eps."""
    model, truth = sample("bouncing_ball").system, true_run("bouncing_ball", 7.5)
    watcher = observer(model, "geometric", [3.0, -2.0])
    rulings_of(watcher, truth)
    error = np.abs(estimates(watcher, truth.stamps) - truth.states)
    assert error[0].tolist() == [2.0, 2.0]
    bounce = np.searchsorted(truth.stamps, truth.impacts[0].instant.stamp)
    assert error[bounce, 0] < 0.05
    assert np.all(error[-1] < 2.5 * 0.9 ** len(truth.impacts))
    V = distances(model, watcher, truth)
    assert np.max(np.diff(V)) <= 1e-9 * V[0]


def test_order_of_arrival_does_not_decide_where_a_late_observer_starts() -> None:
    """Events 4, 5 and 6 in any order: the initial state holds at the earliest stamp."""
    events = [event(0.5 * k, "stop", sequence=k) for k in (4, 5, 6)]
    found = set()
    for order in permutations(events):
        watcher = observer(TWO_MASS, "geometric", random_start(2, 2))
        for each in order:
            watcher.receive(each)
        assert watcher.start == EPOCH + 2 * NS_PER_S
        found.add(tuple(state(watcher, 3.5)))
    assert len(found) == 1


def test_shifting_epoch_and_stamps_changes_no_estimate() -> None:
    """By years: the same bits."""
    truth, moved = true_run("two_mass", 4.0), 1_600_000_000_000_000_001
    here, there = (observer(TWO_MASS, "geometric", random_start(2, 5)) for _ in range(2))
    for each in truth.events:
        here.receive(each)
        there.receive(
            ImpactEvent(each.stamp + moved, each.switches, each.sequence, 0, each.epoch + moved)
        )
    late = estimates(there, truth.stamps + moved)
    assert late.tolist() == estimates(here, truth.stamps).tolist()


def test_initial_state_holds_at_the_epoch() -> None:
    """When the first event is the sender's first, or the sender does not count."""
    x = random_start(2, 1)
    for sequence in (0, 1):
        watcher = observer(TWO_MASS, "geometric", x)
        starts = [watcher.start]
        watcher.receive(event(2.0, "stop", sequence=sequence))
        assert [*starts, watcher.start] == [None, EPOCH]
        assert state(watcher, 0.0) == pytest.approx(x.tolist(), abs=1e-12)


def test_initial_state_holds_at_the_first_stamp_of_a_late_observer() -> None:
    """Just before the event of that stamp; the forcing's phase is still the epoch's."""
    x = random_start(2, 1)
    watcher = observer(TWO_MASS, "open-loop", x)
    watcher.receive(event(2.0, "stop", sequence=5))
    assert watcher.start == EPOCH + 2 * NS_PER_S
    expected = flow_of(TWO_MASS).start(2.0, x).state(0.7)
    np.testing.assert_allclose(state(watcher, 2.7), expected, atol=1e-12)


def test_given_epoch_allows_estimates_before_the_first_event() -> None:
    """A first event with a higher sequence number then moves the start."""
    x = random_start(2, 1)
    watcher = observer(TWO_MASS, "open-loop", x, epoch=EPOCH)
    assert state(watcher, 0.0) == pytest.approx(x.tolist(), abs=1e-12)
    assert watcher.epoch == EPOCH
    watcher.receive(event(2.0, "stop", sequence=5))
    assert watcher.start == EPOCH + 2 * NS_PER_S
    assert state(watcher, 2.0) == pytest.approx(x.tolist(), abs=1e-12)


def test_system_without_time_needs_no_epoch() -> None:
    """It starts at the first stamp received."""
    model = chain(1, contacts=[([-1], 0.5, 0.7)])
    watcher = observer(model, "geometric", [0.3, 1.0])
    watcher.receive(event(2.0, "c1", epoch=0))
    assert watcher.start == EPOCH + 2 * NS_PER_S
    np.testing.assert_allclose(state(watcher, 2.0), [0.5, -0.7], rtol=1e-12)


def test_duplicate_gets_a_verdict_and_changes_nothing() -> None:
    """By its sequence number, or where it has none by stamp and switches."""
    for sequence in (0, 7):
        watcher = observer(TWO_MASS, "geometric", random_start(2, 1))
        watcher.receive(event(1.0, "stop", sequence=sequence))
        before = state(watcher, 1.5)
        verdict = watcher.receive(event(1.0, "stop", sequence=sequence))[0]
        assert verdict.ruling is Ruling.DUPLICATE
        assert (verdict.stamp, verdict.sequence) == (EPOCH + NS_PER_S, sequence)
        assert verdict.reason
        assert state(watcher, 1.5) == before


def test_unknown_contact_gets_a_verdict_and_the_others_are_applied() -> None:
    """One verdict a switch; the reason names the contacts that exist."""
    with_it, without = (observer(TWO_MASS, "geometric", random_start(2, 1)) for _ in range(2))
    verdicts = with_it.receive(event(1.0, "wall", "stop", sequence=1))
    without.receive(event(1.0, "stop", sequence=1))
    assert [(v.contact, v.ruling) for v in verdicts] == [
        ("wall", Ruling.UNKNOWN_CONTACT),
        ("stop", Ruling.APPLIED),
    ]
    assert verdicts[0].reason == "the model's contacts are stop"
    assert state(with_it, 2.0) == state(without, 2.0)


def test_event_with_unknown_contacts_only_is_not_missing() -> None:
    """It was received, without effect."""
    watcher = observer(TWO_MASS, "geometric", random_start(2, 1), epoch=EPOCH)
    watcher.receive(event(1.0, "wall", sequence=1))
    watcher.receive(event(2.0, "stop", sequence=2))
    assert watcher.missing == 0
    assert watcher.last_event == EPOCH + 2 * NS_PER_S


def test_event_before_the_kept_history_is_too_late() -> None:
    """Beyond the history, or before the epoch; the reason says where the past begins."""
    watcher = observer(TWO_MASS, "geometric", random_start(2, 1), epoch=EPOCH, history=2.0)
    assert watcher.receive(event(-1.0, "stop"))[0].ruling is Ruling.TOO_LATE
    for k in range(1, 9):
        watcher.receive(event(float(k), "stop"))
    before = state(watcher, 9.0)
    verdict = watcher.receive(event(5.5, "stop"))[0]
    assert verdict.ruling is Ruling.TOO_LATE
    assert verdict.reason == "before 11.000000000 s, the start of the history"
    assert state(watcher, 9.0) == before
    assert watcher.receive(event(6.5, "stop"))[0].ruling is Ruling.APPLIED
    assert state(watcher, 9.0) != before


def test_event_of_an_old_episode_is_rejected() -> None:
    """One that arrives after the sender's reset."""
    watcher = observer(TWO_MASS, "geometric", random_start(2, 1))
    watcher.receive(event(1.0, "stop", sequence=1, episode=3))
    before = state(watcher, 2.0)
    verdict = watcher.receive(event(1.5, "stop", sequence=9, episode=2))[0]
    assert (verdict.ruling, verdict.reason) == (
        Ruling.REJECTED,
        "episode 2 of epoch 5.000000000 s is older than episode 3 of epoch 5.000000000 s",
    )
    assert state(watcher, 2.0) == before


@pytest.mark.parametrize(
    "change", [{"episode": 1, "epoch": EPOCH + 9}, {"episode": 0, "epoch": EPOCH + 9}]
)
def test_new_episode_or_epoch_restarts_the_observer(change: dict[str, int]) -> None:
    """The estimates are those of a new observer; sequence numbers start again."""
    x = random_start(2, 1)
    used, fresh = observer(TWO_MASS, "geometric", x), observer(TWO_MASS, "geometric", x)
    used.receive(event(1.0, "stop", sequence=1))
    used.receive(event(4.0, "stop", sequence=2))
    again = event(5.0, "stop", sequence=1, **change)
    second = event(5.5, "stop", sequence=2, **change)
    for watcher in (used, fresh):
        assert watcher.receive(again)[0].ruling is Ruling.APPLIED
        watcher.receive(second)
    assert (used.restarts, fresh.restarts) == (1, 0)
    assert used.epoch == used.start == EPOCH + 9
    assert used.missing == 0
    for seconds in (3.0, 5.2, 6.0):
        assert state(used, seconds) == state(fresh, seconds)


def test_lost_events_are_counted() -> None:
    """Between the first and the last number received; late ones are subtracted."""
    watcher = observer(TWO_MASS, "geometric", random_start(2, 1))
    for sequence in (3, 4, 8):
        watcher.receive(event(float(sequence), "stop", sequence=sequence))
    assert watcher.missing == 3
    watcher.receive(event(5.0, "stop", sequence=5))
    watcher.receive(event(2.0, "stop", sequence=2))
    assert watcher.missing == 2
    watcher.receive(event(2.0, "stop", sequence=2))
    assert watcher.missing == 2


@pytest.mark.slow
def test_memory_is_bounded() -> None:
    """Of thousands of events the history is kept, and old duplicates are still refused."""
    model = chain(1, contacts=[([-1], 0.5, 0.7)])
    watcher = observer(model, "kinematic", [0.3, 1.0], history=1.0)
    first = event(0.1, "c1", sequence=1)
    watcher.receive(first)
    early = 0
    for k in range(2, 3000):
        watcher.receive(event(0.1 * k, "c1", sequence=k))
        early = early or (k == 300 and reachable(watcher))
    assert watcher.timeline is not None
    assert len(watcher.timeline.entries) <= 12
    assert reachable(watcher) <= 1.1 * early
    assert watcher.missing == 0
    assert watcher.receive(first)[0].ruling is Ruling.TOO_LATE
    assert watcher.missing == 0


def test_forcing_without_an_epoch_is_one_line() -> None:
    """The event is neither applied nor remembered; with a given epoch it is applied."""
    watcher = observer(TWO_MASS, "geometric", random_start(2, 1))
    silent = event(1.0, "stop", sequence=1, epoch=0)
    for _ in range(2):
        with pytest.raises(UsageError, match="epoch"):
            watcher.receive(silent)
    informed = observer(TWO_MASS, "geometric", random_start(2, 1), epoch=EPOCH)
    assert informed.receive(silent)[0].ruling is Ruling.APPLIED


def test_impact_without_a_solution_is_not_applied() -> None:
    """The error names the stamp, and the replica moves as without the event."""
    model = system(1, 0, 1, contacts=[([1], 0.0, 0.8), ([-1], 0.0, 0.5)])
    watcher = observer(model, "kinematic", [0.0, -1.0], epoch=EPOCH)
    with pytest.raises(ImpactLawError, match=r"at 5\.000000000 s"):
        watcher.receive(event(0.0, "c1", "c2", sequence=1))
    np.testing.assert_allclose(state(watcher, 0.0), [0.0, -1.0], atol=1e-12)
    assert watcher.last_event == 0


def test_simultaneous_impacts_are_one_event_or_two() -> None:
    """One event applies the impact law to both contacts; two of equal stamp act in turn."""
    model = chain(2, contacts=[([1, 0], 0.1, 0.5), ([-1, 1], 0.1, 0.5)])
    x = [0.0, 0.0, -2.0, -3.0]
    together, differences = (observer(model, "kinematic", x, epoch=EPOCH) for _ in range(2))
    together.receive(event(1.0, "c1", "c2", sequence=1))
    differences.receive(event(1.0, "c1", sequence=1))
    differences.receive(event(1.0, "c2", sequence=2))
    law, before = Kinematic(model), flow_of(model).start(0.0, np.array(x)).state(1.0)
    assert state(together, 1.0) == pytest.approx(
        law.impact(before, (0, 1), ()).tolist(), abs=1e-12
    )
    successive = law.impact(law.impact(before, (0,), ()), (1,), ())
    assert state(differences, 1.0) == pytest.approx(successive.tolist(), abs=1e-12)


def test_estimate_names_its_stamp_law_and_last_event() -> None:
    """The last event at or before the stamp, not the last received."""
    watcher = observer(TWO_MASS, "geometric", random_start(2, 1), epoch=EPOCH)
    watcher.receive(event(1.0, "stop", sequence=1))
    watcher.receive(event(2.0, "stop", sequence=2))
    for seconds, sequence in ((0.5, 0), (1.0, 1), (1.5, 1), (2.0, 2)):
        stamp = EPOCH + round(seconds * NS_PER_S)
        found = watcher.estimate(stamp)
        assert (found.stamp, found.law, found.last_sequence) == (stamp, "geometric", sequence)
        assert found.last_event == (EPOCH + sequence * NS_PER_S if sequence else 0)
        assert found.closed == ()
    assert watcher.last_event == EPOCH + 2 * NS_PER_S


def test_estimate_outside_the_kept_history_is_an_error() -> None:
    """Before the first event is received, and before the start of the past."""
    watcher = observer(TWO_MASS, "geometric", random_start(2, 1))
    with pytest.raises(UsageError, match=r"estimate at 5\.000000000 s"):
        watcher.estimate(EPOCH)
    watcher.receive(event(1.0, "stop", sequence=1))
    with pytest.raises(UsageError, match=r"the history starts at 5\.000000000 s"):
        watcher.estimate(EPOCH - 1)


def test_set_state_replaces_the_history() -> None:
    """From its stamp on; later events are applied, earlier ones are too late."""
    watcher = observer(TWO_MASS, "geometric", random_start(2, 1), epoch=EPOCH)
    watcher.receive(event(1.0, "stop", sequence=1))
    watcher.set_state(EPOCH + 2 * NS_PER_S, np.array([0.1, 0.2]), np.array([0.3, 0.4]))
    assert state(watcher, 2.0) == pytest.approx([0.1, 0.2, 0.3, 0.4], abs=1e-12)
    assert watcher.receive(event(1.5, "stop", sequence=2))[0].ruling is Ruling.TOO_LATE
    assert watcher.receive(event(2.5, "stop", sequence=3))[0].ruling is Ruling.APPLIED
    assert watcher.start == EPOCH + 2 * NS_PER_S
    with pytest.raises(UsageError, match="position"):
        watcher.set_state(EPOCH, np.zeros(1), np.zeros(2))


def test_state_given_before_any_event_is_the_initial_state() -> None:
    """It holds at the start, whatever stamp it is given for."""
    watcher = observer(TWO_MASS, "open-loop", random_start(2, 1))
    watcher.set_state(EPOCH + 99, np.array([0.1, 0.2]), np.array([0.3, 0.4]))
    watcher.receive(event(2.0, "stop", sequence=1))
    assert state(watcher, 0.0) == pytest.approx([0.1, 0.2, 0.3, 0.4], abs=1e-12)


def test_restart_clears_all_events() -> None:
    """The estimates are those of a new observer."""
    x = random_start(2, 1)
    used, fresh = (observer(TWO_MASS, "geometric", x, epoch=EPOCH) for _ in range(2))
    used.receive(event(5.0, "stop", sequence=4))
    used.restart()
    for watcher in (used, fresh):
        assert watcher.receive(event(1.0, "stop", sequence=1))[0].ruling is Ruling.APPLIED
    assert state(used, 3.0) == state(fresh, 3.0)
    assert used.missing == 0


@pytest.mark.parametrize("history", [0.0, -1.0, float("nan")])
def test_history_must_be_positive(history: float) -> None:
    """The error has the value."""
    with pytest.raises(UsageError, match="history"):
        observer(TWO_MASS, "geometric", np.zeros(4), history=history)


def test_initial_state_must_fit_the_system() -> None:
    """A state of another size is refused."""
    with pytest.raises(UsageError, match="velocity"):
        observer(TWO_MASS, "geometric", np.zeros(3))


def test_an_epoch_that_does_not_matter_changes_no_estimate() -> None:
    """The covariance of a system without time grows between events whose epoch is unknown, too."""
    truth, found = true_run("bouncing_ball", 3.0), []
    for epoch in (EPOCH, 0):
        watcher = observer(sample("bouncing_ball").system, "minimum-variance", [3.0, -1.0])
        for each in truth.events:
            watcher.receive(ImpactEvent(each.stamp, each.switches, each.sequence + 5, 0, epoch))
        found.append(estimates(watcher, truth.stamps[-3:]))
    np.testing.assert_allclose(found[0], found[1], atol=1e-9)
