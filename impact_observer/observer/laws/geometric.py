"""Switched geometric unilateral constraints: the paper's contribution."""

from functools import cache
from typing import ClassVar, NamedTuple

import numpy as np
from scipy import linalg

from impact_observer.dynamics import ImpactLaw, Motion, Phase
from impact_observer.events import Contacts
from impact_observer.model import System
from impact_observer.observer.ensemble import Ensemble
from impact_observer.observer.laws.replica import ReplicaLaw
from impact_observer.observer.uncertainty import Uncertainty
from impact_observer.states import Matrix, Vector


class _Jump(NamedTuple):
    """What happens to differences of replicas at one contact.

    Attributes:
        map: of those that approach, shape (2n, 2n).
        gamma: contact speed of a state, shape (1, 2n).
        kick: velocity that is lost per speed of approach, shape (n,).
    """

    map: Matrix
    gamma: Matrix
    kick: Vector


class Geometric(ReplicaLaw):
    """Positions jump too: onto ``g = 0`` of the closed contacts, as little as ``K`` allows.

    Baumann and Leine (ENOC 2014), equations (2) to (5): ``Sigma = -L^-1 g_A(q-)`` and
    ``q+ = q- + K^-1 W_A Sigma``, with Newton's impact law on the velocities. While ``chi`` stays
    1, ``sigma = -L^-1 gamma_A`` keeps ``g_A = 0`` (``dynamics.phase``). For singular ``K`` see
    ``dynamics.projection``.
    """

    name: ClassVar[str] = "geometric"

    def __init__(self, system: System, uncertainty: Uncertainty | None = None) -> None:
        """Prepare Newton's law and the projection."""
        super().__init__(system, uncertainty)
        self._newton = ImpactLaw(system)
        self._projection = self._clutches.phases.projection
        self._jump = cache(self._jump_of)

    def _jump_of(self, contact: int) -> _Jump:
        """The jump at one contact that approaches."""
        n, w = self.system.n, self.system.W[:, contact]
        kick = self._newton.kick(contact)
        P = np.eye(n) - np.outer(self._projection.jump((contact,)), w)
        J = np.eye(n) - np.outer(kick, w)
        gamma = np.concatenate([np.zeros(n), w])[None]
        return _Jump(linalg.block_diag(P, J), gamma, kick)

    def impact(self, x: Vector, active: Contacts, closed: Contacts) -> Vector:
        """``q+`` by projection, ``u+`` by Newton's law."""
        n = self.system.n
        position = self._projection.position_after(x[:n], active)
        if closed and closed != active:  # all cannot be zero: those that stay count
            position = self._projection.position_after(position, closed)
        return np.concatenate([position, self._newton.velocity_held(x[n:], active, closed)])

    def impacts(self, replicas: Matrix, active: Contacts, closed: Contacts) -> Matrix:
        """The same of many replicas."""
        n = self.system.n
        positions = self._projection.positions_after(replicas[:, :n], active)
        if closed and closed != active:
            positions = self._projection.positions_after(positions, closed)
        velocities = self._newton.velocities_held(replicas[:, n:], active, closed)
        return np.concatenate([positions, velocities], axis=1)

    def struck(self, before: Ensemble, x: Vector, active: Contacts, closed: Contacts) -> Ensemble:
        """At a single contact one map acts on all that approach; the others keep their speeds."""
        if len(active) > 1 or closed:
            return super().struck(before, x, active, closed)
        jump = self._jump(active[0])
        gamma = float(jump.gamma[0].dot(before.x))
        speeds = before.seen(jump.gamma)[0]
        if gamma <= 0 and speeds.max() <= -gamma:
            return before.carried(x, jump.map)
        apart = before.seen(jump.map)
        kept = np.maximum(speeds + gamma, 0.0) - max(gamma, 0.0)
        apart[self.system.n :] += jump.kick[:, None] * kept
        return Ensemble(x, apart)

    def motion(self, t: float, x: Vector, closed: Contacts) -> Motion:
        """Sprag clutches whose gaps stay closed."""
        return self._clutches.motion(t, x, closed, fix=True)

    def phase(self, closed: Contacts) -> Phase | None:
        """Free flight; clutches of different replicas hold and slip at different times."""
        return None if closed else self._clutches.phases.phase()

    def taken(self, before: Vector, after: Vector, active: Contacts) -> float | None:
        """``1/2 g_A^T L^-1 g_A``, the energy of the position jump, where no impact raises V.

        The plant is on the stop, so its distance from the replica loses what the jump measures.
        """
        if active and not self._newton.is_nonexpansive(active):
            return None
        jump = after[: self.system.n] - before[: self.system.n]
        return float(jump.dot(self.system.K.dot(jump))) / 2
