# SPDX-License-Identifier: Apache-2.0
"""Exact flow of a linear phase ``M du/dt = -C u - K q + f(t)``, ``dq/dt = u``.

The kernel has two methods. ``spectral.py`` splits the motion into ``n`` pairs of modes, each in
closed form. ``strides.py`` computes the motion in strides by Taylor polynomials. Strides are used
under a sampled forcing, and if the splitting is ill-conditioned: if eigenvectors of a
non-proportionally damped system almost coincide.
"""

from abc import abstractmethod
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from impact_observer.dynamics.flow.equations import Equations
from impact_observer.dynamics.flow.few import Factor
from impact_observer.dynamics.flow.modes import Modes, split
from impact_observer.dynamics.flow.reduced_coordinates import PhaseFrame
from impact_observer.dynamics.flow.spectral import closed_form
from impact_observer.dynamics.flow.strides import forces_of
from impact_observer.kernel import Guards, ModalFlow, PhaseMotion, SeriesFlow
from impact_observer.model.angles import Angles
from impact_observer.states import Matrix, Vector


class Motion(Protocol):
    """One solution of a linear phase, from its initial state.

    Attributes:
        t: start of the phase, s since the epoch.
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


class Flow:
    """The flow of one linear phase.

    Attributes:
        modes: the modes of the phase.
    """

    def __init__(
        self,
        system: Equations,
        modes: Modes,
        frame: PhaseFrame | None = None,
        *,
        strides: bool = False,
    ) -> None:
        """Prepare the constants of all motions.

        Args:
            system: the equations of motion.
            modes: the splitting of ``system``.
            frame: the coordinates of the phase; None if no contact is held or fixed.
            strides: whether strides also replace a closed form.
        """
        self._system, self._frame, self.modes = system, frame, modes
        forcing = system.forcing
        self._rate = max(modes.fastest, *forcing.frequency, 0.0)
        harmonics = forcing.frequency, Angles(forcing.frequency).turns
        given = modes.coordinates(frame), harmonics
        load = self._load(np.vstack([forcing.constant, forcing.cosine, forcing.sine]).T)
        self._modal = closed_form(modes, *given, load, self._rate) if modes.are_pairs else None
        self._kernel: ModalFlow | SeriesFlow
        if self._modal is not None and not strides and forcing.sampled is None:
            self._kernel = self._modal
            return
        samples, self._active = forces_of(forcing)
        J = modes.J.reshape(len(load), modes.J.shape[-1])
        push = self._load(np.eye(len(forcing.constant))[:, self._active])
        self._kernel = SeriesFlow(given[0], J, given[1], load, push, samples, self._rate)

    @property
    def is_in_closed_form(self) -> bool:
        """Whether motions are computed in closed form and not in strides."""
        return self._kernel is self._modal

    def start(self, t: float, x: Vector) -> PhaseMotion:
        """The motion through state ``x`` = (q, u), shape (2n,), at ``t`` s since the epoch.

        Raises:
            DynamicsError: the forcing has no sample at ``t``. States beyond the samples raise the
                same error.
        """
        return self._kernel.start(t, x)

    def guards(self, rows: Matrix, waves: Matrix, force: Matrix) -> Guards:
        """Functions ``rows x + waves (1, cos, sin) + force f_sampled`` of this flow's motions.

        The scale of rounding of each function counts the motion of all coordinates, and the motion
        by all forces within the inverse of the fastest rate: a body may rest while others move.

        Args:
            rows: shape (w, 2n).
            waves: factors of 1 and of the harmonics of the forcing, shape (w, 1 + 2h).
            force: factors of the sampled forces, shape (w, n).
        """
        position, velocity = np.split(rows, 2, axis=1)
        q, u, time = position.T, velocity.T, 1 / self._rate if self._rate > 0 else 0.0
        if self._frame is not None:
            q, u = self._frame.free.seen(q), self._frame.free.seen(u)
        pulls = np.hstack([self._system.K, self._system.C])
        pulled = time**2 / 2 * np.abs(self._accelerated(q).T @ pulls)
        pulled += time * np.abs(self._accelerated(u).T @ pulls)
        rows = np.hstack([q.T, u.T])
        given = position, *self.modes.seen(rows, np.abs(rows) + pulled), waves
        strides = isinstance(self._kernel, SeriesFlow)
        pushed = force[:, self._active] if strides else force[:, :0]
        return self._kernel.guards(*given, pushed)

    def transition(self, s: float) -> Matrix:
        """Propagate the difference of two motions by ``s`` seconds, which may be negative.

        Returns:
            ``e^{As}``, shape (2n, 2n).
        """
        transition, frame = self._moving(s), self._frame
        if frame is not None and frame.held.size:
            n = len(frame.held)
            transition[:, :n] -= transition[:, :n] @ frame.held
            transition[:n, :n] += frame.held
        if frame is not None and frame.Q.size:
            transition[: len(frame.Q)] = frame.Q @ transition[: len(frame.Q)]
        return transition

    def _moving(self, s: float) -> Matrix:
        """The part of ``transition`` by the modes: ``T e^{Js} T^{-1}``."""
        if self._modal is not None:
            return np.asarray(self._modal.propagated(s).T.dot(self._inverse))
        T, T_inverse, *_ = self.modes.coordinates(self._frame)
        return np.asarray(T @ linalg.expm(s * self.modes.J[0]) @ T_inverse)

    @cached_property
    def _inverse(self) -> Matrix:
        """``T^{-1}`` for states in ``frame``, shape (2r, 2n)."""
        inverse = self.modes.coordinates(self._frame)[1]
        if not self.modes.proportional:
            return inverse
        r, n = inverse.shape
        whole = np.zeros((2 * r, 2 * n))
        whole[0::2, :n] = whole[1::2, n:] = inverse
        return whole

    def _load(self, forces: Matrix) -> Matrix:
        """Loads of the modes, shape (2r, k), by forces on all coordinates, shape (n, k)."""
        if self._frame is not None:
            forces = self._frame.free.seen(forces)
        pushed = self.modes.pushed(self._accelerated(forces))
        return pushed.reshape(2 * len(pushed), forces.shape[1])

    def _accelerated(self, forces: Matrix) -> Matrix:
        """``M^-1 forces``, shape (r, k)."""
        return self._inertia.solution(forces) if forces.size else forces

    @cached_property
    def _inertia(self) -> Factor:
        return Factor(self._system.M)


def flow_of(
    system: Equations, shapes: Matrix | None = None, frame: PhaseFrame | None = None
) -> Flow:
    """The flow of ``system`` without contact: in closed form if possible.

    Args:
        system: the equations of motion.
        shapes: shapes of the undamped modes by LAPACK, shape (n, n), if available.
        frame: the coordinates of the phase; None if no contact is held or fixed.
    """
    return Flow(system, split(system, shapes), frame)
