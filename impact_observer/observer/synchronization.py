"""Whether replicas that began apart have come together: convergence without ground truth.

Replicas under the same events approach each other, and the plant is like one of them. So their
largest mutual distance tells how far the estimate may be from the plant, and the estimate's own
gap at an impact, where the plant's is zero, how far it certainly was. Where events contradict what
was declared, agreement means nothing.
"""

from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import linalg

from impact_observer.dynamics import PositionProjection
from impact_observer.estimation.contact_change import ContactChange
from impact_observer.estimation.ensemble import Ensemble
from impact_observer.model import System
from impact_observer.observer.belief import Belief
from impact_observer.states import Matrix, Vector

REQUIRED_EVENTS = 3
"""Events, one after the other, at which replicas must agree."""
AGREED = 1e-4
"""V distance that counts as agreement, relative to the energy of the estimated motion."""
LARGEST_INNOVATION = 6.0
"""Innovation, in standard deviations, that what was declared does not explain."""
_MARGIN = 2.0
"""V between plant and estimate that is reckoned with, over the largest between replicas."""
_RESTING = 1e-6
"""Energy below which a motion counts as rest, relative to the largest that it had."""
_PAIRS = 256
"""Most replicas of which every pair is looked at."""


class Synchronization(NamedTuple):
    """How well the replicas agree since an event.

    Attributes:
        convergence: largest V distance between replicas just after the event, J; it only falls
            until the next one. -1 while there is only one replica.
        energy: of the estimated motion then, kinetic and elastic, J; where it has come to rest, a
            millionth of the largest that it had at an event.
        largest: energy at an event so far, J.
        held: events in a row at which they agreed, this one the last.
    """

    convergence: float
    energy: float
    largest: float = 0.0
    held: int = 0


class SynchronizationTest:
    """Judges the agreement of one system's replicas.

    Attributes:
        threshold: largest V distance that counts as agreement, relative to the motion's energy.
    """

    def __init__(self, system: System, threshold: float = AGREED) -> None:
        """Take the metric of ``V`` from ``system``."""
        self._n = system.n
        self._metric = linalg.block_diag(system.K, system.M)
        self._projection = PositionProjection(system)
        self.threshold = threshold

    def at_first(self, belief: Belief) -> Synchronization:
        """The agreement before any event."""
        return Synchronization(*self._measured(belief.ensemble))

    def after(
        self, previous: Synchronization, change: ContactChange, before: Belief, belief: Belief
    ) -> Synchronization:
        """The agreement after an event, between the beliefs ``before`` and after it."""
        convergence, energy = self._measured(belief.ensemble)
        largest = max(previous.largest, energy)
        energy = max(energy, _RESTING * largest)  # NaN stays, standing first
        enough = self.threshold * energy
        if not (0 <= _MARGIN * convergence <= enough and self._explained(belief)):
            return Synchronization(convergence, energy, largest)
        hit = bool(change.hit) and belief.accepted
        # With a covariance the innovation says it, and knows how far a stamp may be off.
        certain = self._certain(before.x, change) if hit and belief.root is None else 0.0
        agrees = max(certain, self._expected(belief)) <= enough
        return Synchronization(convergence, energy, largest, previous.held + hit if agrees else 0)

    @staticmethod
    def _explained(belief: Belief) -> bool:
        """Whether what was declared explains the event."""
        if belief.inconsistent:
            return False
        return not belief.innovations or max(belief.innovations.values()) <= LARGEST_INNOVATION

    def allows(self, agreement: Synchronization, root: Matrix) -> bool:
        """Whether a covariance ``root root^T`` is still small enough for an agreement."""
        return self._spread(root) <= self.threshold * agreement.energy

    @cached_property
    def _lengths(self) -> Matrix:
        """Functions the sum of whose squares is ``x^T diag(K, M) x``, shape (2n, 2n)."""
        squares, axes = linalg.eigh(self._metric)
        return np.asarray((axes * np.sqrt(np.maximum(squares, 0.0))).T)

    def _measured(self, ensemble: Ensemble) -> tuple[float, float]:
        """The largest V distance of two replicas, of very many an upper bound, and energy, J."""
        x = ensemble.x
        energy = max(float(x.dot(self._metric.dot(x))), 0.0) / 2  # NaN stays, standing first
        if not ensemble.others:
            return -1.0, energy
        if ensemble.others >= _PAIRS:
            lengths = ensemble.seen(self._lengths)
            squares = np.einsum("ij,ij->j", lengths, lengths)
            return 2 * float(squares.max()), energy  # half of twice the radius, squared
        return ensemble.farthest(self._metric) / 2, energy

    def _expected(self, belief: Belief) -> float:
        """``V`` to be expected from the covariance, J; 0 for a law that has none."""
        return 0.0 if belief.root is None else self._spread(belief.root)

    def _spread(self, root: Matrix) -> float:
        """``V`` to be expected of a covariance, J."""
        return max(float(np.sum(root * (self._metric @ root))), 0.0) / 2

    def _certain(self, x: Vector, change: ContactChange) -> float:
        """What V was at least before an impact, J: the plant's gaps were zero there."""
        return self._projection.strain(x[: self._n], change.active)
