# SPDX-License-Identifier: Apache-2.0
"""A law whose state is a trace of all events so far, for tests of the timeline."""

from typing import ClassVar

import numpy as np
from systems import system

from impact_observer.dynamics import mechanism_of
from impact_observer.errors import ImpactLawError
from impact_observer.observer import Belief, Law
from impact_observer.observer.belief import Prediction
from impact_observer.observer.contact_change import ContactChange
from impact_observer.observer.synchronization import SynchronizationTest
from impact_observer.observer.timeline import Entry, Timeline
from impact_observer.states import Matrix, Vector

SYSTEM = system(1, 0, 1, contacts=[([-1], 1.0, 0.5), ([1], 1.0, 0.5)])


class TracingLaw(Law):
    """The position is a number in which each event leaves its trace; nothing moves.

    7 just after 5 fails, and 9 after some of the numbers.
    """

    name: ClassVar[str] = "tracing"

    def begin(self, replicas: Matrix, root: Matrix, closed: tuple[int, ...]) -> Belief:
        """The number that is given."""
        del root, closed
        return Belief.of(replicas)

    def correct(self, change: ContactChange, prior: Belief) -> Belief:
        """Another number; what is hit and closed leaves its trace, too."""
        before = int(prior.x[0])
        if (change.stamp == 7 and prior.x[1] == 5) or (change.stamp == 9 and before % 5 == 0):
            raise ImpactLawError("no solution")
        trace = hash((change.stamp, change.sequence, change.hit, change.closed)) % 97
        x = [float((31 * before + trace) % 1_000_003), float(change.stamp)]
        return Belief.of(np.array([x]))

    def predict(self, t: float, posterior: Belief, closed: tuple[int, ...]) -> Prediction:
        """The same number."""
        del t, closed
        return _Standing(posterior)


class _Standing(Prediction):
    """A belief that holds for good."""

    def __init__(self, belief: Belief) -> None:
        """As ``belief`` is."""
        self._belief = belief

    def state(self, s: float) -> Vector:
        """The same."""
        del s
        return self._belief.x

    def belief(self, s: float) -> Belief:
        """The same."""
        del s
        return self._belief


def traced(history: int = 1000) -> Timeline:
    """A timeline that has begun with the number 1 at stamp 0, with a ``history`` in ns."""
    timeline = Timeline(
        TracingLaw(SYSTEM), SynchronizationTest(SYSTEM, mechanism_of(SYSTEM)), history
    )
    timeline.begin(np.array([[1.0, 0.0]]), np.zeros((2, 2)), 0, 0)
    return timeline


def value(entry: Entry) -> int:
    """The number after an event."""
    return int(entry.belief.x[0])
