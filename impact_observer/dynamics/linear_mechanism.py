# SPDX-License-Identifier: Apache-2.0
"""The mechanism of a linear system: every answer by the exponential of one matrix."""

from collections.abc import Sequence
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from impact_observer.dynamics import lyapunov
from impact_observer.dynamics.contact.impact_law import ImpactLaw
from impact_observer.dynamics.contact.persistent_contact import ended, persistent_contacts
from impact_observer.dynamics.contact.projection import KEPT
from impact_observer.dynamics.mechanism import (
    Array,
    Flown,
    Gaps,
    Grip,
    GuardedMotion,
    Mechanism,
    PhaseEnd,
    Pressing,
    mechanism_of,
)
from impact_observer.dynamics.phase import Phase, Phases
from impact_observer.dynamics.roots import RootSearch
from impact_observer.dynamics.tangent import Tangent
from impact_observer.dynamics.watched import End, Watch, watch
from impact_observer.events import Contacts
from impact_observer.model import System
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.states import Matrix, Vector

_TINY = np.finfo(np.float64).tiny


class LinearMechanism:
    """One linear system.

    Attributes:
        system: the system.
        timescale: the inverse of the fastest rate, at most 1 s.
        phases: its linear phases.
        newton: its impact law.
        tangent: its flights and jumps with derivatives.
    """

    def __init__(self, system: System, tangent: Tangent | None = None) -> None:
        """Prepare the phases; ``tangent`` is that of the same system, with its parameters."""
        self.system: System = system
        self.phases = Phases(system) if tangent is None else tangent.phases
        self.newton = ImpactLaw(system) if tangent is None else tangent.newton
        if tangent is not None:
            self.tangent = tangent
        self.timescale: float = self.phases.scales.timescale
        self._modes = np.abs(system.W.T @ self.phases.scales.shapes)
        self._rest, self._bias = np.abs(system.q_r) + _TINY, np.zeros(system.m)
        self._watch_of = lru_cache(KEPT)(self._watched)

    @cached_property
    def tangent(self) -> Tangent:
        """Its flights and jumps with derivatives; without parameters unless it was given."""
        return Tangent(ParametricFamily(self.system, ()))

    def motion(self, t: float, x: Vector, grip: Grip, /) -> "WatchedMotion":
        """An exact flow, of which no root of a guard is skipped."""
        phase = self.phases.phase(grip.held)
        return WatchedMotion(t, x, phase, self._watch_of(phase, grip.closed))

    def struck(self, x: Vector, contacts: Contacts, /, *, plastic: bool = False) -> Vector:
        """Newton's law, and the nearest position with closed gaps in the metric of ``K``."""
        n, law = self.system.n, self.newton.plastic if plastic else self.newton
        velocity = law.velocity_after(x[n:], contacts)
        return np.concatenate([self.phases.projection.position_after(x[:n], contacts), velocity])

    def stopped(self, x: Vector, contacts: Contacts, /) -> Vector:
        """The nearest state in elastic energy for positions, kinetic energy for velocities."""
        return self.phases.stopped(x, contacts)

    def pressing(self, t: float, x: Vector, /) -> Pressing:
        """How contacts are pressed; gaps are rounded against the sum of all modes' magnitudes."""
        phases, system, n = self.phases, self.system, self.system.n
        q, u = x[:n], x[n:]
        free = phases.white(system.forcing(t) - system.C.dot(u) - system.K.dot(q))
        reach = self._rest + self._modes @ phases.scales.reach(q, u)
        return Pressing(phases.B, phases.length, free, self._bias, reach)

    def grip(
        self,
        t: float,
        x: Vector,
        contacts: Contacts,
        /,
        ending: tuple[Grip, frozenset[int]] | None = None,
    ) -> Grip:
        """Accelerations decide, and where these are zero the next derivatives."""
        grip = persistent_contacts(self.phases, (), t, x, contacts)
        if ending is None or grip.held != ending[0].held:
            return grip
        return ended(self.phases, self.phases.phase(grip.held), contacts, ending[1])

    def flown(self, t: Sequence[float], x: Array, s: Vector, held: Contacts, /) -> Flown:
        """Affine maps, blocks of one exponential."""
        maps = self.tangent.flights(t, s, held)
        return Flown(maps.of(x), maps.Phi, maps.Gamma(x))

    def noise(
        self, t: Sequence[float], x: Array, s: Vector, held: Contacts, intensity: Vector, /
    ) -> Array:
        """The same from all states at all times: one root for equal flights."""
        del t, x
        return self.tangent.noise(s, held, tuple(intensity.tolist()))

    def rates(self, t: Sequence[float], x: Array, held: Contacts, /) -> Array:
        """A product with the matrix of the phase."""
        return self.tangent.rates(t, x, held)[0]

    def gaps(self, x: Array, /) -> Gaps:
        """Directions are the same in all states."""
        system, n = self.system, self.system.n
        W = np.broadcast_to(system.W.T, (*x.shape[:-1], system.m, n))
        return Gaps(x[..., :n] @ system.W + system.q_r, x[..., n:] @ system.W, W)

    def impact(self, x: Array, pressed: Contacts, /) -> Flown:
        """A linear map of the velocities, but for rebounds that depend on the speed."""
        return self.tangent.impact(x, pressed)

    def kinetic(self, x: Array, /) -> Array:
        """``u' M u / 2``."""
        u = x[..., self.system.n :]
        if x.ndim == 1:
            return np.asarray(u.dot(self.phases.inertia(u)) / 2)
        return np.asarray(np.einsum("...i,ij,...j->...", u, self.system.M, u) / 2)

    def distance(self, x: Array, error: Array, /) -> Array:
        """The mechanical energy of the differences, the same at all states."""
        del x
        n = self.system.n
        return lyapunov.distance(self.system, error[..., :n], error[..., n:])

    def _watched(self, phase: Phase, closed: Contacts) -> Watch:
        """The guards of a phase: gaps of the contacts that are not ``closed``, and loads."""
        opened = [i for i in range(self.system.m) if i not in closed]
        return watch(self.system, phase, gaps=opened)


class WatchedMotion(GuardedMotion):
    """The motion of one linear phase with its guards."""

    def __init__(self, t: float, x: Vector, phase: Phase, watch: Watch) -> None:
        """From ``x``, shape (2n,), at ``t``."""
        self.t, self._x, self._watch = t, x, watch
        self._motion = phase.start(t, x)
        self._search = RootSearch(watch.guards, self._motion)

    def states(self, s: NDArray[np.float64], /) -> Matrix:
        """States (q, u) at ``s`` seconds after the start, shape (samples, 2n)."""
        return self._motion.states(s)

    def end(self, horizon: float, /) -> PhaseEnd | None:
        """The first root of a guard."""
        found = self._search.first(horizon)
        if found is None or found[0] > horizon:
            return None
        crossed = self._watch.crossed(found[1])
        return PhaseEnd(found[0], frozenset(crossed[End.GAP]), frozenset(crossed[End.LOAD]))


@mechanism_of.register
def _(system: System) -> Mechanism:
    return LinearMechanism(system)
