# SPDX-License-Identifier: Apache-2.0
"""Estimates of many stamps at once are those of each stamp, in every bit."""

import numpy as np
import pytest
from numpy.typing import NDArray
from systems import EPOCH, observer, run, sample, without_faults

from impact_observer.errors import UsageError
from impact_observer.observer import Observer
from impact_observer.observer.laws import BUILT_IN
from impact_observer.stamps import NS_PER_S, grid
from impact_observer.states import Estimate


def bits(estimate: Estimate) -> tuple[object, ...]:
    """All fields of an estimate, floats by their bits."""
    arrays = (estimate.q, estimate.u, estimate.covariance)
    others = (estimate.stamp, estimate.law, estimate.closed, estimate.convergence)
    more = (estimate.synchronized, estimate.bound, estimate.inconsistent, estimate.parameters)
    last = (estimate.clock_offset, estimate.last_sequence, estimate.last_event)
    return (*(each.tobytes() for each in arrays), *others, *more, *last)


def checked(watcher: Observer, stamps: NDArray[np.int64]) -> list[int]:
    """Compare what is made together with what is made alone; how many were together."""
    batches = list(watcher.estimates(stamps))
    found = [bits(each) for together in batches for each in together]
    assert found == [bits(watcher.estimate(stamp)) for stamp in stamps.tolist()]
    for together in batches:
        assert together.stamps.size == len(together.x)
        last = together.part(len(together.x) - 1, len(together.x))
        assert bits(last.first) == bits(watcher.estimate(int(last.stamps[0])))
    return [each.stamps.size for each in batches]


@pytest.mark.parametrize("law", BUILT_IN)
def test_estimates_are_those_of_each_stamp_alone(law: str) -> None:
    """Between events, at their stamps, and at the earliest stamp with an estimate."""
    model = sample("three_mass")
    truth = run(model.system, *model.initial_state(), seconds=3.0)
    start = [0.2, -0.1, 0.1, 0.3, 0.0, -0.2]
    watcher = observer(model.system, law, start, epoch=EPOCH, uncertainty=without_faults())
    for each in truth.events:
        watcher.receive(each)
    own = [each.stamp for each in truth.events]
    stamps = np.unique([*grid(EPOCH, EPOCH + 3 * NS_PER_S, 200.0).tolist(), *own])
    together = checked(watcher, stamps)
    assert sum(together) == stamps.size
    states = list(watcher.estimates(stamps, replicas=True))
    alone = [np.concatenate([each.q, each.u]) for each in map(watcher.estimate, stamps.tolist())]
    np.testing.assert_array_equal(np.concatenate([each.x for each in states]), alone)
    assert max(each.stamps.size for each in states) > 10
    assert law == "minimum-variance" or max(together) > 10
    assert checked(watcher, np.repeat(stamps[:9], 2))


@pytest.mark.parametrize("law", ["open-loop", "kinematic", "geometric", "unilateral"])
@pytest.mark.parametrize("name", ["three_mass", "bouncing_ball"])
def test_replicas_together_are_those_that_run_alone(name: str, law: str) -> None:
    """From several starts, at all samples, in flights and while a contact stays closed."""
    model = sample(name)
    truth = run(model.system, *model.initial_state(), seconds=5.0)
    starts = np.random.default_rng(3).normal(size=(4, 2 * model.system.n))
    stamps = grid(EPOCH, EPOCH + 5 * NS_PER_S, 50.0)

    def observed(replicas: NDArray[np.float64]) -> NDArray[np.float64]:
        watcher = observer(model.system, law, replicas[0], epoch=EPOCH)
        watcher.start_from(replicas)
        for each in truth.events:
            watcher.receive(each)
        parts = [each.replicas for each in watcher.estimates(stamps, replicas=True)]
        return np.concatenate([each for each in parts if each is not None], axis=1)

    together = observed(starts)
    assert together.shape == (4, stamps.size, 2 * model.system.n)
    for k, start in enumerate(starts):
        np.testing.assert_allclose(together[k], observed(start[None])[0], rtol=0, atol=1e-9)


def test_estimates_before_the_kept_history_are_refused() -> None:
    """With the error of a single estimate."""
    watcher = observer(sample("two_mass").system, "geometric", [0.0] * 4, epoch=EPOCH)
    with pytest.raises(UsageError, match="the history starts at 5"):
        list(watcher.estimates(np.array([EPOCH - 1, EPOCH])))
    assert list(watcher.estimates(np.empty(0, dtype=np.int64))) == []
