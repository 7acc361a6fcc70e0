# SPDX-License-Identifier: Apache-2.0
"""Gaps along many flights at once, against the states of each flight."""

from dataclasses import replace

import numpy as np
import pytest
from systems import Harmonic, chain, flow_of, forcing

from impact_observer.dynamics import LinearMechanism
from impact_observer.model import Forcing
from impact_observer.model.force_samples import Samples

TIMES = np.linspace(-0.5, 9.0, 41)
FORCES = {
    "none": forcing(3),
    "harmonic": forcing(3, [0.3, -0.2, 1], [Harmonic(2.5, [0, 4, 1], [1, 0, 2])]),
    "sampled": Forcing.of_samples(
        Samples(TIMES, np.random.default_rng(3).normal(size=(41, 3)), "linear")
    ),
    "stepped": Forcing.of_samples(
        Samples(TIMES, np.random.default_rng(4).normal(size=(41, 3)), "previous")
    ),
}
CONTACTS = [([0, 0, 1], 0.4, 0.6), ([1, -1, 0], 0.3, 0.5)]


@pytest.mark.parametrize("force", FORCES)
def test_gaps_and_rates_along_flights_are_those_of_their_states(force: str) -> None:
    """Flights from several instants, of several lengths, some from the same instant."""
    model = replace(chain(3, contacts=CONTACTS), forcing=FORCES[force])
    starts, lengths = [0.2, 1.7, 0.2, 3.1], np.array([0.6, 1.5, 0.05, 1.1])
    x = np.random.default_rng(5).normal(size=(4, 6))
    found = LinearMechanism(model).gaps_along(starts, x, lengths, ())
    for k, (begin, length) in enumerate(zip(starts, lengths, strict=True)):
        assert found.ends[0, k] == 0
        assert found.ends[-1, k] == pytest.approx(length)
        states = flow_of(model).start(begin, x[k]).states(found.ends[:, k])
        gaps, rates = states[:, :3] @ model.W + model.q_r, states[:, 3:] @ model.W
        inner = found.ends[:, k] < length  # the end of a flight is on a cubic
        np.testing.assert_allclose(found.g[inner, :, k], gaps[inner], atol=1e-9)
        np.testing.assert_allclose(found.v[inner, :, k], rates[inner], atol=1e-9)
        np.testing.assert_allclose(found.g[-1, :, k], gaps[-1], atol=1e-3)
