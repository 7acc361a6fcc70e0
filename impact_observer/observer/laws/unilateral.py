"""Geometric constraints, and what else is known of every plant: no gap is ever negative."""

from dataclasses import replace
from typing import ClassVar

import numpy as np

from impact_observer.dynamics import Motion, Phase
from impact_observer.dynamics.complementarity import complementary
from impact_observer.dynamics.holds import Holds
from impact_observer.model import System
from impact_observer.observer.belief import Belief, Contacts, Touch
from impact_observer.observer.laws.geometric import Geometric
from impact_observer.observer.laws.replica import ReplicaLaw
from impact_observer.observer.uncertainty import Uncertainty
from impact_observer.states import Matrix, Vector


class Unilateral(Geometric):
    """Geometric, with two facts about the plant that cost no sensor.

    Its gaps are never negative: at an event one joint K-projection puts the replica onto
    ``{g_A = 0, g >= 0}``, its initial state onto ``{g >= 0}``, and in between a gap that would
    turn negative is held at zero (``dynamics.holds``). And no contact that impacts is separating:
    ``u-`` goes M-orthogonally onto ``{gamma_A <= 0}`` before Newton's law. The plant is in all of
    these convex sets, and a projection onto them brings the replica closer.
    """

    name: ClassVar[str] = "unilateral"

    def __init__(self, system: System, uncertainty: Uncertainty | None = None) -> None:
        """Prepare both projections."""
        super().__init__(system, uncertainty)
        self._holds = Holds(self._clutches)
        self._joint = self._holds.joint

    def placed(self, x: Vector) -> Vector:
        """The nearest state with no gap negative."""
        return self._on(x, ())

    def impact(self, x: Vector, active: Contacts, closed: Contacts) -> Vector:
        """``q+`` by the joint projection, ``u+`` by Newton's law where nothing separates."""
        n = self.system.n
        x = self._on(x, active)
        if closed != active:  # gaps that cannot all be zero are told: those that stay count
            x = self._on(x, closed)
        velocity = self._newton.velocity_held(self._closing(x[n:], active), active, closed)
        return np.concatenate([x[:n], velocity])

    def impacts(self, replicas: Matrix, active: Contacts, closed: Contacts) -> Matrix:
        """One after the other: each has its own stops."""
        return ReplicaLaw.impacts(self, replicas, active, closed)

    def motion(self, t: float, x: Vector, closed: Contacts) -> Motion:
        """Sprag clutches whose gaps stay closed; the other gaps never turn negative."""
        return self._holds.motion(t, x, closed)

    def phase(self, closed: Contacts) -> Phase | None:
        """None: the stops of different replicas hold at different times."""
        del closed
        return None

    def event(self, touch: Touch, belief: Belief) -> Belief:
        """Every replica after its own impact, or where opening contacts let it go."""
        if touch.hit or self._joint.is_possible(touch.before):
            return super().event(touch, belief)
        replicas = [self._on(x, touch.closed) for x in belief.replicas]
        return replace(belief, replicas=np.array(replicas))

    def taken(self, before: Vector, after: Vector, active: Contacts) -> float | None:
        """What both projections take, in the energy of their jumps, where no impact raises V."""
        del after
        n = self.system.n
        if not self._joint.is_possible(active):
            return None
        if active and not self._newton.is_nonexpansive(active):
            return None
        q = self._joint.position_after(before[:n], active) - before[:n]
        u = self._closing(before[n:], active) - before[n:]
        return float(q @ self.system.K @ q + u @ self.system.M @ u) / 2

    def _on(self, x: Vector, active: Contacts) -> Vector:
        """The nearest state with ``g = 0`` on ``active`` and no gap negative."""
        n = self.system.n
        return np.concatenate([self._joint.position_after(x[:n], active), x[n:]])

    def _closing(self, u: Vector, active: Contacts) -> Vector:
        """The nearest velocities, shape (n,), with which no ``active`` contact separates."""
        contacts = list(active)
        gamma = self.system.W[:, contacts].T @ u
        if np.all(gamma <= 0):
            return u
        phases = self._clutches.phases
        B = phases.B[:, contacts]
        impulses = complementary(B, -gamma)
        if impulses is None:  # contacts that depend on each other, and rounding
            return u
        return np.asarray(u - phases.unwhite(B @ impulses))
