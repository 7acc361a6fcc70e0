# SPDX-License-Identifier: Apache-2.0
"""Convergence without ground truth: whether replicas with different initial states agree.

Replicas under the same events approach each other, and the plant behaves like one of them. The
estimate's own gap at an impact gives a lower bound of its error.
"""

import math
from collections.abc import Mapping
from functools import cached_property
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from scipy import linalg

from impact_observer.dynamics import PositionProjection
from impact_observer.events import Contacts
from impact_observer.model import System
from impact_observer.observer.belief import Belief
from impact_observer.observer.contact_change import ContactChange
from impact_observer.observer.ensemble import Ensemble
from impact_observer.robots.robot import Robot
from impact_observer.robots.tangent_robot import at_zero
from impact_observer.states import Matrix, Vector

AGREED = 1e-4
"""Largest V distance that counts as agreement, relative to the energy of the motion."""
REQUIRED_EVENTS = 3
"""Events in a row at which replicas must agree."""
_MARGIN = 2.0
"""Assumed ratio of V between plant and estimate to the largest between replicas."""
_RESTING = 1e-6
"""Energy below which a motion counts as rest, relative to its largest so far."""
_NONE: Mapping[int, float] = MappingProxyType({})
_MOST_COMPARED = 256
"""Replicas beyond which an upper bound replaces the distance of every pair."""


class Synchronization(NamedTuple):
    """How well the replicas agree after an event.

    Attributes:
        convergence: largest V distance between replicas just after the event, J; it only falls
            until the next one. -1 while there is only one replica.
        energy: kinetic and elastic energy of the estimate just after the event, J; at rest a
            millionth of ``largest``.
        largest: largest energy after an event so far, J.
        agreed: events in a row at which the replicas agreed, the last event included, for each
            part of the system that has contacts.
        hits: when each contact was hit last, s since the epoch.
    """

    convergence: float
    energy: float
    largest: float = 0.0
    agreed: tuple[int, ...] = ()
    hits: Mapping[int, float] = _NONE


class SynchronizationTest:
    """Tests whether the replicas of one system are synchronized."""

    def __init__(self, system: System | Robot) -> None:
        """Take the metric of ``V`` from ``system``; of a robot, where its coordinates are zero."""
        self._n = system.n
        self._has_encoders = system.has_encoders  # gaps are measured
        self._system = at_zero(system)
        self._metric = linalg.block_diag(self._system.K, self._system.M)
        seen = system.parts()[np.argmax(self._system.W != 0, axis=0)]
        _, part = np.unique(seen, return_inverse=True)
        self._names = system.contact_names
        self._part: list[int] = part.tolist()  # of each contact
        self._none = (0,) * len({*self._part})

    def initial(self, belief: Belief) -> Synchronization:
        """The result before any event."""
        return Synchronization(*self._distance_and_energy(belief.ensemble))

    def after_event(
        self, previous: Synchronization, change: ContactChange, x: Vector, posterior: Belief
    ) -> Synchronization:
        """The result after an event: ``x`` is the estimate before, ``posterior`` the belief."""
        convergence, energy = self._distance_and_energy(posterior.ensemble)
        largest = max(previous.largest, energy)
        energy = max(energy, _RESTING * largest)  # NaN stays, standing first
        agreed, limit = self._none, AGREED * energy
        if 0 <= _MARGIN * convergence <= limit and not posterior.inconsistent:
            is_tested = bool(change.hit) and not self._has_encoders
            if not is_tested or self._least_distance(previous, change, x[: self._n]) <= limit:
                agreed = self._agreed(previous.agreed, change.hit)
        hits = {**previous.hits, **dict.fromkeys(change.hit, float(change.t))}
        return Synchronization(convergence, energy, largest, agreed, hits)

    def _agreed(self, before: tuple[int, ...], hit: Contacts) -> tuple[int, ...]:
        """For each part, the events in a row that agreed, after one that hit these contacts."""
        agreed = list(before or self._none)
        for i in hit:
            agreed[self._part[i]] += 1
        return tuple(agreed)

    def _least_distance(
        self, previous: Synchronization, change: ContactChange, q: Vector
    ) -> float:
        """Returns a lower bound of V before an impact, J: the plant's gaps were zero.

        V is zero for a rigid displacement. So the bound has the energy of the speed that makes the
        displacement in the time since the previous hit of the contact.
        """
        strain = self._projection.strain(q, change.active)
        if not self._projection.is_rigid:
            return strain
        ago = float(change.t) - max(previous.hits.get(i, -math.inf) for i in change.hit)
        return strain + (self._projection.drift(q, change.active) / (ago * ago) if ago > 0 else 0)

    def is_synchronized(self, result: Synchronization) -> bool:
        """Whether the replicas are synchronized."""
        return min(result.agreed, default=0) >= REQUIRED_EVENTS

    def obstacle(self, result: Synchronization) -> str:
        """Why the replicas are not synchronized, in a few words; empty if synchronized."""
        limit = AGREED * result.energy
        if result.convergence < 0:
            return "one replica"
        if not _MARGIN * result.convergence <= limit:
            return f"replicas differ by over {limit / _MARGIN:.1e} J"
        if (least := min(result.agreed, default=0)) < REQUIRED_EVENTS:
            where = ""
            if len(result.agreed) > 1:  # the part that is behind the others
                part = result.agreed.index(least)
                pairs = zip(self._part, self._names, strict=True)
                where = f" of {', '.join(name for i, name in pairs if i == part)}"
            return f"agreement at {least} of {REQUIRED_EVENTS} impacts in a row{where}"
        return ""

    def _distance_and_energy(self, ensemble: Ensemble) -> tuple[float, float]:
        """The largest V distance of two replicas (an upper bound for very many), and energy, J.

        The energy is NaN where states are not finite.
        """
        others = ensemble.others
        is_bounded = others >= _MOST_COMPARED
        some = Ensemble(ensemble.x, ensemble.columns[:, :0]) if is_bounded else ensemble
        energy, distance = some.sizes_by(self._metric)
        if not (math.isfinite(energy) and math.isfinite(distance)):
            return -1.0, math.nan
        energy = max(energy, 0.0) / 2
        if not others:
            return -1.0, energy
        if is_bounded:
            lengths = ensemble.mapped(self._lengths)
            squares = np.einsum("ij,ij->j", lengths, lengths)
            return 2 * float(squares.max()), energy  # half of twice the radius, squared
        return distance / 2, energy

    @cached_property
    def _projection(self) -> PositionProjection:
        return PositionProjection(self._system)

    @cached_property
    def _lengths(self) -> Matrix:
        """Functions the sum of whose squares is ``x^T diag(K, M) x``, shape (2n, 2n)."""
        squares, axes = linalg.eigh(self._metric)
        return np.asarray((axes * np.sqrt(np.maximum(squares, 0.0))).T)
