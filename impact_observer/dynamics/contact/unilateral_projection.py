# SPDX-License-Identifier: Apache-2.0
"""The projection of a position onto closed gaps that leaves no other gap negative."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy import linalg

from impact_observer.dynamics.contact.complementarity import complementary
from impact_observer.dynamics.contact.projection import KEPT
from impact_observer.dynamics.phase import Phases
from impact_observer.states import Matrix, Vector, frozen

_NEGATIVE = 1e-13
"""Gap below zero that is rounding, relative to the terms of its sum."""
_IMPOSSIBLE = 1e-7
"""Gap that no projection can have left by rounding, relative to the terms of its sum."""
_TINY = np.finfo(np.float64).tiny


class _Support(NamedTuple):
    """Which contacts stop their gaps, as indices.

    Attributes:
        pressed: contacts that take a reaction.
        undecided: contacts whose reaction and rate are both zero.
        stopping: contacts that must be stopped, pressed or not.
    """

    pressed: tuple[int, ...]
    undecided: tuple[int, ...]
    stopping: tuple[int, ...]


class UnilateralProjection:
    """The nearest position, in the metric of ``K``, with ``g_A = 0`` and no gap negative.

    A quadratic programme: ``complementarity.py`` finds which gaps are zero in its solution, and
    ``projection.py`` closes them.
    """

    def __init__(self, phases: Phases) -> None:
        """Prepare the contacts' directions in the metric of ``K``."""
        self._system = phases.system
        self._phases = phases
        self._projection = phases.projection
        self._directions = phases.projection.directions()
        self._independent = lru_cache(KEPT)(self._independent_of)
        self.is_possible = lru_cache(KEPT)(self._is_possible)

    def rounding(self, q: Vector) -> Vector:
        """Scale of the rounding of gaps at positions as large as ``q``, m, shape (m,)."""
        return np.asarray(np.abs(self._system.q_r) + np.abs(q) @ np.abs(self._system.W))

    def position_after(self, q: Vector, active: tuple[int, ...]) -> Vector:
        """``q+``, shape (..., n): ``g = 0`` on the ``active`` contacts and no gap negative.

        Without such a position no plant can have this ``chi``: then only ``g = 0`` on ``active``
        holds, and other gaps may be negative.
        """
        if q.ndim > 1:
            return np.asarray(np.apply_along_axis(self.position_after, -1, q, active))
        after = self._projection.position_after(q, active)
        # One coordinate is rounded against the others that move with it.
        reach = np.full(q.size, np.max(np.abs(q) + np.abs(after)))
        gap, least = self._system.gap(after), _NEGATIVE * self.rounding(reach)
        others = tuple(i for i in range(self._system.m) if i not in active)
        if np.all(gap[list(others)] >= -least[list(others)]) or not self.is_possible(active):
            return after
        gaps = self._system.gap(q)
        support = self.support(gaps, least, active, others)
        if support is None:  # contacts that are almost the same: by exchanges only
            free, _ = self._independent(active, others)
            support = self._checked(gaps, least, active, (), free)
        return self._projection.position_after(q, (*active, *support.stopping))

    def _is_possible(self, active: tuple[int, ...]) -> bool:
        """Whether some position has ``g = 0`` on ``active`` and no gap negative."""
        q_r, A = self._system.q_r, list(active)
        others = tuple(i for i in range(self._system.m) if i not in active)
        least = np.full(q_r.size, _IMPOSSIBLE * float(np.max(np.abs(q_r), initial=0.0)))
        left = q_r - self._system.W.T @ (self._projection.jump(active) @ q_r[A])
        if np.any(np.abs(left[A]) > least[A]):
            return False
        return bool(self.support(q_r, least, active, others) is not None)

    def support(
        self,
        values: Vector,
        rounding: Vector,
        active: tuple[int, ...],
        others: tuple[int, ...],
    ) -> _Support | None:
        """Which of ``others`` must be stopped so that no value becomes negative.

        Args:
            values: gaps, or their rates or higher derivatives, without any stop, shape (m,).
            rounding: of each that counts as none, shape (m,).
            active: indices of contacts whose values become zero whatever they are.
            others: indices of those whose values become zero or positive.

        Returns:
            None if some value becomes negative whatever is stopped.
        """
        free, directions = self._independent(active, others)
        A, contacts = list(active), list(free)
        W = self._system.W
        left = values - W.T @ (self._projection.jump(active) @ values[A]) if A else values
        fixed = [i for i in others if i not in free]
        if np.any(left[fixed] < -1e3 * rounding[fixed]):
            return None
        pressed: tuple[int, ...] = ()
        if np.any(left[contacts] < -rounding[contacts]):
            reactions = complementary(directions, left[contacts])
            if reactions is None:
                return None
            pressed = tuple(i for i, r in zip(free, reactions, strict=True) if r > 0)
        return self._checked(values, rounding, active, pressed, free)

    def _independent_of(
        self, active: tuple[int, ...], others: tuple[int, ...]
    ) -> tuple[tuple[int, ...], Matrix]:
        """The contacts of ``others`` that are independent of ``active``, and their directions.

        A direction, one a column, is the part that is orthogonal to the active ones in the metric
        of the position jump, shape (n, contacts).
        """
        D = self._directions
        basis = linalg.qr(D[:, list(self._phases.independent(active))], mode="economic")[0]
        contacts = [i for i in others if self._phases.independent((i,), active)]
        directions = D[:, contacts] - basis @ (basis.T @ D[:, contacts])
        directions -= basis @ (basis.T @ directions)
        return tuple(contacts), frozen(directions)

    def _checked(
        self,
        values: Vector,
        rounding: Vector,
        active: tuple[int, ...],
        pressed: tuple[int, ...],
        free: tuple[int, ...],
    ) -> _Support:
        """The support from the exact projection, by exchanges of contacts where necessary.

        Exchanges are necessary where ``K`` is singular and a rigid motion is almost balanced.
        """
        projection, W = self._projection, self._system.W
        a, first = len(active), pressed
        for _ in range(2 * len(free) + 1):
            fixed = [*active, *pressed]
            R = projection.reactions(tuple(fixed))
            reactions = -(R @ values[fixed])[a:]
            noise = (np.abs(R) @ rounding[fixed])[a:]
            left = values - W.T @ (projection.jump(tuple(fixed)) @ values[fixed])
            low = [
                i
                for i in free
                if i not in pressed and self._phases.independent((i,), (*active, *pressed))
            ]
            pulled, missed = reactions + noise, (left + rounding)[low]
            if np.any(pulled < 0):
                pressed = tuple(np.delete(pressed, np.argmin(pulled / (noise + _TINY))).tolist())
            elif np.any(missed < 0):
                worst = low[int(np.argmin(missed / (rounding[low] + _TINY)))]
                pressed = tuple(sorted((*pressed, worst)))
            else:
                idle = [i for i, r, e in zip(pressed, reactions, noise, strict=True) if r <= e]
                still = [i for i in free if i not in pressed and abs(left[i]) <= rounding[i]]
                busy = tuple(i for i in pressed if i not in idle)
                return _Support(busy, tuple(sorted(idle + still)), pressed)
        return _Support(first, (), first)
