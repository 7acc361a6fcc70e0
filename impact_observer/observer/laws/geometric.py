# SPDX-License-Identifier: Apache-2.0
"""Switched geometric unilateral constraints: the contribution of the ENOC paper."""

from typing import ClassVar

import numpy as np

from impact_observer.dynamics import Motion, Phase
from impact_observer.events import Contacts
from impact_observer.observer.laws.replica_law import ReplicaLaw
from impact_observer.states import Vector


class Geometric(ReplicaLaw):
    """Positions jump too: onto ``g = 0`` of the closed contacts, as little as ``K`` allows.

    Baumann and Leine (ENOC 2014), equations (2) to (5): ``Sigma = -L^-1 g_A(q-)`` and
    ``q+ = q- + K^-1 W_A Sigma``, with Newton's impact law on the velocities. While ``chi`` stays
    1, ``sigma = -L^-1 gamma_A`` keeps ``g_A = 0`` (``dynamics.phase``). For singular ``K`` see
    ``dynamics.projection``.
    """

    name: ClassVar[str] = "geometric"

    def impact(self, x: Vector, active: Contacts, closed: Contacts) -> Vector:
        """``q+`` by projection, ``u+`` by Newton's law."""
        n, projection = self.system.n, self._clutches.phases.projection
        position = projection.position_after(x[..., :n], active)
        if closed and closed != active:  # if not all gaps can be zero, those of ``closed`` are
            position = projection.position_after(position, closed)
        velocity = self.newton.velocity_held(x[..., n:], active, closed)
        return np.concatenate([position, velocity], axis=-1)

    def motion(self, t: float, x: Vector, closed: Contacts) -> Motion:
        """Sprag clutches whose gaps stay closed."""
        return self._clutches.motion(t, x, closed, fix=True)

    def phase(self, closed: Contacts) -> Phase | None:
        """Free flight; None where clutches may slip, as they do at different times."""
        return None if closed else self._free

    def energy_removed(self, before: Vector, after: Vector, active: Contacts) -> float | None:
        """``1/2 g_A^T L^-1 g_A``, the energy of the position jump, where no impact raises V.

        The plant is on the stop, and the jump is the orthogonal projection onto it.
        """
        if active and not self.newton.is_nonexpansive(active):
            return None
        jump = (after - before)[: self.system.n]
        return float(jump.dot(self.system.K.dot(jump))) / 2
