"""Switched geometric unilateral constraints: the paper's contribution."""

from typing import ClassVar

import numpy as np

from impact_observer.dynamics import ImpactLaw, Motion, Phase
from impact_observer.events import Contacts
from impact_observer.model import System
from impact_observer.observer.laws.replica import ReplicaLaw
from impact_observer.observer.uncertainty import Uncertainty
from impact_observer.states import Matrix, Vector


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

    def impact(self, x: Vector, active: Contacts, closed: Contacts) -> Vector:
        """``q+`` by projection, ``u+`` by Newton's law."""
        n = self.system.n
        position = self._projection.position_after(x[:n], active)
        if closed != active:  # gaps that cannot all be zero are told: those that stay count
            position = self._projection.position_after(position, closed)
        return np.concatenate([position, self._newton.velocity_held(x[n:], active, closed)])

    def impacts(self, replicas: Matrix, active: Contacts, closed: Contacts) -> Matrix:
        """The same of many replicas."""
        n = self.system.n
        positions = self._projection.positions_after(replicas[:, :n], active)
        if closed != active:
            positions = self._projection.positions_after(positions, closed)
        velocities = self._newton.velocities_held(replicas[:, n:], active, closed)
        return np.hstack([positions, velocities])

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
        return float(jump @ self.system.K @ jump) / 2
