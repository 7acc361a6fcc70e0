"""Whether replicas that began apart have come together: convergence without ground truth.

Replicas under the same events approach each other, and the plant is like one of them. So their
largest mutual distance tells how far the estimate may be from the plant, and the estimate's own
gap at an impact, where the plant's is zero, how far it certainly was. Where events contradict what
was declared, agreement means nothing.
"""

from dataclasses import dataclass

import numpy as np

from impact_observer.dynamics import PositionProjection
from impact_observer.model import System
from impact_observer.observer.belief import Belief, Touch
from impact_observer.states import Matrix, Vector

HELD = 3
"""Events, one after the other, at which replicas must agree."""
AGREED = 1e-4
"""V distance that counts as agreement, relative to the energy of the estimated motion."""
SURPRISING = 6.0
"""Innovation, in standard deviations, that what was declared does not explain."""
_MARGIN = 2.0
"""V between plant and estimate that is reckoned with, over the largest between replicas."""
_RESTING = 1e-6
"""Energy below which a motion counts as rest, relative to the largest that it had."""
_PAIRS = 256
"""Most replicas of which every pair is looked at."""


@dataclass(frozen=True, slots=True)
class Agreement:
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


class Agreeing:
    """Judges the agreement of one system's replicas.

    Attributes:
        threshold: largest V distance that counts as agreement, relative to the motion's energy.
    """

    def __init__(self, system: System, threshold: float = AGREED) -> None:
        """Take the metric of ``V`` from ``system``."""
        self._system = system
        self._projection = PositionProjection(system)
        self.threshold = threshold

    def at_first(self, belief: Belief) -> Agreement:
        """The agreement before any event."""
        return Agreement(self._diameter(belief.replicas), self._energy(belief.x))

    def after(
        self, previous: Agreement, touch: Touch, before: Belief, belief: Belief
    ) -> Agreement:
        """The agreement after an event, between the beliefs ``before`` and after it."""
        convergence, energy = self._diameter(belief.replicas), self._energy(belief.x)
        largest = max(previous.largest, energy)
        energy = max(energy, _RESTING * largest)
        hit = bool(touch.hit) and belief.applied
        # With a covariance the innovation says it, and knows how far a stamp may be off.
        certain = self._certain(before.x, touch) if hit and belief.root is None else 0.0
        apart = max(_MARGIN * convergence, certain, self._expected(belief))
        surprised = max(belief.innovations.values(), default=0.0) > SURPRISING
        explained = not (belief.refuted or surprised)
        agrees = explained and convergence >= 0 and apart <= self.threshold * energy
        held = previous.held + hit
        return Agreement(convergence, energy, largest, held if agrees else 0)

    def allows(self, agreement: Agreement, root: Matrix) -> bool:
        """Whether a covariance ``root root^T`` is still small enough for an agreement."""
        return self._spread(root) <= self.threshold * agreement.energy

    def _energy(self, x: Vector) -> float:
        """Kinetic and elastic energy, J."""
        return float(self._energies(x[None])[0])

    def _energies(self, x: Matrix) -> Vector:
        """``1/2 x^T diag(K, M) x`` of each row, J."""
        return np.asarray(np.maximum(self._system.energy(*np.hsplit(x, 2)), 0.0))

    def _diameter(self, replicas: Matrix) -> float:
        """The largest V distance of two replicas, J; of very many an upper bound."""
        if len(replicas) < 2:
            return -1.0
        apart = replicas - replicas[0]
        if len(replicas) > _PAIRS:
            return 4 * float(np.max(self._energies(apart)))  # twice the radius, squared
        one, two = np.triu_indices(len(replicas), k=1)
        return float(np.max(self._energies(apart[one] - apart[two])))

    def _expected(self, belief: Belief) -> float:
        """``V`` to be expected from the covariance, J; 0 for a law that has none."""
        return 0.0 if belief.root is None else self._spread(belief.root)

    def _spread(self, root: Matrix) -> float:
        """``V`` to be expected of a covariance, J."""
        return float(np.sum(self._energies(root.T)))

    def _certain(self, x: Vector, touch: Touch) -> float:
        """What V was at least before an impact, J: the plant's gaps were zero there."""
        q = x[: self._system.n]
        jump = self._projection.position_after(q, touch.active) - q
        return float(jump @ self._system.K @ jump) / 2
