# SPDX-License-Identifier: Apache-2.0
"""Newton's impact law on any set of contacts at once.

``0 <= gamma+ + eps gamma-  _|_  Lambda >= 0`` with ``u+ = u- + M^-1 W Lambda``: a linear
complementarity problem ``0 <= G Lambda + b _|_ Lambda >= 0`` in ``G = W^T M^-1 W = B^T B``,
``B = L^-1 W``, ``M = L L^T``. Contacts with another law than a constant ``eps`` have their
``r(gamma-)`` in the place of ``eps gamma-``; see ``model.rebounds``.
"""

from collections.abc import Sequence
from functools import cached_property, lru_cache

import numpy as np
from scipy import linalg

from impact_observer.dynamics.contact.complementarity import complementary
from impact_observer.dynamics.contact.projection import KEPT
from impact_observer.dynamics.equations import Factor
from impact_observer.errors import ImpactLawError
from impact_observer.events import Contacts
from impact_observer.model import System
from impact_observer.model.rebounds import ReboundLaw
from impact_observer.model.rebounds.constant_restitution import ConstantRestitution
from impact_observer.states import Matrix, Vector

_ROUNDING = 1e-12
"""Contact speed that counts as zero, relative to that of all kinetic energy in it."""
_NOISE = 1e-14
"""Contact speed of several contacts that is rounding, relative to the same."""
_EIGENVALUE = 1e-12
"""Negative eigenvalue of ``G - E G E`` that is rounding, ``G`` having a unit diagonal."""
_REPEATS = 64
"""Repetitions of the impact law on persistent contacts before a plastic impact ends them."""


class ImpactLaw:
    """Newton's impact law of one system.

    Attributes:
        system: the system.
    """

    def __init__(self, system: System, restitution: Vector | None = None) -> None:
        """Prepare the law; ``restitution``, shape (m,), is used instead of the system's."""
        factor = Factor(system.M)
        self.system = system
        self._laws: tuple[ReboundLaw, ...] = system.rebounds
        self._special, self._eps = system.special, system.eps
        if restitution is not None:
            self._laws = tuple(map(ConstantRestitution, restitution.tolist()))
            self._special, self._eps = frozenset(), restitution
        self._B = factor.solved(system.W)
        self._Minv_W = factor.solved_transposed(self._B)
        # Nearly every event has a single contact: u+ = u- - kick gamma.
        self._stopped = (self._Minv_W / np.sum(self._B**2, axis=0)).T
        self._kicks = self._stopped * (1.0 + self._eps)[:, None]
        self.is_nonexpansive = lru_cache(KEPT)(self._is_nonexpansive)

    @cached_property
    def plastic(self) -> "ImpactLaw":
        """The same law without restitution."""
        return ImpactLaw(self.system, np.zeros(self.system.m))

    def velocity_after(self, u: Vector, active: Sequence[int]) -> Vector:
        """Velocities ``u+`` after an impact on the ``active`` contacts, shape (..., n), m/s.

        The result equals ``u`` if all active contacts separate already. The bits of one state do
        not depend on the others.

        Raises:
            ImpactLawError: the law has no solution on these contacts.
        """
        if len(active) == 1:
            i = active[0]
            gamma = u[..., None, :] @ self.system.W[:, i]  # (..., 1), one product a state
            if i in self._special:
                lost = np.minimum(gamma + self._laws[i].rebound(gamma), 0.0)
                return np.asarray(u - lost * self._stopped[i])
            return np.asarray(u - np.minimum(gamma, 0.0) * self._kicks[i])
        if u.ndim > 1:
            return np.asarray(np.apply_along_axis(self.velocity_after, -1, u, active))
        return np.asarray(u + self._Minv_W[:, list(active)] @ self.impulses(u, active))

    def velocity_held(self, u: Vector, active: Sequence[int], closed: Sequence[int]) -> Vector:
        """Velocities ``u+`` where the contacts ``closed``, a part of ``active``, stay closed.

        Newton's law allows ``gamma+ < 0`` where ``gamma- > 0`` (a replica's contact that was
        separating): such a contact hits again, at once. Repetitions that do not end are ended by a
        plastic impact. Every repetition is the impact law, so what is proved of one impact holds
        for all of them.

        Returns:
            Shape (..., n), m/s, with ``gamma+ >= 0`` on ``closed`` but for rounding.

        Raises:
            ImpactLawError: the law has no solution on these contacts.
        """
        if not closed:
            return self.velocity_after(u, active)
        if u.ndim > 1:
            return np.asarray(np.apply_along_axis(self.velocity_held, -1, u, active, closed))
        after = self.velocity_after(u, active)
        contacts, speed = list(closed), np.sqrt(u @ self.system.M @ u)
        W, length = self.system.W[:, contacts], np.linalg.norm(self._B[:, contacts], axis=0)
        for _ in range(_REPEATS):
            if np.all(W.T @ after >= -_ROUNDING * speed * length):
                return after
            after = self.velocity_after(after, closed)
        return self.plastic.velocity_after(after, closed)

    def pressed(self, active: Sequence[int], hit: Sequence[int], gamma: Vector) -> Contacts:
        """The contacts that take an impulse in an impact of the plant, as sorted indices.

        The plant closed the contacts ``hit`` of all ``active`` ones, whatever an estimate says of
        their speeds ``gamma``, shape (len(hit),), m/s: of a wrong sign they count as if they had
        the other. Those of ``active`` that were closed before had none.

        Raises:
            ImpactLawError: the law has no solution on these contacts.
        """
        if len(active) == 1:
            return tuple(hit)
        towards = -np.abs(gamma) if np.any(gamma) else -np.ones(len(hit))
        closing = dict(zip(hit, towards, strict=True))
        speeds = np.array([closing.get(i, 0.0) for i in active])
        impulses = self._impulses(list(active), speeds)
        return tuple(i for i, impulse in zip(active, impulses, strict=True) if impulse > 0)

    def stops(self, pressed: Sequence[int]) -> Matrix:
        """``X`` of ``u+ = u- - X gamma-``, which stops the contacts ``pressed``, shape (n, k)."""
        P = list(pressed)
        G = self._B[:, P].T @ self._B[:, P]
        return np.asarray(self._Minv_W[:, P] @ linalg.pinvh(G))

    def _is_nonexpansive(self, active: Contacts) -> bool:
        """Whether ``G - E G E >= 0`` on ``active``: then neither they nor some of them raise V.

        Where the slope of a rebound law is not constant, this is known for a single contact only.
        """
        A = list(active)
        if not all(self._laws[i].is_affine for i in A):
            return len(A) == 1 and self._laws[A[0]].is_nonexpansive
        B, eps = self._B[:, A] / np.linalg.norm(self._B[:, A], axis=0), self._eps[A]
        if np.all(eps == eps[:1]):
            return True
        G = B.T @ B
        return bool(linalg.eigvalsh(G - np.outer(eps, eps) * G)[0] >= -_EIGENVALUE)

    def impulses(self, u: Vector, active: Sequence[int]) -> Vector:
        """Impulses ``Lambda >= 0`` on the ``active`` contacts, shape (len(active),), Ns.

        Raises:
            ImpactLawError: the law has no solution on these contacts.
        """
        active = list(active)
        gamma = self.system.W[:, active].T @ u
        # The rounding errors of dependent contacts need not be consistent.
        noise = (
            _NOISE * np.sqrt(u @ self.system.M @ u) * np.linalg.norm(self._B[:, active], axis=0)
        )
        gamma[np.abs(gamma) <= noise] = 0.0
        return self._impulses(active, gamma)

    def _impulses(self, active: list[int], gamma: Vector) -> Vector:
        eps = self._eps[active]
        lost = (1.0 + eps) * gamma
        for k, i in enumerate(active):
            if i in self._special:
                lost[k] = gamma[k] + self._laws[i].rebound(gamma[k])
        impulses = complementary(self._B[:, active], lost)
        if impulses is None:
            names = [self.system.contact_names[i] for i in active]
            raise ImpactLawError.for_contacts(
                names, "Newton's impact law has no solution", gamma, eps
            )
        return impulses
