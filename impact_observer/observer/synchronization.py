# SPDX-License-Identifier: Apache-2.0
"""Convergence without ground truth: whether replicas with different initial states agree.

Replicas under the same events approach each other, and the plant behaves like one of them. The
estimate's own gap at an impact gives a lower bound of its error.
"""

import math
from collections.abc import Mapping
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import linalg

from impact_observer.dynamics import Mechanism, PositionProjection
from impact_observer.model import System
from impact_observer.observer.belief import NOTHING, Belief
from impact_observer.observer.contact_change import ContactChange
from impact_observer.robots.robot import Robot
from impact_observer.states import Vector

AGREED = 1e-4
"""Largest V distance that counts as agreement, relative to the energy of the motion."""
REQUIRED_EVENTS = 3
"""Events in a row at which replicas must agree."""
_MARGIN = 2.0
"""Assumed ratio of V between plant and estimate to the largest between replicas."""
_MOST_PAIRED = 256
"""Replicas of which each pair is compared; of more, each with the estimate."""
_RESTING = 1e-6
"""Energy below which a motion counts as rest, relative to its largest so far."""


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
    hits: Mapping[int, float] = NOTHING


class SynchronizationTest:
    """Tests whether the replicas of one system are synchronized."""

    def __init__(self, system: System | Robot, mechanism: Mechanism) -> None:
        """Take the metric of ``V`` where coordinates are zero, if it depends on them."""
        self._n, self._names = system.n, system.contact_names
        self._has_encoders = system.has_encoders  # gaps are measured
        self._system = mechanism.near(np.zeros(2 * system.n), np.zeros(0))
        self._metric = linalg.block_diag(self._system.K, self._system.M)
        seen = system.parts()[np.argmax(self._system.W != 0, axis=0)]
        _, part = np.unique(seen, return_inverse=True)
        self._part: list[int] = part.tolist()  # of each contact
        self._none = (0,) * len({*self._part})

    def initial(self, belief: Belief) -> Synchronization:
        """The result before any event."""
        return Synchronization(*self._distance_and_energy(belief))

    def after_event(
        self, previous: Synchronization, change: ContactChange, x: Vector, posterior: Belief
    ) -> Synchronization:
        """The result after an event: ``x`` is the estimate before, ``posterior`` the belief."""
        convergence, energy = self._distance_and_energy(posterior)
        largest = max(previous.largest, energy)
        energy = max(energy, _RESTING * largest)  # NaN stays, standing first
        agreed, limit = self._none, AGREED * energy
        if 0 <= _MARGIN * convergence <= limit and not posterior.inconsistent:
            is_tested = bool(change.hit) and not self._has_encoders
            if not is_tested or self._least_distance(previous, change, x[: self._n]) <= limit:
                counts = [*(previous.agreed or self._none)]
                for i in change.hit:
                    counts[self._part[i]] += 1
                agreed = tuple(counts)
        hits = {**previous.hits, **dict.fromkeys(change.hit, float(change.t))}
        return Synchronization(convergence, energy, largest, agreed, hits)

    def _least_distance(
        self, previous: Synchronization, change: ContactChange, q: Vector
    ) -> float:
        """A lower bound of V before an impact, J: the plant's gaps were zero.

        Instead of V of a rigid displacement, which is zero, counts the energy of the speed that
        makes the displacement in the time since the previous hit of the contact.
        """
        strain = self._projection.strain(q, change.active)
        if not self._projection.is_rigid:
            return strain
        ago = float(change.t) - max(previous.hits.get(i, -math.inf) for i in change.hit)
        return strain + (self._projection.drift(q, change.active) / (ago * ago) if ago > 0 else 0)

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

    def _distance_and_energy(self, belief: Belief) -> tuple[float, float]:
        """The largest V distance of two replicas, -1 for one replica, and the energy, J.

        Of very many replicas the distance is an upper bound. The energy is NaN where states are
        not finite.
        """
        x, others = belief.x, belief.others
        with np.errstate(over="ignore", invalid="ignore"):
            energy = float(x.dot(self._metric.dot(x)))
            images = self._metric.dot(others)
            if others.shape[1] >= _MOST_PAIRED:
                farthest = np.max(np.einsum("ij,ij->j", others, images))
                distance = float(4 * farthest)  # of two, at most twice that from the estimate
            else:
                products = others.T.dot(images)
                squares = np.diagonal(products)
                apart = squares[:, None] + squares - 2 * products
                distance = float(max(np.max(squares, initial=0.0), np.max(apart, initial=0.0)))
        if not (math.isfinite(energy) and math.isfinite(distance)):
            return -1.0, math.nan
        return distance / 2 if others.size else -1.0, max(energy, 0.0) / 2

    @cached_property
    def _projection(self) -> PositionProjection:
        return PositionProjection(self._system)
