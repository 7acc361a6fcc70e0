# SPDX-License-Identifier: Apache-2.0
"""Geometric constraints, and the unilateral constraints of every plant: no gap is negative."""

from typing import ClassVar

import numpy as np

from impact_observer.dynamics import Motion
from impact_observer.dynamics.contact.complementarity import complementary
from impact_observer.dynamics.contact.sweeping import SweepingProcess
from impact_observer.events import Contacts
from impact_observer.model import System
from impact_observer.observer.belief import Belief
from impact_observer.observer.contact_change import ContactChange
from impact_observer.observer.laws.geometric import Geometric
from impact_observer.observer.laws.replica_law import ReplicaLaw
from impact_observer.observer.uncertainty import Uncertainty
from impact_observer.states import Vector


class Unilateral(Geometric):
    """Geometric, with two facts about the plant that need no sensor.

    The plant's gaps are never negative. An event projects the replica onto ``{g_A = 0, g >= 0}``
    jointly, in the metric of K; the initial state is projected onto ``{g >= 0}``; and in between a
    gap that would turn negative is held at zero (``dynamics.contact.sweeping``). A contact that
    impacts alone is not separating, nor is one that was closed. So ``u-`` is projected onto
    ``{gamma <= 0}``, in the metric of M, before Newton's law. The plant is in all of these convex
    sets, so each projection brings the replica closer. Where several contacts hit at once, one of
    them may separate: an impact before it, at the same instant, may have thrown it back.
    """

    name: ClassVar[str] = "unilateral"

    def __init__(self, system: System, uncertainty: Uncertainty | None = None) -> None:
        """Prepare both projections."""
        super().__init__(system, uncertainty)
        self._sweeping = SweepingProcess(self._clutches)
        self._unilateral = self._sweeping.projection

    def admissible(self, x: Vector) -> Vector:
        """The nearest states without a negative gap."""
        return self._projected(x, ())

    def impact(self, x: Vector, active: Contacts, closed: Contacts) -> Vector:
        """``q+`` by the joint projection, ``u+`` by Newton's law."""
        n = self.system.n
        x = self._projected(x, active)
        if closed != active:  # if not all gaps can be zero, those of ``closed`` are
            x = self._projected(x, closed)
        velocity = self.newton.velocity_held(x[..., n:], active, closed)
        return np.concatenate([x[..., :n], velocity], axis=-1)

    phase = ReplicaLaw.phase

    def motion(self, t: float, x: Vector, closed: Contacts) -> Motion:
        """Sprag clutches whose gaps stay closed; the other gaps never turn negative."""
        return self._sweeping.motion(t, x, closed)

    def correct(self, change: ContactChange, prior: Belief) -> Belief:
        """Every replica after its own impact, or projected where contacts open."""
        if change.hit:
            alone = change.hit if len(change.hit) == 1 else ()
            return super().correct(change, self._approaching(prior, (*change.before, *alone)))
        if self._unilateral.is_possible(change.before):
            return super().correct(change, prior)
        replicas = self._projected(prior.replicas, change.closed)
        return prior.moved(replicas)

    def energy_removed(self, before: Vector, after: Vector, active: Contacts) -> float | None:
        """The impact of ``geometric`` for contacts that can all be closed at once."""
        if not self._unilateral.is_possible(active):
            return None
        return super().energy_removed(before, after, active)

    def _approaching(self, belief: Belief, contacts: Contacts) -> Belief:
        """No replica separates at ``contacts``; the bound falls by the energy removed."""
        n = self.system.n
        replicas, active = belief.replicas, tuple(sorted({*contacts}))
        replicas[:, n:] = self.nearest_approaching(replicas[:, n:], active)
        u = replicas[0, n:] - belief.x[n:]
        removed = float(u @ self.system.M @ u) / 2
        bound = None if belief.bound is None else belief.bound - removed
        return self._checked(belief.moved(replicas)._replace(bound=bound))

    def _projected(self, x: Vector, active: Contacts) -> Vector:
        """The nearest states with ``g = 0`` on ``active`` and no gap negative."""
        n = self.system.n
        position = self._unilateral.position_after(x[..., :n], active)
        return np.concatenate([position, x[..., n:]], axis=-1)

    def nearest_approaching(self, u: Vector, active: Contacts) -> Vector:
        """The nearest velocities, shape (..., n), with which no ``active`` contact separates."""
        if u.ndim > 1:
            return np.asarray(np.apply_along_axis(self.nearest_approaching, -1, u, active))
        contacts = list(active)
        gamma = self.system.W[:, contacts].T @ u
        if np.all(gamma <= 0):
            return u
        phases = self._clutches.phases
        B = phases.B[:, contacts]
        impulses = complementary(B, -gamma)
        if impulses is None:  # dependent contacts, and rounding
            return u
        return np.asarray(u - phases.unwhite(B @ impulses))
