# SPDX-License-Identifier: Apache-2.0
"""Moreau's time-stepping scheme with theta = 1/2: impacts without looking for their instants.

Over a step of length ``h``, with ``u_theta = (u + u+) / 2`` and ``q_theta = q + h u_theta / 2``::

    M (u+ - u) + h C u_theta + h K q_theta - h f_theta = W P,    q+ = q + h u_theta
    0 <= gamma+ + eps gamma  _|_  P >= 0    on contacts with    g + h gamma / 2 <= 0

Balance of energy, solution for the impulses ``P`` and sources: ``docs/theory/method.md``.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from impact_observer.dynamics.contact.complementarity import complementary
from impact_observer.errors import ImpactLawError
from impact_observer.model import System
from impact_observer.states import Matrix, Vector

Indices = NDArray[np.intp]

_RESIDUAL = 1e-9
"""Violation of the complementarity that is rounding, relative to the most violated contact."""
_ROUNDING = 1e-9
"""Speed that counts as zero, relative to the terms of its sum."""
_DRIFT = 1e-6
"""Gap that counts as closed, relative to the motion of a step: rounding moves bodies at rest."""
_INSIDE = 1e-12
"""Gap that counts as closed, relative to the terms of its sum."""
_PROJECTIONS = 2000
"""Most projections in a step; only steps far too long for the gyroscopic part need so many."""


@dataclass(frozen=True, slots=True, eq=False)
class TimeStep:
    """One step of the scheme.

    Attributes:
        q: coordinates at its end, shape (n,).
        u: velocities at its end, shape (n,).
        free: the velocities that it would have ended with without impulses, shape (n,).
        impulses: ``P`` of all contacts, shape (m,), Ns.
        closed: indices of the contacts that were hit or held: active ones that approached or
            whose speed is the lowest that the law allows. Their impulse is zero where other
            contacts carry the load.
    """

    q: Vector
    u: Vector
    free: Vector
    impulses: Vector
    closed: tuple[int, ...]


class MoreauScheme:
    """The scheme for one system and one length of step.

    Attributes:
        system: the simulated system.
        h: length of the steps, s.
    """

    def __init__(self, system: System, h: float) -> None:
        """Factorise the iteration matrix for steps of ``h`` > 0 seconds."""
        self.system = system
        self.h = h
        iteration = system.M + h / 2 * system.C + h**2 / 4 * system.K
        n, K = system.n, system.K
        loads = np.hstack([h / 2 * np.eye(n), h * K, h * (system.C + h / 2 * K), system.W])
        response = linalg.solve(iteration, loads)
        self._inverse, self._stiffness, self._damping, self._response = np.split(
            response, [n, 2 * n, 3 * n], axis=1
        )
        self._A = system.W.T @ self._response
        self._reach, self._distance = abs(system.W).T, abs(system.q_r)
        # The end of a step is most often the start of the next.
        self._force = lru_cache(maxsize=2)(system.forcing)
        lower = linalg.cholesky((iteration + iteration.T) / 2, lower=True)
        turning = h / 4 * (system.C - system.C.T)
        seen = linalg.solve_triangular(lower, np.hstack([turning, system.W]), lower=True)
        self._R = linalg.solve_triangular(lower, seen[:, :n].T, lower=True).T
        self._B = seen[:, n:]
        self._relaxation = 1.0 / (1.0 + float(np.linalg.norm(self._R, 2)) ** 2)

    def step(self, k: int, q: Vector, u: Vector) -> TimeStep:
        """Step number ``k``, from ``k h`` to ``(k + 1) h`` seconds since the epoch.

        The step begins with ``q`` (m) and ``u`` (m/s), shape (n,) each.

        Raises:
            ImpactLawError: the law has no solution on the active contacts.
            DynamicsError: the step begins before the first sample of the forcing.
        """
        system, h = self.system, self.h
        force = self._force(k * h) + self._force((k + 1) * h)
        free = u - self._stiffness @ q - self._damping @ u + self._inverse @ force
        gamma = u @ system.W
        predicted = q @ system.W + system.q_r + h / 2 * gamma
        motion = self._reach @ (abs(u) + abs(free))
        size = self._distance + self._reach @ abs(q)
        active = np.flatnonzero(predicted <= _DRIFT * h * motion + _INSIDE * size)
        impulses, after = np.zeros(system.m), free
        if not active.size:
            return TimeStep(q + h / 2 * (u + free), free, free, impulses, ())
        rounding = _ROUNDING * motion
        rebound = system.rebound(gamma)
        lacking = -(system.W.T @ free + rebound)
        lacking[np.abs(lacking) <= rounding] = 0.0  # a body beside its stop is not pressed
        if np.any(lacking[active] > 0):
            impulses[active] = self._impulses(k, gamma, active, lacking[active])
            after = free + self._response @ impulses
        spare = system.W.T @ after + rebound
        closed = (gamma < -rounding) | (spare <= 2 * rounding)
        which = tuple(active[closed[active]].tolist())
        return TimeStep(q + h / 2 * (u + after), after, free, impulses, which)

    def _impulses(self, k: int, gamma: Vector, active: Indices, lacking: Vector) -> Vector:
        """``P`` of the active contacts: ``0 <= A P - lacking _|_ P >= 0``."""
        A = self._A[np.ix_(active, active)]
        if active.size == 1:
            return np.asarray(np.maximum(lacking / A[0], 0.0))
        length = np.sqrt(np.diag(A))
        scale = float(np.max(lacking / length))
        A, d = A / np.outer(length, length), lacking / (length * scale)
        for impulses in self._candidates(A, self._B[:, active] / length, d):
            # Both are nonnegative, and one of the two is zero.
            if np.all(np.abs(np.minimum(impulses, A @ impulses - d)) <= _RESIDUAL):
                return np.asarray(np.maximum(impulses, 0.0) * (scale / length))
        raise ImpactLawError.for_contacts(
            [self.system.contact_names[i] for i in active],
            f"the step at t = {k * self.h:.9f} s finds no impulses",
            gamma[active],
            self.system.eps[active],
            remedy=", or take a shorter step",
        )

    def _candidates(self, A: Matrix, B: Matrix, d: Vector) -> Iterator[Vector]:
        """Impulses after each projection; first from the equations of contacts that press."""
        jump = np.zeros(len(B))
        for _ in range(_PROJECTIONS):
            start = jump - self._relaxation * (jump + self._R @ jump)
            multipliers = complementary(B, B.T @ start - d)
            if multipliers is None:
                return
            pressed = multipliers > 0
            impulses = np.zeros(d.size)
            impulses[pressed] = linalg.lstsq(A[np.ix_(pressed, pressed)], d[pressed])[0]
            yield impulses
            yield multipliers / self._relaxation
            if self._relaxation == 1.0:
                return
            jump = start + B @ multipliers
