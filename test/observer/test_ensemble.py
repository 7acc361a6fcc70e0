# SPDX-License-Identifier: Apache-2.0
"""Replicas that are propagated together: each as if it were propagated alone."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from systems import EPOCH, estimates, examples, observer, run, sample, systems, vectors

from impact_observer.dynamics import lyapunov
from impact_observer.observer import Belief
from impact_observer.observer.contact_change import ContactChange
from impact_observer.observer.laws.geometric import Geometric
from impact_observer.observer.uncertainty import spread


@pytest.mark.slow
@examples(30)
@given(st.data())
def test_replicas_that_separate_at_an_impact_keep_their_speed(data: st.DataObject) -> None:
    """Each jumps as it would alone: those that approach, those that do not, and the estimate."""
    model = data.draw(systems())
    replicas = np.array([data.draw(vectors(2 * model.n)) for _ in range(6)])
    change = ContactChange(0.0, (), (data.draw(st.integers(0, model.m - 1)),), ())
    law = Geometric(model)
    together = law.correct(change, Belief.of(replicas))
    alone = [law.correct(change, Belief.of(x[None])).x for x in replicas]
    np.testing.assert_array_equal(together.x, alone[0])
    size = 1 + max(np.max(np.abs(alone)), np.max(np.abs(replicas)))
    np.testing.assert_allclose(together.replicas, alone, rtol=0, atol=1e-10 * size)


def test_ten_thousand_replicas_come_together_as_a_few_do() -> None:
    """The bound on their distance holds for each of them, event after event, and falls."""
    model = sample("three_mass")
    truth = run(model.system, *model.initial_state(), seconds=20.0, rate=1.0)
    start = truth.states[0] + np.random.default_rng(3).normal(size=6)
    watcher = observer(model.system, "geometric", start, epoch=EPOCH, ensemble=10_000)
    root = watcher.law.uncertainty.root(3)
    few = spread(start, root, 10_000)[[0, 1, 77, 9_999]]
    alone = [observer(model.system, "geometric", x, epoch=EPOCH) for x in few]
    bounds = []
    for received in truth.events:
        for each in (watcher, *alone):
            each.receive(received)
        stamps = np.array([received.stamp + 1])
        one, *others = (estimates(each, stamps)[0] for each in alone)
        np.testing.assert_array_equal(estimates(watcher, stamps)[0], one)
        bounds.append(watcher.estimate(received.stamp + 1).convergence)
        largest = max(lyapunov.distance(model.system, *np.split(x - one, 2)) for x in others)
        assert largest <= bounds[-1] * (1 + 1e-6)
    assert np.all(np.diff(bounds) <= 1e-9 * bounds[0])
    assert bounds[-1] < 0.1 * bounds[0]
