"""What is watched along a motion: functions that end a phase when they fall below zero."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from impact_observer.dynamics.flow.flow import Functions
from impact_observer.dynamics.flow.phase import Phase
from impact_observer.model import Forcing, System
from impact_observer.states import Matrix, Vector


@dataclass(frozen=True, slots=True, eq=False)
class Watched:
    """Functions ``h = a p + b u + c f(t) + d`` of a motion (p, u), a row each.

    Attributes:
        position: ``a``, shape (w, n).
        velocity: ``b``, shape (w, n).
        force: ``c``, shape (w, n).
        constant: ``d``, shape (w,).
    """

    position: Matrix
    velocity: Matrix
    force: Matrix
    constant: Vector

    @classmethod
    def gaps(cls, system: System, contacts: list[int], phase: Phase | None = None) -> "Watched":
        """The gaps of ``contacts``: below zero they are penetrated.

        Args:
            system: whose contacts.
            contacts: indices.
            phase: in whose coordinates; None where these are the system's.
        """
        a, d = system.W[:, contacts].T, system.q_r[contacts]
        if phase is not None and phase.fixed:
            a, d = a @ phase.Q, d + a @ phase.rest
        return cls(a, np.zeros_like(a), np.zeros_like(a), d)

    @classmethod
    def speeds(cls, system: System, contacts: list[int]) -> "Watched":
        """The contact speeds of ``contacts``: at zero a slipping one is held."""
        return cls.of_velocity(system.W[:, contacts].T)

    @classmethod
    def of_velocity(cls, b: Matrix) -> "Watched":
        """``b u``, shape (w, n): reactions ``sigma`` of stops are such functions."""
        return cls(np.zeros_like(b), b, np.zeros_like(b), np.zeros(len(b)))

    @classmethod
    def loads(cls, phase: Phase) -> "Watched":
        """The loads ``lambda`` of the held contacts: below zero they are released."""
        H, equations = phase.loads, phase.equations
        return cls(H @ equations.K, H @ equations.C, -H, np.zeros(len(H)))

    def and_also(self, other: "Watched") -> "Watched":
        """The functions of both, these first."""
        return Watched(
            np.vstack([self.position, other.position]),
            np.vstack([self.velocity, other.velocity]),
            np.vstack([self.force, other.force]),
            np.concatenate([self.constant, other.constant]),
        )

    def functions(self, forcing: Forcing) -> Functions:
        """The same functions where nothing but constants and harmonics drives the motion."""
        harmonics = self.force @ (forcing.cosine - 1j * forcing.sine).T
        constant = self.constant + self.force @ forcing.constant
        return Functions(np.hstack([self.position, self.velocity]), harmonics, constant)

    def values(self, forcing: Forcing, t: Vector, x: NDArray[np.float64]) -> Matrix:
        """Their values, shape (samples, w).

        Args:
            forcing: of the motion.
            t: s since the epoch, shape (samples,).
            x: states (p, u), shape (samples, 2n).
        """
        n = self.position.shape[1]
        found = x[:, :n] @ self.position.T + self.constant
        if np.any(self.velocity):
            found = found + x[:, n:] @ self.velocity.T
        if np.any(self.force):
            found = found + forcing.derivatives(t, 0)[0] @ self.force.T
        return np.asarray(found)
