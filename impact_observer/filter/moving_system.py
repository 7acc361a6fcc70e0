# SPDX-License-Identifier: Apache-2.0
"""The motion of a system between impacts: states, rates, and their derivatives."""

import math
from functools import cached_property, lru_cache

import numpy as np

from impact_observer.dynamics import (
    KEPT,
    Clutches,
    ImpactLaw,
    Motion,
    Phase,
    Phases,
)
from impact_observer.dynamics.equations import state_matrix
from impact_observer.dynamics.scales import Scales
from impact_observer.events import Contacts
from impact_observer.filter.process_noise import diffusion, fastest_rate
from impact_observer.filter.saltation import FreePhase, StateRates
from impact_observer.kernel._kernel import FINE, FreeMotion, Sizes
from impact_observer.model import System
from impact_observer.states import Matrix, Vector

_FIRST_WINDOW = 16 / FINE
"""First window in which penetrations are searched, in the inverse of the fastest rate."""
_MANY = 32
"""Coordinates from which on products of matrices are faster than motions one by one."""
_SMALL = 16
"""Most coordinates of a system whose transition matrices the kernel makes by Taylor's series."""
_MOST_TURNS = 100.0
"""Longest time that it takes, in the inverse of the fastest rate."""


class MovingSystem:
    """One system between its impacts.

    Attributes:
        system: the system; the places of its stops do not matter.
        depends_on_state: whether derivatives of a motion depend on its start: no.
        is_plain: whether all forces are constants and harmonics, which the kernel knows.
    """

    def __init__(self, system: System, inverse: Matrix | None = None) -> None:
        """Each phase is prepared when it is first needed.

        Where the ``inverse`` of its mass matrix is given, short motions without contact are the
        kernel's: that is cheaper for a system of which few are asked.
        """
        self.system = system
        self.depends_on_state = False
        self.is_plain = system.forcing.sampled is None and system.forcing.squares is None
        self._inverse = inverse if self.is_plain and system.n <= _SMALL else None
        self.phase = lru_cache(KEPT)(self._phase_of)
        self.rates = lru_cache(KEPT)(self._rates_of)
        changes = system.live is not None  # what was known of a force may be others' past
        self.forces = self._forces_at if changes else lru_cache(KEPT)(self._forces_at)
        self._diffusion = lru_cache(KEPT)(self._diffusion_over)
        self._transition = lru_cache(KEPT)(lambda closed, s: self.phase(closed).transition(s))

    @cached_property
    def phases(self) -> Phases:
        """Its linear phases."""
        return Phases(self.system)

    @cached_property
    def scales(self) -> Scales:
        """Of its motions while nothing is held."""
        return self.phases.scales if self._inverse is None else Scales.of_equations(self.system)

    @cached_property
    def first_window(self) -> float:
        """First window after a start in which penetrations are searched, s."""
        return _FIRST_WINDOW * self.scales.timescale

    @cached_property
    def newton(self) -> ImpactLaw:
        """The impact law with its masses."""
        return ImpactLaw(self.system)

    @cached_property
    def rate(self) -> float:
        """A bound of all rates while no contact is closed, 1/s."""
        return float(max(self._rate(()), self.system.forcing.fastest))

    def _rate(self, closed: Contacts) -> float:
        """A bound of the rates of the differences of states, 1/s."""
        if not closed:
            return fastest_rate(self.rates(()).A)
        return fastest_rate(state_matrix(self.phase(closed).equations))

    def is_short(self, s: float) -> bool:
        """Whether the kernel makes transition matrices of ``s`` seconds by Taylor's series."""
        return self.system.n <= _SMALL and s * self.rate <= _MOST_TURNS

    @cached_property
    def free(self) -> FreeMotion:
        """Its motion while no contact is closed, without sampled forces, for the kernel."""
        n, forcing, rates = self.system.n, self.system.forcing, self.rates(())
        inverse = rates.B[n:]
        cosine, sine = forcing.cosine @ inverse.T, forcing.sine @ inverse.T
        constant = inverse @ forcing.constant
        return FreeMotion(
            rates.A[n:], constant, forcing.frequency, cosine, sine, self.rate, rates.decay
        )

    @cached_property
    def sizes(self) -> Sizes:
        """What its states are rounded against, for the kernel."""
        scales = self.scales
        squares = np.maximum(scales.squares, 0.0)
        return Sizes(scales.modes, scales.spread, squares, scales.timescale)

    def rate_of(self, t: float, x: Vector, closed: Contacts) -> Vector:
        """``dx/dt`` of a state at ``t``, s since the epoch, shape (2n,)."""
        if not closed and self.is_plain:
            return self.free.rates(t, x)
        return self.rates_at(t, x, closed).along(x, self.forces(t))[0]

    def rates_at(self, t: float, x: Vector, closed: Contacts) -> StateRates:
        """``rates`` at a state, shape (2n,), at ``t``, s since the epoch."""
        del t, x
        return self.rates(closed)

    def motion(self, t: float, x: Vector, closed: Contacts) -> Motion:
        """The motion through ``x``, shape (2n,), at ``t``, s since the epoch."""
        return self.phase(closed).start(t, x)

    def moved(self, t: float, x: Vector, s: float, closed: Contacts) -> tuple[Vector, Matrix]:
        """The state ``s`` seconds after, or before, ``x``, and the derivative by ``x``.

        The caller must not ask for instants at which the forcing is not defined.
        """
        if self.is_cheap(closed, s):
            return self.free.moved(t, x, s)
        return self.phase(closed).moved(t, x, s)

    def is_cheap(self, closed: Contacts, s: float) -> bool:
        """Whether ``s`` seconds while contacts are ``closed`` need no phase."""
        return not (closed or self._inverse is None) and abs(s) * self.rate <= _MOST_TURNS

    @cached_property
    def clutches(self) -> Clutches:
        """Its motions while contacts are closed."""
        return Clutches(self.system, self.phases)

    def decay(self, closed: Contacts) -> float:
        """Rate of the fastest fading motion, 1/s."""
        return self.rates(closed).decay

    def held(self, closed: Contacts) -> Contacts:
        """Those of the ``closed`` contacts that a load holds; the others depend on them."""
        return self.phase(closed).held

    def inverse(self, x: Vector) -> Matrix:
        """``M^-1`` at any state ``x``, shape (n, n)."""
        del x
        return self.phase(()).inverse

    def root_energy(self, x: Vector) -> float:
        """The root of twice the kinetic energy of a state ``x``, shape (2n,), sqrt(J)."""
        u = x[self.system.n :]
        return math.sqrt(u.dot(self.phases.inertia(u)))

    def contact_length(self, contact: int, x: Vector) -> float:
        """The largest speed of a contact per ``root_energy``, at any ``x``, 1/sqrt(kg)."""
        del x
        return float(self.phases.length[contact])

    def stops(self, x: Vector, contacts: Contacts) -> Matrix:
        """Velocities by unit speeds that ``contacts`` lose, at any state ``x``, shape (n, k)."""
        del x
        return self.newton.stops(contacts)

    def shifts(self, x: Vector, contacts: Contacts) -> Matrix:
        """Coordinates by unit gaps that ``contacts`` gain, at any state ``x``, shape (n, k)."""
        del x
        return self.phases.projection.jump(contacts)

    def diffusion(self, t: float, x: Vector, closed: Contacts, s: float) -> Matrix:
        """A root of what white accelerations of 1 m/s^1.5 add in ``s`` seconds, (2n, 2n).

        It is the same from all states ``x`` at all ``t``.
        """
        del t, x
        return self._diffusion(closed, s)

    def carried(self, t: float, x: Vector, columns: Matrix, s: float, closed: Contacts) -> Matrix:
        """Differences of states, one a column, ``s`` seconds later, shape (2n, any).

        They are the same about all states ``x`` at all ``t``.
        """
        del t, x
        phase = self.phase(closed)
        if self.system.n < _MANY or not self.is_plain:
            return np.asarray(self._transition(closed, s).dot(columns))
        rest = phase.start(0.0, np.zeros(len(columns))).state(s)
        moved = [phase.start(0.0, x).state(s) - rest for x in columns.T]
        return np.column_stack(moved)

    def _phase_of(self, closed: Contacts) -> Phase:
        return self.phases.phase(self.phases.independent(closed))

    def _rates_of(self, closed: Contacts) -> StateRates:
        if closed or self._inverse is None:
            return StateRates(self.phase(closed))
        return StateRates(FreePhase(self.system, self._inverse))

    def _diffusion_over(self, closed: Contacts, s: float) -> Matrix:
        if not closed and self.system.n < _MANY:
            return self.free.diffusion(s)
        return diffusion(self.phase(closed), s, self._rate(closed))

    def _forces_at(self, t: float) -> Matrix:
        """f, df/dt and d2f/dt2 at an instant, shape (3, n)."""
        return self.system.forcing.derivatives(np.array([t]), 2)[:, 0]
