# SPDX-License-Identifier: Apache-2.0
"""A published observer of impact times: its published figures, and those of our laws.

P. Bernard and R. Sanfelice, on observers for hybrid systems with linear maps and known jump times
(2018 and later): a bouncing ball with drag, of which only the impacts are measured.
"""

from functools import cache
from typing import ClassVar

import numpy as np
import pytest
from numpy.typing import NDArray
from systems import EPOCH, forcing, run, system, without_faults

from impact_observer.model import System
from impact_observer.observer import Law, Observer, ReplicaLaw
from impact_observer.observer.laws.geometric import Geometric
from impact_observer.observer.laws.minimum_variance import MinimumVariance
from impact_observer.plant import Run

Array = NDArray[np.float64]

BALL = system(1, 0.1, 0, contacts=[([1], 0.0, 0.8)], force=forcing(1, -9.81))
"""``x'' = -9.81 - 0.1 x'``, restitution 0.8."""
JUMP = np.diag([-1.0, -0.8])
PUBLISHED_AFTER = (1, 4, 8, 12)


class HybridGain(ReplicaLaw):
    """``x+ = J x- + L (y - C x-)`` at a jump, where the measured height ``y`` is zero."""

    name: ClassVar[str] = "hybrid-gain"
    gain: ClassVar[Array] = np.array([-1.0, -0.1085])

    def impact(self, x: Array, active: tuple[int, ...], closed: tuple[int, ...]) -> Array:
        """Their law; there is one contact."""
        del active, closed
        return np.asarray(x @ JUMP.T + self.gain * (0.0 - x[..., :1]))


class PositionReset(HybridGain):
    """The same without the velocity's gain."""

    name: ClassVar[str] = "position-reset"
    gain: ClassVar[Array] = np.array([-1.0, 0.0])


@cache
def published_run() -> Run:
    """The ball from a height of 5 at rest, for twelve impacts and a little."""
    return run(BALL, [5.0], [0.0], seconds=9.5, rate=1.0)


def velocity_errors(law: type[Law], model: System = BALL) -> Array:
    """Estimate less truth just after each of twelve impacts; the estimate begins at (10, 2)."""
    watcher = Observer(
        model, law(model, without_faults()), np.array([10.0]), np.array([2.0]), epoch=EPOCH
    )
    found = []
    whole = published_run()
    for event, switching in list(zip(whole.events, whole.switchings, strict=True))[:12]:
        watcher.receive(event)
        found.append(float(watcher.estimate(event.stamp).u[0] - switching.after[1]))
    return np.array(found)


@pytest.mark.parametrize(
    ("law", "published"),
    [
        pytest.param(HybridGain, (-0.690, 0.139, 0.0347, 0.0118), marks=pytest.mark.slow),
        (PositionReset, (-1.444, 0.516, 0.173, 0.0654)),
    ],
    ids=["hybrid-gain", "position-reset"],
)
def test_published_errors_are_reproduced(
    law: type[Law], published: tuple[float, float, float, float]
) -> None:
    """After impacts 1, 4, 8 and 12, to the digits that are published."""
    found = velocity_errors(law)[np.array(PUBLISHED_AFTER) - 1]
    np.testing.assert_allclose(found, published, rtol=5e-3)


def test_geometric_law_is_the_position_reset() -> None:
    """With ``K = 0`` and one coordinate."""
    np.testing.assert_allclose(velocity_errors(Geometric), velocity_errors(PositionReset))


def test_minimum_variance_beats_the_published_gain() -> None:
    """Two impacts determine the state of a ball to the rounding of stamps."""
    ours, theirs = np.abs(velocity_errors(MinimumVariance)), np.abs(velocity_errors(HybridGain))
    assert np.all(ours[1:] < 1e-6 * theirs[1:])
    assert np.max(ours[1:]) < 1e-7
