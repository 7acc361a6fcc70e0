"""Two phases and the jump between them as functions of a state and of when the jump is.

A plant jumps ``e`` seconds before an instant at which its state would be ``y`` without the jump.
What is measured at the jump, and what has become of the state at that instant, are functions of
``(e, y)``. Here are their expansions about ``e = 0``: linear in ``y``, of second order in ``e``.

For ``x+ = J x-`` the first order in ``e`` is ``f+ - J f-``, the rates ``f = dx/dt`` before and
after. With ``e = g / gamma`` from the gap this is the saltation matrix (Kong, Payne, Zhu and
Johnson, Saltation matrices, 2023), but regular where ``gamma`` is zero.
"""

from typing import NamedTuple

import numpy as np
from scipy import linalg

from impact_observer.dynamics.phase import Phase
from impact_observer.events import Contacts
from impact_observer.model import System
from impact_observer.states import Matrix, Vector

ROUNDING = 4 * float(np.finfo(np.float64).eps)
"""Of what is measured, relative to the terms that it is the sum of."""
_LEAST = 1e-150
"""Standard deviation of a measurement in which nothing is rounded."""


class Rates:
    """``dx/dt = A x + B f(t)`` of one phase with nothing fixed.

    Attributes:
        A: shape (2n, 2n).
        B: shape (2n, n).
        decay: of the fastest fading motion, 1/s.
    """

    def __init__(self, phase: Phase) -> None:
        """Write the phase as a system of first order."""
        n, equations = phase.equations.n, phase.equations
        inverse = phase.inverse
        self.A = np.zeros((2 * n, 2 * n))
        self.A[:n, n:] = np.eye(n)
        self.A[n:, :n] = -inverse @ equations.K
        self.A[n:, n:] = -inverse @ equations.C
        self.B = np.vstack([np.zeros((n, n)), inverse])
        self.decay = max(0.0, -float(np.min(linalg.eigvals(self.A).real)))

    def along(self, x: Vector, forces: Matrix) -> tuple[Vector, Vector]:
        """``dx/dt`` and its derivative by time, (2n,) each; ``forces`` are f, df/dt, ..."""
        first = self.A @ x + self.B @ forces[0]
        return first, self.A @ first + self.B @ forces[1]


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
    """Functions ``c x + d(t)`` that are zero when something switches.

    Attributes:
        c: shape (k, 2n).
        d: with its first two derivatives by time, shape (3, k).
    """

    c: Matrix
    d: Matrix

    @classmethod
    def gaps(cls, system: System, contacts: Contacts) -> "Measured":
        """The gaps of ``contacts``."""
        W, d = system.W[:, list(contacts)].T, np.zeros((3, len(contacts)))
        d[0] = system.q_r[list(contacts)]
        return cls(np.hstack([W, np.zeros_like(W)]), d)

    @classmethod
    def speeds(cls, system: System, contacts: Contacts) -> "Measured":
        """The contact speeds of ``contacts``."""
        W = system.W[:, list(contacts)].T
        return cls(np.hstack([np.zeros_like(W), W]), np.zeros((3, len(contacts))))

    @classmethod
    def loads(cls, phase: Phase, contacts: Contacts, forces: Matrix) -> "Measured":
        """Loads of held ``contacts``; ``forces`` are f and its first two derivatives."""
        L, equations = phase.loads[[phase.held.index(i) for i in contacts]], phase.equations
        return cls(np.hstack([L @ equations.K, L @ equations.C]), -forces[:3] @ L.T)

    def value(self, x: Vector) -> Vector:
        """Shape (k,)."""
        return np.asarray(self.c @ x + self.d[0])

    def rounding(self, x: Vector) -> Vector:
        """Standard deviation of what is rounded in it, positive, shape (k,)."""
        return np.asarray(ROUNDING * (np.abs(self.c) @ np.abs(x) + np.abs(self.d[0])) + _LEAST)

    def expanded(self, rates: Rates, y: Vector, forces: Matrix) -> Expansion:
        """Their values at the jump; ``forces`` are f, df/dt, ... at the instant of ``y``."""
        first, second = rates.along(y, forces)
        slope = -self.c @ first - self.d[1]
        return Expansion(
            self.value(y),
            np.column_stack([slope, self.c]),
            -self.c @ rates.A,
            self.c @ second + self.d[2],
        )


class Mirror(NamedTuple):
    """``x+ = J x- + offset``: velocities jump, and so does what a gap is not closed by.

    A gap that is left is thrown back like its speed, so that ``gamma e = g`` stays true: where
    the jump is a little early or late, positions do not notice.

    Attributes:
        J: shape (2n, 2n).
        offset: shape (2n,).
    """

    J: Matrix
    offset: Vector

    @classmethod
    def of(
        cls, system: System, J: Matrix, pressed: Contacts, gaps: Vector | None = None
    ) -> "Mirror":
        """The mirror of ``u+ = J u-`` in which ``pressed`` take part.

        Args:
            system: what is hit.
            J: shape (n, n).
            pressed: indices of contacts.
            gaps: in the rest position, to use instead of the system's, shape (m,), m.
        """
        n, P = system.n, list(pressed)
        q_r, offset = (system.q_r if gaps is None else gaps)[P], np.zeros(2 * n)
        if P:
            offset[:n] = (J - np.eye(n)) @ linalg.lstsq(system.W[:, P].T, q_r)[0]
        return cls(linalg.block_diag(J, J), offset)

    def expanded(self, before: Rates, after: Rates, y: Vector, forces: Matrix) -> Expansion:
        """The state after the jump, at the instant of ``y``."""
        J, x = self.J, self.J @ y + self.offset
        ending, further = before.along(y, forces)
        jump = after.A @ x + after.B @ forces[0] - J @ ending
        D = after.A @ J - J @ before.A
        # jump as a function of the instant: what it changes by while the jump moves back
        onward = after.A @ (J @ ending) + after.B @ forces[1] - J @ further
        return Expansion(x, np.column_stack([jump, J]), D, after.A @ jump - onward)
