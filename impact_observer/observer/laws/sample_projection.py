# SPDX-License-Identifier: Apache-2.0
"""The correction of a replica by a sample: a projection in the metric of V.

``x+ = x - alpha z (H x - y)``, where ``z`` minimises ``z^T P z`` subject to ``H z = 1``, ties
broken by the least ``z_q^T M z_q``, ``P = diag(K, M)``. It changes ``V`` of the difference from a
plant that has ``y = H x`` by exactly ``-alpha (1 - alpha/2) (H x - y)^2 z^T P z``.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy import linalg

from impact_observer.dynamics import KEPT
from impact_observer.events import Contacts
from impact_observer.model import System
from impact_observer.states import Matrix, Vector

_RIGID = 1e-12
"""``omega^2`` that counts as zero, relative to that of the stiffest mode."""
_NONE = 1e-9
"""Part of a measured function that counts as none."""


class SampleJump(NamedTuple):
    """How far a replica jumps by a unit of the measured function.

    Attributes:
        z: shape (2n,).
        energy: ``z^T P z``, twice the V that is removed, J.
    """

    z: Vector
    energy: float


class SampleProjection:
    """The jumps of replicas of one system by measured functions."""

    def __init__(self, system: System) -> None:
        """Prepare the modes of ``K`` with respect to ``M``."""
        self._system = system
        self._P = linalg.block_diag(system.K, system.M)
        self._held = lru_cache(KEPT)(self._modes_held)
        self._jumps = lru_cache(KEPT)(self._jump_by)

    def jump(self, h: Vector, held: Contacts) -> SampleJump | None:
        """The jump by a function of the state, shape (2n,), that keeps gaps of ``held`` contacts.

        None if no such jump changes the function.
        """
        return self._jumps(h.tobytes(), held)

    def _jump_by(self, function: bytes, held: Contacts) -> SampleJump | None:
        h, n, system = np.frombuffer(function), self._system.n, self._system
        rigid, elastic = self._held(held)
        speeds = linalg.solve(system.M, h[n:], assume_a="pos")
        by_rigid, by_elastic = rigid.T @ h[:n], elastic.T @ h[:n]
        whole = linalg.solve(system.M, h[:n], assume_a="pos")
        least = _NONE * float(np.sqrt(h[:n] @ whole))
        z = np.zeros(2 * n)
        if float(np.linalg.norm(by_rigid)) > least:
            z[:n] = rigid @ by_rigid / float(by_rigid @ by_rigid)
        else:
            weight = float(by_elastic @ by_elastic) + float(h[n:] @ speeds)
            if not weight > 0:
                return None
            z[:n], z[n:] = elastic @ by_elastic / weight, speeds / weight
        return SampleJump(z, float(z @ self._P @ z))

    def _modes_held(self, held: Contacts) -> tuple[Matrix, Matrix]:
        """Rigid and elastic modes of displacements that leave the gaps of contacts as they are.

        Elastic ones have unit energy ``q^T K q``, rigid ones unit mass.
        """
        system = self._system
        free = linalg.null_space(system.W[:, list(held)].T) if held else np.eye(system.n)
        K, M = free.T @ system.K @ free, free.T @ system.M @ free
        if not free.size:
            return free, free
        stiffness, shapes = linalg.eigh(K, M)
        scale = max(float(linalg.eigvalsh(system.K, system.M)[-1]), 0.0)
        elastic = stiffness > _RIGID * scale
        shapes = free @ shapes
        return shapes[:, ~elastic], shapes[:, elastic] / np.sqrt(stiffness[elastic])
