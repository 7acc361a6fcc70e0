# SPDX-License-Identifier: Apache-2.0
"""The filter bank: weights, the covariance of the mixture, events in any order."""

import math
from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats
from systems import (
    EPOCH,
    chain,
    run,
    sample,
)

from impact_observer.events import ImpactEvent, Kind
from impact_observer.filter.branching import Extent
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.filter_bank import FilterBank
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.hypotheses import Hypothesis, Jump, published
from impact_observer.filter.impact_filter import ImpactFilter
from impact_observer.filter.ledger import Ledger
from impact_observer.filter.model_error import NO_ERROR, ErrorKind, LearnedError
from impact_observer.filter.uncertainty import Uncertainty
from impact_observer.model import System
from impact_observer.observer import Belief, Observer
from impact_observer.plant import Run
from impact_observer.stamps import NS_PER_S, Elapsed, seconds_between

Array = NDArray[np.float64]
FAULTY = Uncertainty(clock_error=0.0, model_error=0.0)


@cache
def truth(name: str, seconds: float) -> tuple[System, Array, Run]:
    """A sample, where its plant starts, and what it does."""
    model = sample(name)
    start = model.initial_state()
    whole = run(model.system, *start, seconds=seconds, rate=10.0)
    return model.system, np.concatenate(start), whole


def beliefs(watcher: Observer) -> list[Belief]:
    """After every event."""
    assert watcher.timeline is not None
    return [entry.belief for entry in watcher.timeline.entries]


def mixture(belief: Belief) -> Array:
    """Second moments of the published hypotheses about the estimate."""
    size = belief.x.size
    P = np.zeros((size, size))
    shown = published(belief.hypotheses, misfit=False)
    total = sum(math.exp(each.weight) for each in shown)
    for each in shown:
        differences, root = each.state.x - belief.x, each.state.root[:size]
        P += math.exp(each.weight) / total * (root @ root.T + np.outer(differences, differences))
    return P


@pytest.mark.parametrize(("penetrated", "leads"), [(0, True), (1, False)])
def test_contact_of_the_event_does_not_count_as_penetrated(penetrated: int, leads: bool) -> None:
    """A late event has alternatives under the likeliest account, which penetrates its contact."""
    model = chain(1, contacts=[([1], 0.1, 0.5), ([-1], 0.3, 0.5)])
    clocks = (1e-9, 1e-7)
    bank = FilterBank(ImpactFilter(model), Uncertainty(model_error=0.0), clocks)
    x = np.array([[-0.1 - 4e-10, -1.0]])
    state = GaussianState.of(x, 1e-12 * np.eye(2))
    best = Hypothesis(state, clocks[0], -50.0, survival={penetrated: -50.0})
    other = Hypothesis(GaussianState.of(x, 1e-3 * np.eye(2)), clocks[0], -10.0)
    change = ContactChange.of(1.0, (), [(0, Kind.IMPACT)])
    found = bank.update(change, [best, other], lambda: (), Extent(np.ones(2), np.ones(2)))
    of_best = [h for h in found if np.linalg.norm(h.state.root[1]) < 1e-6]
    assert {h.clock for h in of_best} == ({*clocks} if leads else set())


def test_a_negative_gap_counts_once_however_often_other_contacts_hit() -> None:
    """And not at all where its own contact hits: then the gap was no error."""
    state = GaussianState.of(np.zeros((1, 2)), np.eye(2))
    h = Hypothesis(state, 1e-9, -3.0, survival={1: -2.0})
    assert h.weight_without((0,)) == -3.0
    assert h.weight_without((1,)) == -1.0
    assert h.survival_without((0,)) == {1: -2.0}
    assert not h.survival_without((1,))


def test_a_gap_that_stays_negative_has_the_least_survival_so_far() -> None:
    """The oracle is the normal distribution of the gap where it is deepest, before any event.

    A gap that rises, with no event that explains the negative gap, keeps the least probability.
    """
    model = chain(1, stiffness=0.0, damping=0.0, contacts=[([1], 0.0, 0.5)])
    declared = Uncertainty(model_error=0.0, missed=0.0)
    bank = FilterBank(ImpactFilter(model), declared, (1e-9,))
    root = np.diag([1e-3, 0.0])
    falling = GaussianState.of(np.array([[0.0, -1e-3]]), root)
    (one,) = bank.between.predict([Hypothesis(falling, 1e-9)], 0.0, 1.0)
    (two,) = bank.between.predict([one], 1.0, 1.0)
    (rising,) = bank.between.predict(
        [two._replace(state=two.state._replace(x=two.state.x * [1.0, -1.0]))], 2.0, 1.0
    )
    for h, depth in ((one, 1.0), (two, 2.0), (rising, 2.0)):
        assert h.weight == pytest.approx(stats.norm.logcdf(-depth), rel=1e-6)
        assert h.survival == ({} if h is rising else {0: pytest.approx(h.weight)})


def test_error_of_the_model_counts_for_24_events_but_not_among_the_first_12() -> None:
    """While the state is not known, an error only says so."""
    state = GaussianState(np.zeros(2), np.zeros(0), np.eye(2), np.zeros((2, 0)))

    def is_exact(events: int, last_error: int, level: float = 0.0) -> bool:
        error = LearnedError(ErrorKind.ACCELERATION, level) if level else NO_ERROR
        ledger = Ledger(events=events, last_error=last_error)
        return Hypothesis(state, 1e-9, error=error, ledger=ledger).is_exact

    assert [is_exact(events, 5) for events in (6, 11, 12, 40)] == [False, False, True, True]
    assert [is_exact(events, 13) for events in (13, 36, 37)] == [False, False, True]
    assert is_exact(3, 0)
    assert not is_exact(40, 40, 1e-3)


@pytest.mark.parametrize(("clock", "ways"), [(1e-5, 1), (1e-7, 2)])
def test_impact_within_the_error_of_a_stamp_is_left_to_the_next_flight(
    clock: float, ways: int
) -> None:
    """A stop was reached 1e-6 s before an event: missed, or not yet reached then."""
    model = chain(1, stiffness=0.0, damping=0.0, contacts=[([1], 0.0, 0.5)])
    bank = FilterBank(ImpactFilter(model), Uncertainty(model_error=0.0), (clock,))
    state = GaussianState.of(np.array([[1.0, -1.0]]), 1e-9 * np.eye(2))
    found = bank.between.predict([Hypothesis(state, clock)], 0.0, 1.0 + 1e-6)
    assert len(found) == ways
    waiting = [h for h in found if not h.ledger.missed]
    assert [bool(h.survival) for h in waiting] == [ways == 2]
    (later,) = bank.between.predict([waiting[0]], 1.0 + 1e-6, 0.5)[:1]
    assert [each.kind for each in later.ledger.missed] == [Kind.IMPACT]
    np.testing.assert_allclose(later.state.x, [0.25, 0.5], atol=1e-5)


def by_hand(model: System, x: Array, events: Sequence[ImpactEvent], end: int) -> tuple[Array, ...]:
    """State and root by ``ImpactFilter`` alone, at the stamp ``end``."""
    filter_, index = ImpactFilter(model), model.contact_names.index
    state = filter_.begin(GaussianState.of(x[None], np.eye(x.size)))
    since = EPOCH
    for each in events:
        before = filter_.predict(Elapsed(since - EPOCH), state)
        s = seconds_between(since, each.stamp)
        state = before.prior(s)
        switches = [(index(switch.contact), switch.kind) for switch in each.switches]
        t = Elapsed(each.stamp - EPOCH)
        change = ContactChange.of(t, state.closed, switches, flown=s)
        state, since = (
            filter_.conditioning.posterior(change, state, 1e-9 / math.sqrt(12)),
            each.stamp,
        )
    prediction = filter_.predict(Elapsed(since - EPOCH), state)
    s = seconds_between(since, end)
    return prediction.state(s), prediction.root(s)


def checked(watcher: Observer, stamp: int) -> None:
    """Nothing is NaN."""
    for now in (watcher.estimate(stamp), watcher.estimate(stamp + 3 * NS_PER_S)):
        assert np.all(np.isfinite(np.concatenate([now.q, now.u, now.covariance.ravel()])))
        assert np.all(np.isfinite([each[1:] for each in now.parameters]))


def test_a_negative_gap_is_explained_by_its_event_after_flights_of_any_length() -> None:
    """A flight that is shorter than the error of a stamp keeps the survival, and its refund."""
    model = chain(1, stiffness=0.0, damping=0.0, contacts=[([1], 0.0, 0.5), ([-1], 9.0, 0.5)])
    bank, clock = FilterBank(ImpactFilter(model), Uncertainty(model_error=0.0), (1e-3,)), 1e-3
    deep = GaussianState.of(np.array([[-1e-2, -1.0]]), 1e-3 * np.eye(2))
    begun = Hypothesis(deep, clock, -20.0, survival={0: -20.0})
    found = bank.between.predict([begun], 0.0, 2e-3)
    (kept,) = (h for h in found if not h.ledger.missed)
    assert kept.survival[0] <= -20.0
    assert kept.weight_without((0,)) == pytest.approx(0.0)


def test_a_missed_impact_begins_a_new_flight() -> None:
    """Also where no error of the model is learned: bounces are judged by the flight before."""
    model = chain(1, stiffness=0.0, damping=0.0, contacts=[([1], 0.0, 0.5)])
    bank = FilterBank(ImpactFilter(model), Uncertainty(model_error=0.0), (1e-9,))
    state = GaussianState.of(np.array([[0.97, -1.0]]), 1e-9 * np.eye(2))
    begun = Hypothesis(state, 1e-9, jump=Jump(0.9))
    found = bank.between.predict([begun], 0.0, 1.5)
    (after,) = (h for h in found if h.ledger.missed)
    assert after.jump.ago == pytest.approx(0.53, abs=1e-6)
