# SPDX-License-Identifier: Apache-2.0
"""The mechanism: what plant, filter, batch and observer ask of a model, whatever its equations.

``LinearMechanism`` answers by the exponential of a matrix, ``robots.RobotMechanism`` by pinocchio.
States are ``x = (q, u)``, shape (..., 2n), in the frame in which no stop moves; times are seconds
since the epoch; contacts are indices. The protocol has two sides.

*One motion*, of a plant: ``motion`` and its first guard, ``struck`` by Newton's law, ``pressing``
and ``grip``, which decide what stays closed, ``stopped``. These are problems of complementarity
in one state.

*Many states*, of estimates: flights, impacts and rest with their derivatives by states and
parameters, noise, gaps and loads along flights. Here the set of contacts that are pressed is
given, and all is smooth in the state.

These are five and seventeen methods: each thing that a Kalman filter linearises is one.
"""

from abc import abstractmethod
from collections.abc import Sequence
from functools import singledispatch
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from impact_observer.dynamics.flow import Motion
from impact_observer.dynamics.guard_values import GuardValues
from impact_observer.errors import UsageError
from impact_observer.events import Contacts
from impact_observer.model import System
from impact_observer.model.multibody import Multibody
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.states import Matrix, Vector

Array = NDArray[np.float64]
_STILL = 1e-12
"""Contact speed that counts as zero, relative to the speed if it had all kinetic energy."""


class PhaseEnd(NamedTuple):
    """Where a phase ends: guards that fall below zero.

    Attributes:
        s: seconds since the start of the phase.
        gaps: open contacts whose gaps are zero.
        loads: closed contacts whose loads are zero.
    """

    s: float
    gaps: frozenset[int]
    loads: frozenset[int]


class GuardedMotion(Motion, Protocol):
    """The motion of one phase: its guards are gaps of open contacts and loads of closed ones."""

    @abstractmethod
    def end(self, horizon: float, /) -> PhaseEnd | None:
        """The first instant at which a guard falls below zero, if within ``horizon`` seconds.

        Raises:
            DynamicsError: the motion cannot be computed.
        """


class Grip(NamedTuple):
    """The closed contacts, and those of them that carry loads.

    Attributes:
        closed: contacts that stay closed, as indices.
        held: contacts that carry the loads, independent of each other, as indices.
    """

    closed: Contacts
    held: Contacts


class Pressing(NamedTuple):
    """How contacts are pressed in one state, in coordinates with unit mass matrix.

    Attributes:
        B: directions of all contacts, shape (n, m): ``B^T B = W^T M^-1 W``.
        length: lengths of the columns of ``B``, shape (m,).
        free: acceleration without loads, shape (n,).
        bias: accelerations of the gaps without ``free``, shape (m,).
        reach: size of the terms of which the gaps are sums, shape (m,), m.
    """

    B: Matrix
    length: Vector
    free: Vector
    bias: Vector
    reach: Vector

    def rising(self, contacts: Sequence[int]) -> Vector:
        """Accelerations of the gaps of ``contacts`` without loads, shape (k,), m/s^2."""
        which = list(contacts)
        return np.asarray(self.free.dot(self.B[:, which]) + self.bias[which])

    def still(self, energy: float) -> Vector:
        """Contact speeds that are rounding where the kinetic energy is ``energy``, (m,), m/s."""
        return np.asarray(_STILL * np.sqrt(2 * energy) * self.length)


class Flown(NamedTuple):
    """States after flights or jumps, and their derivatives.

    Attributes:
        x: states, shape (..., 2n).
        Phi: derivatives by the states before, shape (..., 2n, 2n).
        Gamma: derivatives by the parameters, shape (..., 2n, p).
    """

    x: Array
    Phi: Array
    Gamma: Array


class Gaps(NamedTuple):
    """Gaps of all contacts in states.

    Attributes:
        g: gaps, shape (..., m), m.
        gamma: contact speeds, shape (..., m), m/s.
        W: gradients of the gaps, shape (..., m, n).
    """

    g: Array
    gamma: Array
    W: Array


class Mechanism(Protocol):
    """A model as plant and estimates move it; see the text of this file."""

    @property
    def system(self) -> Multibody:
        """Names, sizes and contacts."""

    @property
    def timescale(self) -> float:
        """A time in which motions change, such as the inverse of the fastest rate, s."""

    @property
    def rate(self) -> float:
        """The fastest rate of small motions, at least 1, 1/s."""

    @property
    def window(self) -> float:
        """How far a flight is looked ahead at once, s."""

    @property
    def stride(self) -> float:
        """How long gaps are cubics of time in flights, to 1e-4 of their changes, s."""

    @property
    def is_noisy(self) -> bool:
        """Whether the model declares forces that are white noise."""

    @property
    def theta(self) -> Vector:
        """The parameters by which derivatives are taken, shape (p,)."""

    @property
    def gap_slopes(self) -> Matrix:
        """Derivatives of the gaps by the parameters, shape (m, p)."""

    # One motion

    def motion(self, t: float, x: Vector, grip: Grip, /) -> GuardedMotion:
        """The motion through ``x``, shape (2n,), at ``t`` while the contacts of ``grip`` stay.

        The state has ``g = 0`` and ``gamma = 0`` on them.
        """

    def struck(self, x: Vector, contacts: Contacts, /, *, plastic: bool = False) -> Vector:
        """The state after Newton's law on ``contacts``, whose gaps become zero, shape (2n,).

        ``plastic`` contacts have no restitution.

        Raises:
            ImpactLawError: the law has no solution on these contacts.
        """

    def stopped(self, x: Vector, contacts: Contacts, /) -> Vector:
        """The state nearest to ``x`` with ``g = 0`` and ``gamma = 0`` on ``contacts``, (2n,)."""

    def pressing(self, t: float, x: Vector, /) -> Pressing:
        """How contacts are pressed in ``x``, shape (2n,), at ``t``."""

    def grip(
        self,
        t: float,
        x: Vector,
        contacts: Contacts,
        /,
        ending: tuple[Grip, frozenset[int]] | None = None,
    ) -> Grip:
        """Which of ``contacts``, with ``g = 0`` and ``gamma = 0`` in ``x``, stay closed at ``t``.

        ``ending`` are the grip of the phase that ends and the contacts whose loads are zero: where
        nothing else changes these are released, as a load may fall too slowly to see its sign.

        Raises:
            DynamicsError: the loads cannot be found.
        """

    # Many states

    def flown(self, t: Sequence[float], x: Array, s: Vector, held: Contacts, /) -> Flown:
        """States after flights of ``s`` seconds, of any sign, without a switch of a contact.

        Args:
            t: starts, K instants or one for all.
            x: states, shape (K, 2n).
            s: shape (K,), or one for all, shape (1,).
            held: contacts that stay closed.
        """

    def noise(
        self,
        t: Sequence[float],
        x: Array,
        s: Vector,
        held: Contacts,
        intensity: tuple[float, ...],
        /,
    ) -> Array:
        """Roots of the covariance of white forces in flights, shape (K or 1, 2n, 2n).

        ``intensity`` is that of the acceleration of each coordinate, m/s^1.5, length n; forces
        that the model declares come on top.
        """

    def rates(self, t: Sequence[float], x: Array, held: Contacts, /) -> Array:
        """``dx/dt``, shape (K, 2n)."""

    def rate_slopes(self, t: Sequence[float], x: Array, held: Contacts, /) -> tuple[Array, Array]:
        """Derivatives of ``rates`` by states, (K, 2n, 2n), and by parameters, (K, 2n, p)."""

    def gaps(self, x: Array, /) -> Gaps:
        """Gaps, contact speeds and directions of all contacts in states (..., 2n)."""

    def gaps_along(
        self, t: Sequence[float], x: Array, s: Vector, held: Contacts, /
    ) -> GuardValues:
        """Gaps of all contacts along flights of ``s`` seconds, shape (K,), not negative."""

    def loads_along(
        self, t: Sequence[float], x: Array, s: Vector, held: Contacts, /
    ) -> tuple[Array, Array]:
        """Loads of the contacts ``held`` along flights, in their order, and when.

        Returns:
            Shapes (steps + 1, k, K), and (steps + 1, K), s since each start.
        """

    def falling(self, t: Sequence[float], x: Array, held: Contacts, /) -> Array:
        """Accelerations of all contacts towards their stops, shape (K, m), m/s^2."""

    def pressed(self, x: Vector, active: Contacts, hit: Contacts, /) -> Contacts:
        """Which of ``active`` contacts take an impulse in ``x``, shape (2n,), where ``hit`` close.

        Contacts that ``hit`` close, whatever the signs of their speeds in ``x``.

        Raises:
            ImpactLawError: the law has no solution on these contacts.
        """

    def impact(self, x: Array, pressed: Contacts, /) -> Flown:
        """Newton's law on exactly the contacts ``pressed``, from states (..., 2n)."""

    def rest(self, x: Array, held: Contacts, /) -> Flown:
        """States (..., 2n) with the speeds of ``held`` contacts zero, as masses would have it."""

    def stops(self, x: Array, pressed: Contacts, /) -> Array:
        """``X`` of ``u+ = u- - X gamma-``, which stops ``pressed`` contacts, (..., n, k)."""

    def forced(self) -> tuple[Vector, Vector]:
        """Amplitudes of the motion that forces alone give, and of its accelerations.

        Returns:
            Shapes (2n,) and (n,); zero where that is not known.
        """

    def near(self, x: Vector, theta: Vector, /) -> System:
        """Masses, contacts and rebound laws at ``x``, shape (2n,), with other parameters."""

    def sizes(self, x: Vector, s: float = 0.0, /) -> Vector:
        """What ``x``, shape (2n,), is rounded against ``s`` seconds after a start, (2n,)."""

    def kinetic(self, x: Array, /) -> Array:
        """Kinetic energies of states (..., 2n), shape (...), J."""

    def distance(self, x: Array, error: Array, /) -> Array:
        """V of differences (dq, du) to states ``x``, shape (..., 2n): shape (...), J."""


@singledispatch
def mechanism_of(system: Multibody) -> Mechanism:
    """The mechanism of a ``system``; each kind of system registers its own.

    Raises:
        UsageError: there is none for this kind.
    """
    kind = type(system).__name__
    raise UsageError(f"mechanism: {kind} found; expected a System, or the system of a model file")


@singledispatch
def mechanism_near(family: ParametricFamily, theta: Vector) -> Mechanism:
    """The mechanism of a ``family``'s system with parameters ``theta``, shape (p,)."""
    raise UsageError(f"mechanism: {type(family).__name__}, {theta} found; expected a family")
