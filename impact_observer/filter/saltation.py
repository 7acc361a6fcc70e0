# SPDX-License-Identifier: Apache-2.0
"""Two phases and the jump between them as functions of a state and of when the jump is.

A plant jumps ``e`` seconds before an instant at which its state would be ``y`` without the jump.
The guard at the jump, and the state at that instant after the jump, are functions of ``(e, y)``.
Here are their expansions about ``e = 0``: linear in ``y``, of second order in ``e``.

For ``x+ = J x-`` the first order in ``e`` is ``f+ - J f-``, the rates ``f = dx/dt`` before and
after. With ``e = g / gamma`` from the gap this is the saltation matrix (Kong, Payne, Zhu and
Johnson, Saltation matrices, 2023), but regular where ``gamma`` is zero.
"""

from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import linalg

from impact_observer.dynamics.equations import Equations
from impact_observer.dynamics.phase import Phase
from impact_observer.events import Contacts
from impact_observer.kernel._kernel import TINY
from impact_observer.model import System
from impact_observer.model.parametric_family import Coefficients
from impact_observer.states import Matrix, Vector

ROUNDING = 4 * float(np.finfo(np.float64).eps)
"""Rounding of a measurement, relative to the terms of its sum."""
STATE_ROUNDING = float(np.finfo(np.float64).eps)
"""Rounding of a state, relative to ``Scales.sizes``."""


class FreePhase(NamedTuple):
    """What a ``Phase`` is without its flow, of a system while no contact is closed."""

    equations: Equations
    inverse: Matrix


class StateRates:
    """``dx/dt = A x + B f(t)`` of one phase with nothing fixed.

    Attributes:
        A: shape (2n, 2n).
        B: shape (2n, n).
    """

    def __init__(self, phase: Phase | FreePhase) -> None:
        """Write the phase as a system of first order."""
        n, equations = phase.equations.n, phase.equations
        inverse = phase.inverse
        self.A = np.zeros((2 * n, 2 * n))
        self.A[:n, n:] = np.eye(n)
        self.A[n:, :n] = -inverse @ equations.K
        self.A[n:, n:] = -inverse @ equations.C
        self.B = np.vstack([np.zeros((n, n)), inverse])

    @cached_property
    def decay(self) -> float:
        """Of the fastest fading motion, 1/s."""
        return max(0.0, -float(np.min(np.linalg.eigvals(self.A).real)))

    def along(self, x: Vector, forces: Matrix) -> tuple[Vector, Vector]:
        """``dx/dt`` and its derivative by time, (2n,) each; ``forces`` are f, df/dt, ..."""
        first: Vector = self.A.dot(x) + self.B.dot(forces[0])
        second: Vector = self.A.dot(first) + self.B.dot(forces[1])
        return first, second


class Expansion(NamedTuple):
    """``value + slope e + linear dy + e D dy + 1/2 E e^2`` of a function of ``(e, y + dy)``.

    Attributes:
        value: shape (k,).
        H: slope, then linear: shape (k, 1 + 2n).
        D: shape (k, 2n).
        E: shape (k,).
    """

    value: Vector
    H: Matrix
    D: Matrix
    E: Vector


class Measured(NamedTuple):
    """Guard functions ``c x + rest - load f(t)``: zero when a contact switches.

    Attributes:
        c: shape (k, 2n).
        rest: shape (k,).
        load: shape (k, n); None for zero.
    """

    c: Matrix
    rest: Vector
    load: Matrix | None = None

    @classmethod
    def gaps(cls, system: System, contacts: Contacts) -> "Measured":
        """The gaps of ``contacts``."""
        W = system.W[:, list(contacts)].T
        return cls(np.hstack([W, np.zeros_like(W)]), system.q_r[list(contacts)])

    @classmethod
    def speeds(cls, system: System, contacts: Contacts) -> "Measured":
        """The contact speeds of ``contacts``."""
        W = system.W[:, list(contacts)].T
        return cls(np.hstack([np.zeros_like(W), W]), np.zeros(len(contacts)))

    @classmethod
    def loads(cls, phase: Phase, contacts: Contacts) -> "Measured":
        """Loads of held ``contacts``."""
        L, equations = phase.loads[[phase.held.index(i) for i in contacts]], phase.equations
        return cls(np.hstack([L @ equations.K, L @ equations.C]), np.zeros(len(contacts)), L)

    def value(self, x: Vector, force: Vector | None = None) -> Vector:
        """At a state, shape (2n,), and the force then, shape (n,), if any: shape (k,)."""
        return np.asarray(self.c.dot(x) + self._rest(force))

    def rounding(self, x: Vector, force: Vector | None = None) -> list[float]:
        """Standard deviation of the rounding of each of them, positive."""
        terms = np.abs(self.c).dot(np.abs(x)).tolist()
        rests = self._rest(force).tolist()
        return [
            ROUNDING * (size + abs(rest)) + TINY for size, rest in zip(terms, rests, strict=True)
        ]

    def _rest(self, force: Vector | None) -> Vector:
        if self.load is None:
            return self.rest
        assert force is not None, "a load depends on the force"
        return np.asarray(self.rest - self.load.dot(force))

    def expanded(self, rates: StateRates, x: Vector, forces: Matrix) -> Expansion:
        """Their expansions about ``(0, x)`` in one phase.

        ``forces`` are f and its first two derivatives at the instant of ``x``, shape (3, n).
        """
        first, second = rates.along(x, forces)
        rate, bend = self.c.dot(first), self.c.dot(second)
        if self.load is not None:
            rate, bend = rate - self.load.dot(forces[1]), bend - self.load.dot(forces[2])
        H = np.column_stack([-rate, self.c])
        return Expansion(self.value(x, forces[0]), H, -self.c.dot(rates.A), bend)


class RestProjection(NamedTuple):
    """A state at rest on its closed contacts, as a function of one that is nearly so.

    Attributes:
        x: the state at rest, shape (2n,).
        map_: its derivative by the state, shape (2n, 2n).
        sensitivity: by the parameters, shape (2n, p).
    """

    x: Vector
    map_: Matrix
    sensitivity: Matrix


def _impulse_delay(numbers: Coefficients, pressed: list[int]) -> float:
    """How long after its onset an impact makes the velocities jump, s; the mean of its contacts.

    That is half of the contact time.
    """
    return float(np.mean(numbers.contact_time[pressed])) / 2


class Mirror(NamedTuple):
    """The jump ``x+ = J x- + offset``: a gap that is left is reversed like its speed.

    So ``gamma e = g`` stays true, and a jump that is a little early or late leaves the positions
    as they are. A contact that lasts is an impulse after the onset, which lags the positions; what
    springs and forces change of the speed until then is neglected.

    Attributes:
        J: shape (2n, 2n).
        offset: shape (2n,).
    """

    J: Matrix
    offset: Vector

    @classmethod
    def of(
        cls,
        system: System,
        J: Matrix,
        pressed: Contacts,
        numbers: Coefficients | None = None,
    ) -> "Mirror":
        """The mirror of ``u+ = J u-`` in which ``pressed`` take part.

        ``numbers`` have the gaps instead of the system's, contact times, and impulses beside those
        of the contacts.
        """
        n, P = system.n, list(pressed)
        if P and numbers is not None and np.any(aside := numbers.aside[P]):
            W, inverse = system.W[:, P].T, np.linalg.inv(system.M)
            J = J - inverse @ aside.T @ linalg.lstsq(W @ inverse @ W.T, W)[0]
        q_r, offset = (system.q_r if numbers is None else numbers.gap)[P], np.zeros(2 * n)
        whole, kick = np.zeros((2 * n, 2 * n)), J - np.eye(n)
        whole[:n, :n] = whole[n:, n:] = J
        if len(P) == 1:
            w = system.W[:, P[0]]
            offset[:n] = kick @ w * (q_r[0] / w.dot(w))
        elif P:
            offset[:n] = kick @ linalg.lstsq(system.W[:, P].T, q_r)[0]
        if P and numbers is not None and np.any(numbers.contact_time[P]):
            late = _impulse_delay(numbers, P)
            whole[:n, n:] = -late * kick
            whole[n:, n:] += late * np.linalg.solve(system.M, system.C @ kick)
        return cls(whole, offset)

    @property
    def soft(self) -> "Mirror":
        """The same jump of the velocities while positions stay, whatever the gap is."""
        n = len(self.offset) // 2
        J, offset = self.J.copy(), self.offset.copy()
        J[:n, :n], offset[:n] = np.eye(n), 0.0
        return Mirror(J, offset)

    def expanded(
        self, before: StateRates, after: StateRates, x: Vector, forces: Matrix
    ) -> Expansion:
        """The state after the jump, at the instant of ``x``, between two phases; about ``(0, x)``.

        ``forces`` are f and its first two derivatives at that instant, shape (3, n).
        """
        J, landed = self.J, self.landed(x)
        first = before.along(x, forces)[0]
        slope = after.along(landed, forces)[0] - J.dot(first)
        D = after.A.dot(J) - J.dot(before.A)
        E = after.A.dot(slope) - D.dot(first) - (after.B - J.dot(before.B)).dot(forces[1])
        return Expansion(landed, np.column_stack([slope, J]), D, E)

    def landed(self, x: Vector) -> Vector:
        """The state after the jump from ``x``, shape (2n,)."""
        return np.asarray(self.J.dot(x) + self.offset)
