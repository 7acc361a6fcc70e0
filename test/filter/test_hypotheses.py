# SPDX-License-Identifier: Apache-2.0
"""Which of several hypotheses count."""

import numpy as np
import pytest
from scipy import linalg
from systems import chain

from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.hypotheses import Hypothesis, agreeing
from impact_observer.filter.tuning import TUNING


@pytest.mark.parametrize("seed", range(20))
def test_agreeing_hypotheses_are_the_nearest_that_hold_nearly_all_probability(seed: int) -> None:
    """By the expected V about the estimate, which is the first; that always counts."""
    rng, model = np.random.default_rng(seed), chain(2)
    metric, weights = linalg.block_diag(model.K, model.M), rng.dirichlet(0.5 * np.ones(7))
    made, distances = [], []
    for weight in weights:
        x, root = 10.0 ** rng.uniform(-3, 1) * rng.normal(size=(2, 4, 4))
        state = GaussianState.of(x[:1], root)
        made.append(Hypothesis(state, 0.0, float(np.log(weight))))
        difference = state.x - made[0].state.x
        second = root @ root.T + np.outer(difference, difference)
        distances.append(float(np.trace(metric @ second)))
    found = {id(h) for h in agreeing(made, model)}
    inside = [k for k, h in enumerate(made) if id(h) in found]
    outside = [k for k in range(7) if k not in inside]
    assert id(made[0]) in found
    assert weights[outside].sum() <= TUNING.disagreeing
    farthest = max(inside, key=lambda k: distances[k] if k else -1.0)
    assert weights[[*outside, farthest]].sum() > TUNING.disagreeing or farthest == 0
    assert max(distances[k] for k in inside if k) <= min(
        (distances[k] for k in outside), default=np.inf
    )
