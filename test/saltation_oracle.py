# SPDX-License-Identifier: Apache-2.0
"""An oracle of the saltation matrix: finite differences of exact motions through an impact."""

import numpy as np
from numpy.typing import NDArray

from impact_observer.dynamics import ImpactLaw
from impact_observer.filter.impact_filter import ImpactFilter
from impact_observer.model import System

Array = NDArray[np.float64]


def saltation_error(model: System, rng: np.random.Generator) -> float:
    """Largest error of the filter's saltation matrix against the map at the own root of the gap.

    The system has two coordinates; its contact is hit by the second one. The state is random.
    """
    filter_, law, n, h = ImpactFilter(model), ImpactLaw(model), 2, 1e-6
    member, phase = filter_.members.given, filter_.members.given.moving.phases.phase()
    x = np.array([rng.normal(), 0.3, rng.normal(), rng.uniform(0.5, 3.0)])
    w = model.W[:, 0]

    def own_root(y: Array) -> Array:
        s, now = 0.0, y
        for _ in range(6):
            now = phase.moved(0.0, y, s)[0]
            s -= float((w @ now[:n] + model.q_r[0]) / (w @ now[n:]))
        now = np.concatenate([now[:n], law.velocity_after(now[n:], (0,))])
        return np.asarray(phase.moved(s, now, -s)[0])

    rates = member.moving.rates_at(0.0, x, ())
    found = member.mirror_about(x, (0,)).expanded(rates, rates, x, member.moving.forces(0.0))
    np.testing.assert_allclose(found.value, own_root(x), atol=1e-13)
    grad = np.concatenate([w, np.zeros(n)])
    Xi = found.H[:, 1:] + np.outer(found.H[:, 0], grad) / float(w @ x[n:])
    differences = [(own_root(x + h * dx) - own_root(x - h * dx)) / (2 * h) for dx in np.eye(2 * n)]
    return float(np.abs(Xi.T - np.array(differences)).max())
