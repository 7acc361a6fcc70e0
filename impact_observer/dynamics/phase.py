# SPDX-License-Identifier: Apache-2.0
"""A linear phase: the motion while the same contacts are held.

Contacts ``held`` have ``gamma = 0`` by a load ``lambda``. The geometric law keeps the gaps of all
contacts with ``chi = 1`` closed, held or slipping: the contacts ``fixed``, which move by
equation (4) of Baumann and Leine, ``dq/dt = Q u`` with ``Q = I - Z W_A^T`` (``projection.py``).
The substitution ::

    dp/dt = u,    q = Q p - Z q_r,A

turns the equations into those of a mechanical system,
``M du/dt = -C u - Q^T K Q p + f + K Z q_r,A + W_H lambda``, of stiffness ``Q^T K Q``. So every
phase is a linear system in ``p``, and its velocities stay in the null space of ``W_H^T``. The
system is reduced to the free coordinates of this null space and has an exact flow. Without fixed
contacts, ``p = q``.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from impact_observer.dynamics.contact.projection import KEPT, PositionProjection
from impact_observer.dynamics.equations import Equations, Factor
from impact_observer.dynamics.flow import Flow, PhaseMotion, rate_of
from impact_observer.dynamics.scales import Scales
from impact_observer.model import Forcing, System
from impact_observer.states import Matrix, Vector, frozen

RANK = 1e-8
"""Part of a direction orthogonal to others that counts as zero, relative to its length."""
_ROUNDING = 1e-12
"""Contact speed that counts as zero, over the speed if it had all kinetic energy."""
_CANCELLED = 1e-14
"""Stiffness that counts as zero in a reduced system, relative to the whole one's, times n."""


@dataclass(frozen=True, slots=True, eq=False)
class Reduced:
    """Equations of motion in fewer coordinates; see ``Equations``."""

    M: Matrix
    C: Matrix
    K: Matrix
    forcing: Forcing

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return len(self.M)


class Unloaded(NamedTuple):
    """The motion of a system in the coordinates ``p`` without loads of contacts.

    Attributes:
        equations: equations of motion of ``p``.
        Q: ``dq/dt = Q u``, shape (n, n).
        rest: ``q = Q p + rest``, shape (n,), m.
        load: bound of ``sqrt(f^(k)^T M^-1 f^(k))``; see ``Forcing.bound``.
        scales: scales of the equations.
    """

    equations: Equations
    Q: Matrix
    rest: Vector
    load: Callable[[int, Vector], Vector]
    scales: Scales


@dataclass(frozen=True, slots=True, eq=False)
class Phase:
    """One linear phase of a system, in the coordinates ``p``.

    Attributes:
        held: contacts with ``gamma = 0``, independent of each other, as indices.
        fixed: contacts whose gaps stay closed, held or slipping, as indices.
        equations: equations of motion of ``p`` without the loads of the held contacts.
        inverse: ``M^-1`` restricted to motions that the held contacts allow, shape (n, n).
        loads: ``lambda = -loads (f - C u - K p)``, shape (len(held), n).
        flow: flow of states (q, u) that begin with ``p = q``.
        Q: ``dq/dt = Q u``, shape (n, n).
        rest: ``q = Q p + rest``, shape (n,), m.
    """

    held: tuple[int, ...]
    fixed: tuple[int, ...]
    equations: Equations
    inverse: Matrix
    loads: Matrix
    flow: Flow
    Q: Matrix
    rest: Vector

    def start(self, t: float, x: Vector) -> PhaseMotion:
        """The motion through ``x`` = (q, u), shape (2n,), at ``t`` s since the epoch."""
        return self.flow.start(t, x)

    def transition(self, s: float) -> Matrix:
        """Propagation of the difference of two states (q, u) by ``s`` seconds, shape (2n, 2n)."""
        return self.flow.transition(s)

    def transitions(self, s: Vector) -> NDArray[np.float64]:
        """``transition`` by many times, shape (K,), s: shape (K, 2n, 2n)."""
        return self.flow.transitions(s)


class Phases:
    """All phases of one system, each prepared when first needed.

    Attributes:
        system: the system.
        projection: the position jumps of the system.
        B: ``L^-1 W``, ``M = L L^T``: ``B^T B = G``, shape (n, m).
        length: lengths of the columns of ``B``, shape (m,).
        inertia: ``M u`` as a function of ``u``.
        scales: scales of the system without held or fixed contacts.
    """

    def __init__(self, system: System) -> None:
        """Factorise the mass matrix."""
        self.system = system
        self._factor = Factor(system.M)
        self.inertia = system.M.dot
        self.B = frozen(self.white(system.W))
        self.length = frozen(np.linalg.norm(self.B, axis=0))
        self._inverse = self._left(np.eye(system.n))
        self._prepared = lru_cache(KEPT)(self._prepare)
        self._laws = lru_cache(KEPT)(self._unloaded)
        self.scales = self.unloaded().scales
        self.projection = PositionProjection(system, (self.scales.squares, self.scales.shapes))

    def phase(self, held: tuple[int, ...] = (), fixed: tuple[int, ...] = ()) -> Phase:
        """The phase in which ``held`` contacts, independent of each other, take loads.

        If the held contacts determine the gaps of all ``fixed`` contacts, no fixed contact slips,
        and the phase is the phase without ``fixed``.
        """
        return self._prepared(held, fixed)

    def independent(
        self, contacts: tuple[int, ...], fixed: tuple[int, ...] = ()
    ) -> tuple[int, ...]:
        """The ``contacts`` whose directions are independent of ``fixed`` and of earlier ones."""
        return independent(self.B, self.length, contacts, fixed)

    def white(self, loads: Matrix) -> Matrix:
        """``L^-1 loads``, ``M = L L^T``: accelerations in coordinates with unit mass matrix."""
        return self._factor.solved(loads)

    def unwhite(self, accelerations: Matrix) -> Matrix:
        """``L^-T accelerations``: the inverse of ``white``, in the system's coordinates."""
        return self._factor.solved_transposed(accelerations)

    def stopped(
        self, x: Vector, contacts: tuple[int, ...], projection: PositionProjection | None = None
    ) -> Vector:
        """The state (q, u) nearest to ``x`` with ``g = 0`` and ``gamma = 0`` on ``contacts``.

        The distance is elastic energy for positions and kinetic energy for velocities.

        Args:
            x: state (q, u), shape (2n,).
            contacts: indices.
            projection: position jumps of a system with other gaps; None for this system.
        """
        n = self.system.n
        basis = orthonormal(self.B[:, list(self.independent(contacts))])
        velocity = self._factor.lower.T.dot(x[n:])
        velocity -= basis @ (basis.T @ velocity)
        position = (projection or self.projection).position_after(x[:n], contacts)
        return np.concatenate([position, self.unwhite(velocity)])

    def speed_tolerance(self, u: Vector) -> Vector:
        """Contact speeds that count as zero at velocities ``u``, shape (m,), m/s.

        The tolerance is relative to all velocities, as impulses spread rounding errors over all
        bodies.
        """
        return np.asarray(_ROUNDING * self.length * np.sqrt(u.dot(self.inertia(u))))

    def unloaded(self, fixed: tuple[int, ...] = ()) -> "Unloaded":
        """The equations of motion while the gaps of ``fixed`` stay closed and nothing is held."""
        return self._laws(fixed)

    def free(self, law: "Unloaded", t: float, motion: Sequence[Vector]) -> tuple[Vector, float]:
        """The next derivative of a motion without loads, and the size of the largest term.

        The derivative has shape (n,) and unit mass matrix, as by ``white``.

        Args:
            law: equations of the motion.
            t: s since the epoch.
            motion: ``p`` and its derivatives up to the last one, shape (n,) each.
        """
        k, at = len(motion) - 2, np.array([t])
        force = law.equations.forcing.derivatives(at, k)[k, 0]
        C, K = law.equations.C, law.equations.K
        terms = self.white(np.array([force, C.dot(motion[-1]), K.dot(motion[-2])]).T)
        size = np.sqrt(np.einsum("ij,ij->j", terms, terms).max())
        return terms[:, 0] - terms[:, 1] - terms[:, 2], max(float(size), float(law.load(k, at)[0]))

    def _unloaded(self, fixed: tuple[int, ...]) -> "Unloaded":
        system = self.system
        equations: Equations = system
        Q, rest = np.eye(system.n), np.zeros(system.n)
        if fixed:
            Z, contacts = self.projection.jump(fixed), list(fixed)
            W, q_r = system.W[:, contacts], system.q_r[contacts]
            Q, rest = Q - Z @ W.T, -Z @ q_r
            forcing = equations.forcing.plus(system.K @ Z @ q_r)
            whole = float(np.linalg.norm(self.scales.squares))
            stiffness = self._cleaned(_symmetric(Q.T @ system.K @ Q), np.diag(system.M), whole)
            equations = Reduced(system.M, system.C, stiffness, forcing)
        load = equations.forcing.bound(self._inverse)
        return Unloaded(equations, frozen(Q), frozen(rest), load, Scales.of_equations(equations))

    def _prepare(self, held: tuple[int, ...], fixed: tuple[int, ...]) -> Phase:
        if fixed and not self.independent(fixed, held):
            return self.phase(held)
        p = len(held)
        free = self.unloaded(fixed)
        orthogonal, triangular = np.linalg.qr(self.B[:, list(held)], mode="complete")
        pressing = self.unwhite(orthogonal[:, :p])
        return Phase(
            held=held,
            fixed=fixed,
            equations=free.equations,
            inverse=self._left(orthogonal[:, p:]) if p else self._inverse,
            loads=frozen(
                # scipy before 1.14 refuses empty systems
                linalg.solve_triangular(triangular[:p], pressing.T) if p else pressing.T
            ),
            flow=self._flow(held, free, is_fixed=bool(fixed)),
            Q=free.Q,
            rest=free.rest,
        )

    def _flow(self, held: tuple[int, ...], free: Unloaded, *, is_fixed: bool) -> Flow:
        """The flow of the motion ``free`` on which ``held`` contacts have loads."""
        W = self.system.W[:, list(held)]
        rate = rate_of(free.scales.fastest, self._damping)
        if is_fixed:
            return Flow(free.equations, rate, W, free.Q, free.rest)
        return Flow(free.equations, rate, W)

    def _left(self, orthogonal: Matrix) -> Matrix:
        """``M^-1`` restricted to motions along ``orthogonal``."""
        shapes = self.unwhite(orthogonal)
        return frozen(shapes @ shapes.T)

    @cached_property
    def _damping(self) -> float:
        """Size of ``L^-1 C L^-T``, 1/s."""
        return float(np.linalg.norm(self.white(self.white(self.system.C).T), 2))

    def _cleaned(self, restricted: Matrix, mass: Vector, whole: float) -> Matrix:
        """A restricted matrix with exact zeros where only rounding is left.

        Args:
            restricted: shape (r, r).
            mass: diagonal of the mass matrix, shape (r,), kg.
            whole: size of the whole matrix over mass.
        """
        size = np.sqrt(mass)
        nothing = _CANCELLED * self.system.n * whole * np.outer(size, size)
        return np.where(np.abs(restricted) <= nothing, 0.0, restricted)


def independent(
    B: Matrix, length: Vector, contacts: tuple[int, ...], fixed: tuple[int, ...] = ()
) -> tuple[int, ...]:
    """The ``contacts`` whose directions are independent of ``fixed`` and of earlier ones.

    Directions are columns of ``B``, shape (n, m), with lengths of shape (m,).
    """
    if len(contacts) < 2 and not fixed:
        return contacts
    chosen: list[int] = []
    basis = np.empty((len(B), 0))
    for k, i in enumerate((*fixed, *contacts)):
        if basis.shape[1] == len(B):
            break
        left = without(basis, B[:, i])
        size = np.linalg.norm(left)
        if size > RANK * length[i]:
            basis = np.column_stack([basis, left / size])
            if k >= len(fixed):
                chosen.append(i)
    return tuple(chosen)


def _symmetric(matrix: Matrix) -> Matrix:
    return np.asarray((matrix + matrix.T) / 2)


def orthonormal(vectors: Matrix) -> Matrix:
    """An orthonormal basis of the span of independent ``vectors``, shape (n, k)."""
    if vectors.shape[1] < 2:  # nearly always
        return np.asarray(vectors / np.linalg.norm(vectors, axis=0))
    return np.linalg.qr(vectors)[0]


def without(basis: Matrix, vectors: Matrix) -> Matrix:
    """``vectors`` without their parts in ``basis``, subtracted twice against rounding."""
    once = vectors - basis @ (basis.T @ vectors)
    return np.asarray(once - basis @ (basis.T @ once))
