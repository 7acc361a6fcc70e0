# SPDX-License-Identifier: Apache-2.0
"""Grounds that move by themselves, and the frame of coordinates in which no stop moves.

The gap of a contact on moving grounds is ``g = W^T q + q_r + F s(t)``, ``s`` their displacements.
A shift ``E`` solves ``W^T E = -F``. The coordinates ``p = q - E s`` have ``g = W^T p + q_r`` and
``gamma = W^T du/dt``: no stop moves, and the motion of the grounds is a part of the forcing ::

    M ddp/dt2 + C dp/dt + K p = f + (B - K E) s + (D - C E) ds/dt - M E d2s/dt2

``B`` and ``D`` are stiffness and damping of the springs between grounds and bodies. The whole
package computes in this frame. Initial states, messages and files have the coordinates ``q``.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from impact_observer.errors import ModelError
from impact_observer.model.angles import Angles
from impact_observer.model.forcing import Forcing
from impact_observer.states import Matrix, Vector, frozen


@dataclass(frozen=True, slots=True, eq=False)
class LiveNames:
    """The signals of a model that arrive live.

    Attributes:
        inputs: names of forces.
        directions: of the coordinates by unit forces, shape (n, inputs).
    """

    inputs: tuple[str, ...]
    directions: Matrix


_UNSOLVED = 1e-9
"""Largest motion of a stop after the shift that counts as rounding, relative to the largest."""
_DIGITS = 12
"""Decimals to which a shift is rounded, if the rounded shift is exact."""


@dataclass(frozen=True, slots=True, eq=False)
class Grounds:
    """The moving grounds of a system.

    Attributes:
        names: of the grounds.
        motion: their displacements ``s(t)``, k columns, m; no constant.
        owner: index of the ground of each harmonic of ``motion``.
        stiffness: forces on the coordinates by unit displacements, shape (n, k), N/m.
        damping: the same by unit speeds, shape (n, k), Ns/m.
        factors: factors of the displacements in the gap of each contact, shape (m, k).
        written: the value of the key ``grounds`` with all tables written out.
    """

    names: tuple[str, ...]
    motion: Forcing
    owner: tuple[int, ...]
    stiffness: Matrix
    damping: Matrix
    factors: Matrix
    written: tuple[Mapping[str, object], ...] = ()

    def shift(self, W: Matrix) -> Matrix:
        """The shift ``E``, shape (n, k), for directions ``W`` of shape (n, m).

        Raises:
            ModelError: stops of the same body move against each other.
        """
        E = -np.linalg.pinv(W.T) @ self.factors if W.size else np.zeros_like(self.stiffness)
        rounded = np.round(E, _DIGITS)
        if np.array_equal(W.T @ rounded, -self.factors):
            E = rounded
        left = np.abs(W.T @ E + self.factors)
        if np.any(left > _UNSOLVED * np.max(np.abs(self.factors), initial=0.0)):
            i, k = (int(each) for each in np.unravel_index(np.argmax(left), left.shape))
            raise ModelError(
                f"contacts[{i}]",
                f"moves with {self.names[k]!r} against other stops of the same bodies, so no frame"
                " has both at rest; expected stops of a body on the same ground, or a heavy body"
                " on a stiff spring to it as one of them",
            )
        return frozen(E)


@dataclass(frozen=True, slots=True, eq=False)
class MovingFrame:
    """The frame in which no stop of a system moves.

    Attributes:
        grounds: the moving grounds.
        forcing: ``f(t)`` of the model without the effects of the grounds.
        shift: ``E`` of ``q = p + E s(t)``, shape (n, k).
        angles: angles of the harmonics of the grounds. Derived.
        gap_reach: largest motion of each contact by the grounds, m, shape (m,). Derived.
    """

    grounds: Grounds
    forcing: Forcing
    shift: Matrix
    angles: Angles = field(init=False)
    gap_reach: Vector = field(init=False)

    def __post_init__(self) -> None:
        """Derive ``angles`` and ``gap_reach``."""
        motion = self.grounds.motion
        reach = np.sum(np.abs(motion.cosine) + np.abs(motion.sine), axis=0)
        if motion.sampled is not None:
            reach = reach + np.max(np.abs(motion.sampled.force), axis=0)
        object.__setattr__(self, "angles", Angles(motion.frequency))
        object.__setattr__(self, "gap_reach", frozen(np.abs(self.grounds.factors) @ reach))

    def total(self, M: Matrix, C: Matrix, K: Matrix) -> Forcing:
        """The forcing in the frame; the harmonics of the grounds come last."""
        grounds, E = self.grounds, self.shift
        stiffness, damping = grounds.stiffness - K @ E, grounds.damping - C @ E
        return self.forcing.added(grounds.motion.responded(stiffness, damping, -M @ E))

    def by_frequency(self, M: Matrix, C: Matrix) -> NDArray[np.complex128]:
        """Derivatives of the complex amplitudes of the grounds' harmonics in ``total``, (h, n).

        Each is by the frequency of its harmonic.
        """
        motion, E = self.grounds.motion, self.shift
        amplitude, damping = motion.cosine - 1j * motion.sine, self.grounds.damping - C @ E
        by_inertia = 2 * motion.frequency[:, None] * (amplitude @ (M @ E).T)
        return np.asarray(1j * (amplitude @ damping.T) + by_inertia)

    def displacements(self, ns: NDArray[np.int64]) -> tuple[Matrix, Matrix]:
        """``s`` and ``ds/dt`` at instants, ns since the epoch, shape (samples, k) each."""
        motion, angles = self.grounds.motion, self.angles.at_stamps(ns)
        cos, sin, omega = np.cos(angles), np.sin(angles), motion.frequency
        s = cos @ motion.cosine + sin @ motion.sine
        speed = (omega * cos) @ motion.sine - (omega * sin) @ motion.cosine
        if motion.sampled is not None:
            jets = motion.sampled.derivatives(np.asarray(ns * 1e-9))
            s, speed = s + jets[0], speed + jets[1]
        return s, speed

    def states(self, ns: NDArray[np.int64]) -> Matrix:
        """Difference of the states (q, u) from those in the frame.

        Args:
            ns: nanoseconds since the epoch, shape (samples,).

        Returns:
            ``(E s, E ds/dt)``, shape (samples, 2n).
        """
        return np.hstack([each @ self.shift.T for each in self.displacements(ns)])
