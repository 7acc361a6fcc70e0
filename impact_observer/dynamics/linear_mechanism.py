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
from impact_observer.dynamics.guard_values import GuardValues
from impact_observer.dynamics.linear_guards import LinearGuards
from impact_observer.dynamics.mechanism import (
    Array,
    Flown,
    Gaps,
    Grip,
    GuardedMotion,
    Mechanism,
    PhaseEnd,
    Pressing,
    mechanism_near,
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
_WINDOW = 8
"""Steps of the exponential in a window of a flight."""


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
        self.is_noisy = False
        self._modes = np.abs(system.W.T @ self.phases.scales.shapes)
        self._rest, self._bias = np.abs(system.q_r) + _TINY, np.zeros(system.m)
        self._watch_of = lru_cache(KEPT)(self._watched)

    @cached_property
    def rate(self) -> float:
        """The fastest rate of flow and forces, at least 1, 1/s."""
        return max(self.phases.phase(()).flow.exponential.rate, 1.0)

    @property
    def window(self) -> float:
        """Half a period of the fastest rate."""
        return _WINDOW * self.phases.phase(()).flow.exponential.step

    @property
    def stride(self) -> float:
        """A step of the exponential."""
        return self.phases.phase(()).flow.exponential.step

    @property
    def theta(self) -> Vector:
        """The parameters of its tangent, shape (p,)."""
        return self.tangent.theta

    @cached_property
    def gap_slopes(self) -> Matrix:
        """Gaps of the model are parameters themselves, or do not depend on any, shape (m, p)."""
        return self.tangent.gaps(tuple(range(self.system.m))).rest_slopes

    @cached_property
    def _guards(self) -> LinearGuards:
        return LinearGuards(self.tangent)

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
        self,
        t: Sequence[float],
        x: Array,
        s: Vector,
        held: Contacts,
        intensity: tuple[float, ...],
        /,
    ) -> Array:
        """The same from all states at all times: one root for equal flights."""
        del t, x
        return self.tangent.noise(s, held, intensity)

    def rates(self, t: Sequence[float], x: Array, held: Contacts, /) -> Array:
        """A product with the matrix of the phase."""
        return self.tangent.rates(t, x, held)[0]

    def rate_slopes(self, t: Sequence[float], x: Array, held: Contacts, /) -> tuple[Array, Array]:
        """The matrix of the phase, the same in all states."""
        A = self.tangent.rate_slope(held)
        return np.broadcast_to(A, (len(x), *A.shape)), self.tangent.by_rates(t, x, held)

    def gaps(self, x: Array, /) -> Gaps:
        """Directions are the same in all states."""
        system, n = self.system, self.system.n
        W = np.broadcast_to(system.W.T, (*x.shape[:-1], system.m, n))
        return Gaps(x[..., :n] @ system.W + system.q_r, x[..., n:] @ system.W, W)

    def gaps_along(
        self, t: Sequence[float], x: Array, s: Vector, held: Contacts, /
    ) -> GuardValues:
        """Powers of the exponential times all states."""
        return self._guards.gaps(t, x, s, held)

    def loads_along(
        self, t: Sequence[float], x: Array, s: Vector, held: Contacts, /
    ) -> tuple[Array, Array]:
        """Loads are linear in the state and the forces."""
        load, _, ends = self._guards.loads(t, x, s, held)
        return load, ends

    def falling(self, t: Sequence[float], x: Array, held: Contacts, /) -> Array:
        """Directions of contacts times accelerations."""
        return -self.rates(t, x, held)[:, self.system.n :] @ self.system.W

    def pressed(self, x: Vector, active: Contacts, hit: Contacts, /) -> Contacts:
        """Newton's law decides."""
        gamma = self.system.W[:, list(hit)].T @ x[self.system.n :]
        return self.newton.pressed(active, hit, gamma)

    def impact(self, x: Array, pressed: Contacts, /) -> Flown:
        """A linear map of the velocities, but for rebounds that depend on the speed."""
        return self.tangent.impact(x, pressed)

    def rest(self, x: Array, held: Contacts, /) -> Flown:
        """A projection in the metric of ``M``."""
        return self.tangent.rest(x, held)

    def stops(self, x: Array, pressed: Contacts, /) -> Array:
        """The same in all states."""
        X = self.tangent.stops(pressed)
        return np.broadcast_to(X, (*x.shape[:-1], *X.shape))

    def forced(self) -> tuple[Vector, Vector]:
        """Responses to constants and harmonics; coordinates that nothing holds count as held."""
        system, n = self.system, self.system.n
        forcing, inverse = system.forcing, np.linalg.inv(system.M)
        amplitude, pushed = np.zeros(2 * n), (inverse @ forcing.constant) ** 2
        with np.errstate(over="ignore", invalid="ignore"):  # next to no stiffness
            held = np.linalg.pinv(system.K, 1e-9, hermitian=True) @ forcing.constant
            amplitude[:n] += held**2
        soft = system.K + 1e-6 * np.trace(system.K) / n * np.eye(n) + 1e-12 * system.M
        for w, cos, sin in zip(forcing.frequency, forcing.cosine, forcing.sine, strict=True):
            dynamic = soft - w**2 * system.M + 1j * w * system.C
            q = np.abs(np.linalg.solve(dynamic, cos - 1j * sin))
            amplitude += np.concatenate([q, w * q]) ** 2
            pushed += np.abs(inverse @ (cos - 1j * sin)) ** 2
        return np.sqrt(amplitude), np.sqrt(pushed)

    def near(self, x: Vector, theta: Vector, /) -> System:
        """The system of the family, the same in all states."""
        del x
        return self.tangent.family.near(theta) if theta.size else self.system

    def sizes(self, x: Vector, s: float = 0.0, /) -> Vector:
        """The largest values that all modes can give."""
        return self.phases.scales.sizes(x, s)

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


@mechanism_near.register
def _(family: ParametricFamily, theta: Vector) -> Mechanism:
    tangent = Tangent(family, theta)
    return LinearMechanism(tangent.system, tangent)
