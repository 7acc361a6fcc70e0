# SPDX-License-Identifier: Apache-2.0
"""Convergence without ground truth: whether replicas with different initial states agree.

Replicas under the same events approach each other, and the plant behaves like one of them. The
estimate's own gap at an impact gives a lower bound of its error.
"""

import math
from collections.abc import Mapping
from functools import cached_property
from itertools import takewhile
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from scipy import linalg

from impact_observer.dynamics import PositionProjection
from impact_observer.events import Ruling
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.ensemble import Ensemble
from impact_observer.filter.hypotheses import agreeing, mixture
from impact_observer.filter.robot_motion import scales_of
from impact_observer.filter.tuning import TUNING
from impact_observer.model import System
from impact_observer.observer.belief import Belief
from impact_observer.robots.robot import Robot
from impact_observer.robots.tangent_robot import at_zero
from impact_observer.states import Matrix, Vector

AGREED = 1e-4
"""Largest V distance that counts as agreement, relative to the energy of the motion."""
REQUIRED_EVENTS = 3
"""Events in a row at which replicas must agree."""
LARGEST_INNOVATION = 6.0
"""Innovation, in standard deviations, up to which the declared uncertainty explains an event."""
_MARGIN = 2.0
"""Assumed ratio of V between plant and estimate to the largest between replicas."""
_RESTING = 1e-6
"""Energy below which a motion counts as rest, relative to its largest so far."""
_STILL = 1e-22
"""The same without impacts: a rig may move much less than its start is uncertain."""
_NONE: Mapping[int, float] = MappingProxyType({})
_NEVER: Mapping[int, tuple[int, int]] = MappingProxyType({})
_MOST_COMPARED = 256
"""Replicas beyond which an upper bound replaces the distance of every pair."""


class Synchronization(NamedTuple):
    """How well the replicas agree after an event.

    Attributes:
        convergence: largest V distance between replicas just after the event, J; it only falls
            until the next one. -1 while there is only one replica.
        energy: kinetic and elastic energy of the estimate just after the event, J; at rest a
            millionth of ``largest``.
        largest: largest energy after an event so far, J; with a covariance, only estimates whose
            expected V is not above their energy count.
        agreed: events in a row at which the replicas agreed, the last event included, for each
            part of the system that has contacts.
        contradicted: for each contact, how many events were rejected and how many inserted since
            its last accepted event.
        hits: when each contact was hit last, s since the epoch.
    """

    convergence: float
    energy: float
    largest: float = 0.0
    agreed: tuple[int, ...] = ()
    contradicted: Mapping[int, tuple[int, int]] = _NEVER
    hits: Mapping[int, float] = _NONE


def _contradicted(
    before: Mapping[int, tuple[int, int]], change: ContactChange, posterior: Belief
) -> Mapping[int, tuple[int, int]]:
    """``Synchronization.contradicted`` after an event, of a law that rejects and inserts."""
    if not posterior.weighs:
        return before
    counts, event = dict(before), (change.stamp, change.sequence)
    notes = posterior.notes
    latest = takewhile(lambda note: note.event == event, reversed(notes))
    for note in [*latest][::-1]:
        if note.ruling is Ruling.APPLIED:
            counts.pop(note.switched, None)
        else:
            rejected, inserted = counts.get(note.contact, (0, 0))
            is_inserted = note.is_inserted
            counts[note.contact] = rejected + (not is_inserted), inserted + is_inserted
    return counts


def _is_rejected(change: ContactChange, posterior: Belief) -> bool:
    """Whether the likeliest account of an event is that no contact switched."""
    event = change.stamp, change.sequence
    notes = [n for n in posterior.notes if n.event == event and not n.is_inserted]
    return bool(notes) and all(note.ruling is Ruling.REJECTED for note in notes)


class SynchronizationTest:
    """Tests whether the replicas of one system are synchronized."""

    def __init__(self, system: System | Robot) -> None:
        """Take the metric of ``V`` from ``system``; of a robot, where its coordinates are zero."""
        self._n = system.n
        self._has_encoders = system.has_encoders  # gaps are measured
        scales, self._system = scales_of(system), at_zero(system)
        self._metric = linalg.block_diag(self._system.K, self._system.M)
        seen = system.parts()[np.argmax(self._system.W != 0, axis=0)]
        self._brief = TUNING.brief_flight * scales.timescale
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
        expected = 0.0 if posterior.root is None else self._expected(posterior.root)
        is_mixed = len(posterior.hypotheses) > 1 and not posterior.fit.is_misfit
        if is_mixed and expected > AGREED * energy:
            found = mixture(agreeing(posterior.hypotheses, self._system))
            expected = self._expected(found.root[: 2 * self._n])
        largest = previous.largest
        if expected <= energy:  # else the estimate may be anywhere
            largest = max(largest, energy)
        is_at_rest = energy <= _STILL * largest
        energy = max(energy, _RESTING * largest)  # NaN stays, standing first
        hits, is_rejected = previous.hits, _is_rejected(change, posterior)
        if not is_rejected:
            hits = {**hits, **dict.fromkeys(change.hit, float(change.t))}
        contradicted = _contradicted(previous.contradicted, change, posterior)
        limit = AGREED * energy
        is_explained = not posterior.inconsistent and (
            not posterior.innovations or max(posterior.innovations.values()) <= LARGEST_INNOVATION
        )
        agreed = self._none
        if 0 <= _MARGIN * convergence <= limit and is_explained:
            is_impact = bool(change.hit) and posterior.accepted
            if posterior.root is not None:
                # At rest on several stops a filter that has lost the track explains any event.
                is_impact = is_impact and bool(change.closed or not is_at_rest)
                is_impact = is_impact and not self._is_bounce(previous, change)
            elif is_impact and not self._has_encoders:
                expected = self._least_distance(previous, change, x[: self._n])
            if expected <= limit or is_rejected:
                agreed = self._agreed(previous.agreed, change, contradicted, counts=is_impact)
        return Synchronization(convergence, energy, largest, agreed, contradicted, hits)

    def _agreed(
        self,
        before: tuple[int, ...],
        change: ContactChange,
        contradicted: Mapping[int, tuple[int, int]],
        *,
        counts: bool,
    ) -> tuple[int, ...]:
        """Returns, for each part, the events in a row that agreed, and whether this event did.

        A part with contacts that are ``contradicted`` too often has 0.
        """
        agreed = list(before or self._none)
        for i in change.hit if counts else ():
            agreed[self._part[i]] += 1
        for i, each in contradicted.items():
            if min(each) >= REQUIRED_EVENTS:
                agreed[self._part[i]] = 0
        return tuple(agreed)

    def _is_bounce(self, previous: Synchronization, change: ContactChange) -> bool:
        """Whether every contact was hit a brief flight ago: a row of bounces counts once."""
        earliest = float(change.t) - self._brief
        return all(earliest < previous.hits.get(i, -math.inf) for i in change.hit)

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

    def is_wide(self, result: Synchronization, root: Matrix) -> bool:
        """Whether a covariance ``root root^T`` is too wide for the flag."""
        return self._expected(root) > AGREED * result.energy

    def is_synchronized(self, result: Synchronization, root: Matrix | None) -> bool:
        """Whether the replicas are synchronized, with a covariance ``root root^T`` by now."""
        if min(result.agreed, default=0) < REQUIRED_EVENTS:
            return False
        return root is None or not self.is_wide(result, root)

    def obstacle(self, result: Synchronization, root: Matrix | None) -> str:
        """Why the replicas are not synchronized, in a few words; empty if synchronized."""
        limit = AGREED * result.energy
        if result.convergence < 0:
            return "one replica"
        if not _MARGIN * result.convergence <= limit:
            return f"replicas differ by over {limit / _MARGIN:.1e} J"
        if root is not None and not (expected := self._expected(root)) <= limit:
            return f"covariance too wide: V of {expected:.1e} J"
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
        try:
            energy, distance = some.sizes_by(self._metric)
        except ValueError:  # states are not finite
            return -1.0, math.nan
        energy = max(energy, 0.0) / 2  # NaN stays, standing first
        if not (others and math.isfinite(energy)):
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

    def _expected(self, root: Matrix) -> float:
        """The expectation of ``V`` under a covariance ``root root^T``, J."""
        return max(float(np.vdot(root, self._metric.dot(root))), 0.0) / 2
