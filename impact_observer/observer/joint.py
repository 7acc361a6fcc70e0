"""The instant of an event and the state then, together: one normal vector."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from impact_observer.dynamics import Correction, Expansion, Phase, correction, product
from impact_observer.states import Matrix, Vector

_SETTLED = 0.05
"""What another linearisation may change, relative to the deviation of what was measured."""


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """The instant of an event and the state then, as one normal vector (e, x, b).

    Attributes:
        t: where the state is looked at, s since the epoch.
        e: how much earlier than ``t`` the event is believed to have been, s.
        x: state (q, u) at ``t``, before the event, shape (2n,).
        offset: what the sensor's stamps are believed to be late by, b, s.
        root: a square root of the covariance of (e, x), or of (e, x, b) where the offset is
            unknown; its first row zero but for the first entry, shape (1 + d, 1 + d).
        apart: (e, x, b) of all replicas less those of the estimate, shape (N, 2 + 2n).
    """

    t: float
    e: float
    x: Vector
    offset: float
    root: Matrix
    apart: Matrix

    @property
    def own(self) -> Matrix:
        """The rows of ``root`` for (e, x), shape (1 + 2n, 1 + d)."""
        return self.root[: 1 + self.x.size]

    def moved(self, phase: Phase, s: float) -> "Joint":
        """The same, looked at ``s`` seconds later."""
        if not s:
            return self
        Phi, rows = phase.transition(s), slice(1, 1 + self.x.size)
        root, apart = self.root.copy(), self.apart.copy()
        root[rows] = Phi @ root[rows]
        apart[:, rows] = apart[:, rows] @ Phi.T
        x = phase.moved(self.t, self.x, s)
        return Joint(self.t + s, self.e + s, x, self.offset, root, apart)

    def corrected(self, learnt: Correction, H: Matrix, innovation: Vector) -> "Joint":
        """The same after a measurement of ``H (e, x)``."""
        change, size = learnt.gain @ innovation, 1 + self.x.size
        apart = self.apart.copy()
        apart[:, : len(change)] -= (apart[:, :size] @ H.T) @ learnt.gain.T
        return Joint(
            self.t,
            self.e + float(change[0]),
            self.x + change[1:size],
            self.offset + float(np.sum(change[size:])),
            learnt.root,
            apart,
        )


class Expected(NamedTuple):
    """What an event is expected to say of a ``Joint``, linearised.

    Attributes:
        about: the state that it is linearised about, shape (2n,).
        expansion: of what is measured, about it.
        innovation: by what it says something else than ``expansion`` does, shape (k,).
        noise: a square root of the covariance of what is not linear, shape (k, any).
    """

    about: Vector
    expansion: Expansion
    innovation: Vector
    noise: Matrix

    def learnt(self, view: Joint) -> Correction:
        """What measuring it tells of ``view``."""
        H = self.expansion.H
        known = np.zeros((len(H), view.root.shape[0] - H.shape[1]))
        return correction(view.root, np.hstack([H, known]), self.noise)

    def settled(self, found: Joint) -> bool:
        """Whether linearising about ``found`` instead would change nothing."""
        _, H, D, E = self.expansion
        bent = found.e * (D @ (found.x - self.about) + E * (found.e / 2))
        noise = np.linalg.norm(self.noise, axis=1)
        left = np.linalg.norm(product(found.own, D, E)[1], axis=1)
        scale = np.hypot(H[:, 0] * found.root[0, 0], noise)
        return bool(np.all(np.abs(bent) + np.abs(noise - left) <= _SETTLED * scale))
