# SPDX-License-Identifier: Apache-2.0
"""Moreau's sweeping process: the motion of a replica none of whose gaps becomes negative.

While ``chi = 1`` on the contacts ``A`` a replica moves with ``g_A = 0`` (equation 4 of Baumann and
Leine). Where the gap of another contact would become negative, that contact stops it::

    dq/dt = u + K^-1 W sigma,    sigma_A of any sign,    0 <= dg_i/dt  _|_  sigma_i >= 0

on those others with ``g_i = 0``; ``u`` is not changed (``docs/theory/method.md``).
"""

from functools import lru_cache

import numpy as np

from impact_observer.dynamics.contact.clutch import Clutches, Part, Piecewise
from impact_observer.dynamics.contact.persistent_contact import persistent_contacts
from impact_observer.dynamics.contact.projection import KEPT
from impact_observer.dynamics.contact.unilateral_projection import UnilateralProjection
from impact_observer.dynamics.flow import Motion
from impact_observer.dynamics.phase import Phase
from impact_observer.states import Vector

_ORDERS = 6
"""Derivatives that are examined before a gap counts as neither stopped nor opening."""
_ZERO = 1e-11
"""Largest rate of a gap that counts as zero, relative to the largest term."""
_CLOSED = 1e-12
"""Gap that counts as zero, relative to the terms of its sum."""


class SweepingProcess:
    """Motions of one system whose gaps stay nonnegative."""

    def __init__(self, clutches: Clutches) -> None:
        """Take the clutches of the contacts with ``chi = 1``."""
        self.clutches = clutches
        self.projection = UnilateralProjection(clutches.phases)
        self.opened = lru_cache(KEPT)(self._open)

    def motion(self, t: float, x: Vector, closed: tuple[int, ...]) -> Motion:
        """The motion through ``x`` at ``t`` (s since the epoch) while ``closed`` have ``chi = 1``.

        The state (q, u), shape (2n,), has ``g = 0`` and ``gamma >= 0`` on them, and no gap
        negative. Without such a position no plant can have this ``chi``: then the other gaps may
        become negative.
        """
        return _SweepingMotion(self, t, x, closed)

    def stopped(
        self,
        t: float,
        x: Vector,
        phase: Phase,
        *,
        closed: tuple[int, ...],
        at_stop: tuple[int, ...],
    ) -> tuple[int, ...]:
        """The contacts of ``at_stop``, with ``g = 0``, that stop their gaps now.

        Where reaction and rate are both zero the next derivatives decide, and so on. The contacts
        of ``phase`` take the loads; its gaps ``closed`` ones fixed. ``x`` is (q, u), shape (2n,),
        at ``t``.
        """
        phases, n = self.clutches.phases, len(x) // 2
        system, at = phases.system, np.array([t])
        f = system.forcing.derivatives(at, _ORDERS - 1)[:, 0]
        q, u = x[:n], x[n:]
        size = float(np.sqrt(u @ system.M @ u))
        pressed: tuple[int, ...] = ()
        undecided = at_stop
        for k in range(_ORDERS):
            values = system.W.T @ u
            fixed = (*closed, *pressed)
            support = self.projection.support(
                values, _ZERO * phases.length * size, fixed, undecided
            )
            if support is None:
                break
            pressed, undecided = (*pressed, *support.pressed), support.undecided
            if not undecided:
                break
            fixed = (*closed, *pressed)
            terms = np.stack([f[k], -(system.C @ u), -(system.K @ q)], axis=1)
            size = float(np.max(np.linalg.norm(phases.white(terms), axis=0)))
            size = max(size, float(phases.unloaded().load(k, at)[0]))
            q = u - phases.projection.jump(fixed) @ values[list(fixed)]
            u = phase.inverse @ terms.sum(axis=1)
        return tuple(sorted(pressed))

    def _open(
        self, closed: tuple[int, ...], stopped: tuple[int, ...], kept: tuple[int, ...]
    ) -> tuple[int, ...]:
        """The contacts of ``kept`` whose gaps can change while others are fixed."""
        phases, fixed = self.clutches.phases, (*closed, *stopped)
        return tuple(i for i in kept if i not in stopped and phases.independent((i,), fixed))


class _SweepingMotion(Piecewise):
    def __init__(
        self, process: SweepingProcess, t: float, x: Vector, closed: tuple[int, ...]
    ) -> None:
        self._process = process
        system = process.clutches.system
        possible = process.projection.is_possible(closed)
        others = {*range(system.m)} - {*closed}
        self._kept = tuple(sorted(others)) if possible else ()
        super().__init__(process.clutches, t, x, closed, fixed=closed)

    def _opened(self, part: Part) -> tuple[int, ...]:
        return self._process.opened(self._closed, part.stopped, self._kept)

    def _at_stop(self, x: Vector) -> tuple[int, ...]:
        """Open contacts with ``g = 0``, as indices."""
        q, u = np.split(x, 2)
        reach = np.abs(q) + np.abs(u) * self._clutches.phases.scales.timescale
        gap, most = (
            self._clutches.system.gap(q),
            _CLOSED * self._process.projection.rounding(reach),
        )
        return tuple(i for i in self._kept if gap[i] <= most[i])

    def _part(
        self, start: float, x: Vector, slow: tuple[int, ...], stopped: tuple[int, ...]
    ) -> Part:
        """The phase from ``start`` on: the next derivatives decide which gaps are stopped."""
        phases, t, closed = self._clutches.phases, self.t + start, self._closed
        grip = persistent_contacts(phases, closed, t, x, slow)
        if at_stop := tuple(sorted({*self._at_stop(x), *stopped})):
            phase = phases.phase(grip.held, closed)
            stopped = self._process.stopped(t, x, phase, closed=closed, at_stop=at_stop)
        if stopped:
            grip = persistent_contacts(phases, (*closed, *stopped), t, x, slow)
        return self._begun(start, x, grip, stopped)
