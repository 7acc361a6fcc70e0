# SPDX-License-Identifier: Apache-2.0
"""The position jump of switched geometric constraints, for any ``K >= 0``.

``q+ = q- - Z g_A``: column ``i`` of ``Z`` minimises ``z^T K z`` subject to ``W_A^T z = e_i``, ties
broken by the least ``z^T M z``. For ``K > 0`` this is ``Z = K^-1 W_A L^-1``, the K-orthogonal
projection onto ``{g_A = 0}`` of Baumann and Leine (equation 5); for singular ``K`` it is our
extension to rigid-body modes.
"""

from functools import lru_cache

import numpy as np
from scipy import linalg

from impact_observer.dynamics.equations import Factor
from impact_observer.model import System
from impact_observer.states import Matrix, Vector, frozen

KEPT = 128
"""Sets of contacts whose matrices are cached: m contacts have 2^m sets."""
_RIGID = 1e-12
"""``omega^2`` that counts as zero, relative to the stiffest mode's."""
_RANK = 1e-10
"""Singular value that counts as zero, relative to the largest that contacts could have."""


_SPRUNG = 1e-8
"""Part of a gap that rigid motion leaves open and that counts as none."""
_WAY = 30.0
"""Ratio of the cost of the softest elastic motion to that of a rigid one, in root energy."""


class PositionProjection:
    """The position jumps of one system, with one matrix ``Z`` for each set of contacts."""

    def __init__(self, system: System, modes: tuple[Vector, Matrix] | None = None) -> None:
        """Prepare the modes of ``K`` with respect to ``M``.

        ``modes``, if available, are ``omega^2``, shape (n,), ascending, and shapes, (n, n).
        """
        self._system = system
        self._directions = system.W
        self._q_r = system.q_r
        stiffness, shapes = modes or linalg.eigh(system.K, system.M)
        elastic = stiffness > _RIGID * max(float(stiffness[-1]), 0.0)
        self._rigid = shapes[:, ~elastic]
        self._elastic = shapes[:, elastic] / np.sqrt(stiffness[elastic])
        self._softest = float(np.min(stiffness[elastic], initial=np.inf))
        self._inertia = Factor(system.M)
        self._jumps = lru_cache(KEPT)(self._solve)
        self.reactions = lru_cache(KEPT)(self._reactions_of)

    def jump(self, active: tuple[int, ...]) -> Matrix:
        """``Z``, the position jump per unit of gap, shape (n, len(active))."""
        return self._jumps(active)[0]

    def position_after(self, q: Vector, active: tuple[int, ...]) -> Vector:
        """``q+``, shape (..., n): the closest positions with ``g = 0`` on the active contacts."""
        Z, _, W, q_r = self._jumps(active)
        return np.asarray(q - ((q[..., None, :] @ W + q_r) @ Z.T)[..., 0, :])

    def strain(self, q: Vector, active: tuple[int, ...]) -> float:
        """Elastic energy of the jump from ``q``, shape (n,), J: ``1/2 g_A^T L^-1 g_A``."""
        _, elastic, W, q_r = self._jumps(active)
        stretch = elastic.dot(q.dot(W) + q_r)
        return float(stretch.dot(stretch)) / 2

    @property
    def is_rigid(self) -> bool:
        """Whether some motion has no elastic energy."""
        return bool(self._rigid.shape[1])

    def drift(self, q: Vector, active: tuple[int, ...]) -> float:
        """Half the square of the rigid part of the jump from ``q`` in ``M``, kg m^2."""
        Z, _, W, q_r = self._jumps(active)
        rigid = (Z @ (q.dot(W) + q_r)) @ self._system.M @ self._rigid
        return float(rigid.dot(rigid)) / 2

    def directions(self) -> Matrix:
        """``D`` of ``D^T D = W^T K^-1 W``, shape (n, m), rigid motions being cheap, not free."""
        rigid = _WAY / np.sqrt(self._softest) if np.isfinite(self._softest) else 1.0
        W = self._system.W
        return np.vstack([self._elastic.T @ W, rigid * (self._rigid.T @ W)])

    def _solve(self, active: tuple[int, ...]) -> tuple[Matrix, Matrix, Matrix, Vector]:
        """``Z``, its amplitudes of elastic modes in roots of J/m^2, ``W_A`` and ``q_r,A``."""
        elastic, rigid, _, _ = self._split(active)
        Z = frozen(self._elastic @ elastic + self._rigid @ rigid)
        return Z, frozen(elastic), self._directions[:, list(active)], self._q_r[list(active)]

    def _reactions_of(self, active: tuple[int, ...]) -> Matrix:
        """``R`` of ``sigma = -R g_A``, what the stops do in the jump, shape (|A|, |A|).

        ``K dq = W_A sigma``, so ``R = L^-1`` for ``K > 0``. A contact that rigid motions close
        without any spring has none; its row is that of the tie-break in ``M``, ``M dq = W_A
        sigma``: signs are those of ``K + delta M`` as ``delta`` vanishes.
        """
        elastic, rigid, inverse, beyond = self._split(active)
        sprung = np.linalg.norm(beyond, axis=1) > _SPRUNG
        return frozen(np.where(sprung[:, None], elastic.T @ elastic, inverse.T @ rigid))

    def _split(self, active: tuple[int, ...]) -> tuple[Matrix, Matrix, Matrix, Matrix]:
        """Amplitudes that close unit gaps: elastic modes close only what rigid modes cannot.

        Amplitudes of elastic modes, of rigid modes, and of rigid motion alone, each shape
        (modes, |A|), and the gaps that rigid motion cannot close, shape (|A|, |A|).
        """
        W = self._directions[:, list(active)]
        rigid, elastic = W.T @ self._rigid, W.T @ self._elastic
        # The shapes are M-orthonormal: no mode moves a gap by more than sqrt(w^T M^-1 w). Rigid
        # motion does not move the gap between two bodies; rounding there is not counted as rank.
        least = _RANK * float(np.linalg.norm(self._inertia.solved(W)))
        rigid_inverse = _inverse(rigid, least)
        beyond = np.eye(W.shape[1]) - rigid @ rigid_inverse
        elastic_part = _inverse(beyond @ elastic, least / np.sqrt(self._softest)) @ beyond
        rigid_part = rigid_inverse @ (np.eye(W.shape[1]) - elastic @ elastic_part)
        return elastic_part, rigid_part, rigid_inverse, beyond


def _inverse(gaps: Matrix, least: float) -> Matrix:
    """Pseudo-inverse of gaps per mode; singular values below ``least`` count as zero."""
    U, size, V = np.linalg.svd(gaps, full_matrices=False)
    inverse = np.divide(1.0, size, out=np.zeros(size.size), where=size > least)
    return np.asarray((V.T * inverse) @ U.T)
