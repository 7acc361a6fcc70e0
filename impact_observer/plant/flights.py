# SPDX-License-Identifier: Apache-2.0
"""Impacts of one open contact after the other, computed ahead by the kernel.

Nearly all events of a plant are such impacts. The kernel leaves all other events to the plant:
impacts of several contacts at once, of a contact that may come to rest, and of a contact without
restitution; impacts of finite duration, or by another law than a constant restitution; and
flights so short that impacts might accumulate.
"""

from collections import deque
from typing import TypeAlias

import numpy as np

from impact_observer.dynamics import ImpactLaw, Phases
from impact_observer.kernel import Arena, Flights, Guards
from impact_observer.stamps import Elapsed
from impact_observer.states import Vector

_NUMBERS = 1 << 20
"""Largest count of numbers in the states that are computed ahead."""


Hit: TypeAlias = tuple[int, float, int, float, Vector, Vector]
"""An impact of one contact, which stays open: instant since the epoch, ns, and its remainder, s;
contact; kinetic energy before, J; states (q, u) before and after, shape (2n,) each."""


class PlainImpacts:
    """Flights of one plant while no contact is closed.

    Attributes:
        arena: the constants that all flights share.
        left: the crossing that the kernel leaves to the plant; None without one.
    """

    def __init__(
        self, phases: Phases, law: ImpactLaw, gaps: Guards, shortest: float, lowest: float
    ) -> None:
        """Prepare the flights.

        Args:
            phases: the phases of the plant's system.
            law: the impact law of the system.
            gaps: the guard functions of all gaps while no contact is closed.
            shortest: longest flight that counts as zero, s.
            lowest: height of a flight that counts as none, relative to what gaps are rounded
                against.
        """
        system, scales = phases.system, phases.scales
        self.arena = Arena(
            gaps,
            system.M,
            system.W.T,
            system.q_r,
            phases.length,
            scales.window,
            scales.timescale,
            shortest,
            lowest,
        )
        self._phases, self._law = phases, law
        self._flights: Flights | None = None
        self._unknown = set(np.flatnonzero(system.eps > 0).tolist()) - system.special
        self._most = max(16, _NUMBERS // (4 * system.n))
        self._hits: deque[Hit] = deque()
        self.left: tuple[float, tuple[int, ...]] | None = None

    def start(self, t: Elapsed, x: Vector) -> None:
        """Fly on from the state ``x``, shape (2n,), at ``t``."""
        self._hits.clear()
        self.left = None
        self._flights = self.arena.start(t.ns, t.remainder, x)

    def next(self, limit: int) -> Hit | None:
        """The next impact, if it is computed or not later than ``limit``, ns since the epoch.

        After the last impact ``left`` is the crossing that the plant handles, if any.
        """
        assert self._flights is not None, "not started"
        if not self._hits and self.left is None:
            hits, self.left = self._flights.advance(limit, self._most)
            while self.left is not None and self._learn(self.left[1]):
                more, self.left = self._flights.advance(limit, self._most)
                hits += more
            self._hits.extend(hits)
        return self._hits.popleft() if self._hits else None

    def _learn(self, contacts: tuple[int, ...]) -> bool:
        """Prepare the impact of a single contact for the kernel, unless the kernel has it."""
        if len(contacts) > 1 or contacts[0] not in self._unknown:
            return False
        self._unknown.discard(contacts[0])
        Z = self._phases.projection.jump(contacts)[:, 0]
        self.arena.learn(contacts[0], self._law.kick(contacts[0]), Z)
        return True
