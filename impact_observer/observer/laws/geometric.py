# SPDX-License-Identifier: Apache-2.0
"""Switched geometric unilateral constraints: the contribution of the ENOC paper."""

from functools import lru_cache
from typing import ClassVar

import numpy as np
from scipy import linalg

from impact_observer.dynamics import Motion, Phase
from impact_observer.dynamics.contact.projection import KEPT
from impact_observer.events import Contacts
from impact_observer.model import System
from impact_observer.observer.laws.replica_law import ReplicaLaw
from impact_observer.observer.uncertainty import Uncertainty
from impact_observer.states import Matrix, Vector

_MOST_LOST = np.array([np.inf, 0.0])
"""What an impact takes at most of gap and speed: any gap, no speed of separation."""


class Geometric(ReplicaLaw):
    """Positions jump too: onto ``g = 0`` of the closed contacts, as little as ``K`` allows.

    Baumann and Leine (ENOC 2014), equations (2) to (5): ``Sigma = -L^-1 g_A(q-)`` and
    ``q+ = q- + K^-1 W_A Sigma``, with Newton's impact law on the velocities. While ``chi`` stays
    1, ``sigma = -L^-1 gamma_A`` keeps ``g_A = 0`` (``dynamics.phase``). For singular ``K`` see
    ``dynamics.projection``.
    """

    name: ClassVar[str] = "geometric"

    def __init__(self, system: System, uncertainty: Uncertainty | None = None) -> None:
        """Prepare the projection."""
        super().__init__(system, uncertainty)
        self._projection = self._clutches.phases.projection
        self._single = lru_cache(KEPT)(self._single_of)

    def impact(self, x: Vector, active: Contacts, closed: Contacts) -> Vector:
        """``q+`` by projection, ``u+`` by Newton's law."""
        if self._is_single(active, closed):
            return self._after_one(active[0], x)
        n = self.system.n
        position = self._projection.position_after(x[..., :n], active)
        if closed and closed != active:  # if not all gaps can be zero, those of ``closed`` are
            position = self._projection.position_after(position, closed)
        velocity = self.newton.velocity_held(x[..., n:], active, closed)
        return np.concatenate([position, velocity], axis=-1)

    def _is_single(self, active: Contacts, closed: Contacts) -> bool:
        """Whether one contact with a constant coefficient impacts, and none is closed after."""
        return len(active) == 1 and not closed and self.system.is_plain(active)

    def _jump(self, contact: int) -> tuple[Vector, Vector, Vector]:
        """Direction, position jump by a unit gap and kick of a contact, shape (n,) each."""
        z = self._projection.jump((contact,))[:, 0]
        return self.system.W[:, contact], z, self.newton.kick(contact)

    def _after_one(self, contact: int, x: Vector) -> Vector:
        """Replicas, shape (..., 2n), after the impact of one contact."""
        rows, offset, jumps = self._single(contact)
        lost = np.minimum(x[..., None, :] @ rows + offset, _MOST_LOST)  # (..., 1, 2)
        return np.asarray(x - (lost @ jumps)[..., 0, :])

    def _single_of(self, contact: int) -> tuple[Matrix, Vector, Matrix]:
        """Gap and speed as functions of a state, (2n, 2) and (2,); their jumps, (2, 2n)."""
        w, z, kick = self._jump(contact)
        offset = np.array([self.system.q_r[contact], 0.0])
        return linalg.block_diag(w, w).T, offset, linalg.block_diag(z, kick)

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
        if len(active) == 1 and self.system.is_plain(active):
            return self._projection.strain(before[: self.system.n], active)
        return self.energy_of_jump(before, after, active)

    def energy_of_jump(self, before: Vector, after: Vector, active: Contacts) -> float | None:
        """The energy of any position jump, J; None where an impact may raise V."""
        if active and not self.newton.is_nonexpansive(active):
            return None
        jump = (after - before)[: self.system.n]
        return float(jump.dot(self.system.K.dot(jump))) / 2
