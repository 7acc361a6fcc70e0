# Copyright 2026 impact_observer developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Exact flow of a linear phase ``M du/dt = -C u - K q + f(t)``, ``dq/dt = u``.

Two ways lead to it, both in the kernel. ``SpectralFlow`` splits the motion into ``n`` pairs of
modes, each in closed form. ``SeriesFlow`` goes on in strides, by Taylor polynomials: where that
splitting is ill-conditioned (eigenvectors of a non-proportionally damped system that almost
coincide), and under a sampled forcing.
"""

from abc import ABC, abstractmethod
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from impact_observer.dynamics.flow.few import Factor
from impact_observer.dynamics.flow.reduced_coordinates import ReducedCoordinates
from impact_observer.kernel import Guards, PhaseMotion
from impact_observer.model import Forcing
from impact_observer.states import Matrix, Vector

Complex = NDArray[np.complex128]


class Equations(Protocol):
    """What a flow is made from: a ``System``, or one reduced to fewer coordinates.

    ``M`` symmetric positive definite, ``K`` symmetric positive semidefinite, the symmetric part
    of ``C`` positive semidefinite, shape (n, n) each; SI units.
    """

    @property
    def n(self) -> int:
        """Number of coordinates, at least one."""

    @property
    def M(self) -> Matrix:  # noqa: N802
        """Mass matrix."""

    @property
    def C(self) -> Matrix:  # noqa: N802
        """Damping matrix."""

    @property
    def K(self) -> Matrix:  # noqa: N802
        """Stiffness matrix."""

    @property
    def forcing(self) -> Forcing:
        """``f(t)``, on all coordinates of the frame."""


def state_matrix(system: Equations) -> Matrix:
    """``A`` of ``dx/dt = A x + b(t)``, ``x = (q, u)``, shape (2n, 2n)."""
    n = system.n
    A = np.zeros((2 * n, 2 * n))
    A[:n, n:] = np.eye(n)
    A[n:, :n] = -linalg.solve(system.M, system.K, assume_a="pos")
    A[n:, n:] = -linalg.solve(system.M, system.C, assume_a="pos")
    return A


def balanced(A: Matrix) -> tuple[Matrix, Vector]:
    """The state matrix of ``x unit``, positions counted in units of velocity, and ``unit``.

    Then its entries are rates, and its norm is about the fastest: a matrix exponential needs no
    more squarings than the motion has oscillations. Shapes (2n, 2n) and (2n,).
    """
    n = len(A) // 2
    rate = max(np.sqrt(np.linalg.norm(A[n:, :n], 1)), np.linalg.norm(A[n:, n:], 1)) or 1.0
    unit = np.concatenate([np.full(n, rate), np.ones(n)])
    return np.asarray(unit[:, None] * A / unit), unit


class Motion(Protocol):
    """One solution of a linear phase, from its initial state.

    Attributes:
        t: when the phase starts, s since the epoch.
    """

    t: float

    @abstractmethod
    def states(self, s: NDArray[np.float64], /) -> NDArray[np.float64]:
        """States at ``s`` seconds after the phase's start.

        Args:
            s: shape (samples,), s.

        Returns:
            States (q, u), shape (samples, 2n).
        """

    def state(self, s: float, /) -> Vector:
        """The state (q, u), shape (2n,), at ``s`` seconds after the phase's start."""
        return np.asarray(self.states(np.array([s]))[0])


class PhaseFrame(NamedTuple):
    """Where the coordinates of a phase lie in which contacts are held or fixed.

    Attributes:
        free: those that are free.
        inverse: free coordinates of the nearest motion, shape (r, n).
        held: the part of ``p`` that does not move, shape (n, n), or empty where all moves.
        Q: ``dq/dt = Q u``, shape (n, n), or empty where ``p`` is ``q``.
        rest: ``q = Q p + rest``, shape (n,), m, or empty.
    """

    free: ReducedCoordinates
    inverse: Matrix
    held: Matrix
    Q: Matrix
    rest: Vector


class Flow(ABC):
    """The flow of one linear phase."""

    def __init__(self, system: Equations, frame: PhaseFrame | None) -> None:
        """Take what moves, and the frame in which its coordinates lie; None where all move."""
        self._system, self._frame = system, frame

    @abstractmethod
    def start(self, t: float, x: Vector) -> PhaseMotion:
        """The motion through state ``x`` = (q, u), shape (2n,), at ``t`` s since the epoch.

        Raises:
            DynamicsError: there is no sample of the forcing at ``t``; so also where states are
                asked for beyond the samples.
        """

    @abstractmethod
    def guards(self, rows: Matrix, waves: Matrix, force: Matrix) -> Guards:
        """Functions ``rows x + waves (1, cos, sin) + force f_sampled`` of this flow's motions.

        Args:
            rows: shape (w, 2n).
            waves: of 1 and of the forcing's harmonics, shape (w, 1 + 2h).
            force: of its samples, shape (w, n).
        """

    def transition(self, s: float) -> Matrix:
        """Propagate the difference of two motions by ``s`` seconds, which may be negative.

        Returns:
            ``e^{As}``, shape (2n, 2n).
        """
        found = self.moving(s)
        if self._frame is not None and self._frame.held.size:
            n, held = len(found) // 2, self._frame.held
            found[:, :n] -= found[:, :n] @ held
            found[:n, :n] += held
        if self._frame is not None and self._frame.Q.size:
            Q = self._frame.Q
            found[: len(Q)] = Q @ found[: len(Q)]
        return found

    @abstractmethod
    def moving(self, s: float) -> Matrix:
        """``transition`` without what is at rest."""

    def _pushed(self, forces: Matrix) -> Matrix:
        """Accelerations of the coordinates, shape (r, k), by forces, shape (n, k)."""
        if self._frame is not None:
            forces = self._frame.free.seen(forces)
        return self._accelerated(forces)

    def _accelerated(self, forces: Matrix) -> Matrix:
        """``M^-1 forces``, shape (r, k)."""
        return self._inertia.solution(forces) if forces.size else forces

    @cached_property
    def _inertia(self) -> Factor:
        return Factor(self._system.M)

    def _seen(self, rows: Matrix, time: float) -> tuple[Matrix, Matrix, Matrix]:
        """Rows of ``q``, rows of the free coordinates, and what these are rounded against.

        By all that moves, also by what pulls at it within the ``time`` scale, s: a body may rest
        while others move.

        Args:
            rows: of states, shape (w, 2n).
            time: inverse of the fastest rate, s.
        """
        position, velocity = np.split(rows, 2, axis=1)
        q, u = position.T, velocity.T
        if self._frame is not None:
            q, u = self._frame.free.seen(q), self._frame.free.seen(u)
        pulls = np.hstack([self._system.K, self._system.C])
        pulled = time**2 / 2 * np.abs(self._accelerated(q).T @ pulls)
        pulled += time * np.abs(self._accelerated(u).T @ pulls)
        rows = np.hstack([q.T, u.T])
        return position, rows, np.abs(rows) + pulled

    def transitions(self, s: Vector) -> NDArray[np.float64]:
        """``transition`` by each of ``s`` seconds, shape (2n, samples, 2n)."""
        return np.stack([self.transition(at) for at in s.tolist()], axis=1)

    def moved(self, motion: Motion, s: float) -> tuple[Vector, Matrix]:
        """``state`` of a motion of this flow, equal to the bit, and ``transition`` after ``s``."""
        return motion.state(s), self.transition(s)
