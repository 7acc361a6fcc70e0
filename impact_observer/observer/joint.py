"""The instant of an event and the state then, together: one normal vector."""

from typing import NamedTuple

import numpy as np

from impact_observer.dynamics import Correction, Expansion, Map, correction, lengths, product
from impact_observer.observer.belief import Known
from impact_observer.states import Matrix, Vector

_SETTLED = 0.05
"""What another linearisation may change, relative to the deviation of what was measured."""


class Joint(NamedTuple):
    """The instant of an event and the state then, as one normal vector (e, x, slow).

    Attributes:
        t: where the state is looked at, s since the epoch.
        e: how much earlier than ``t`` the event is believed to have been, s.
        x: state (q, u) at ``t``, before the event, shape (2n,).
        slow: parameters and, where it is unknown, the offset: as of ``Known``, shape (k,).
        root: a square root of the covariance of (e, x, slow); its first row zero but for the
            first entry, shape (d, d), d = 1 + 2n + k.
        apart: (e, x, slow) of all replicas less those of the estimate, shape (N, d).
        parameters: how many are learnt, k or k - 1.
    """

    t: float
    e: float
    x: Vector
    slow: Vector
    root: Matrix
    apart: Matrix
    parameters: int = 0

    @property
    def own(self) -> Matrix:
        """The rows of ``root`` for (e, x), shape (1 + 2n, d)."""
        return self.root[: 1 + self.x.size]

    @classmethod
    def of(cls, t: float, e: float, known: Known, root: Matrix, apart: Matrix) -> "Joint":
        """Where the state is that of ``known`` at ``t``."""
        return cls(t, e, known.x, known.slow[0], root, apart, known.parameters)

    @staticmethod
    def apart_of(known: Known) -> Matrix:
        """``apart`` of replicas whose stamps are late by nothing but their offsets."""
        slow = known.slow - known.slow[0]
        late = slow[:, known.parameters :].sum(axis=1, keepdims=True)
        return np.concatenate([late, known.replicas - known.x, slow], axis=1)

    @property
    def of_theta(self) -> slice:
        """The rows of ``root`` for the parameters."""
        return slice(1 + self.x.size, 1 + self.x.size + self.parameters)

    @property
    def theta(self) -> Vector:
        """The parameters, shape (p,)."""
        return self.slow[: self.parameters]

    def moved(self, s: float, map_: Map, turn: Matrix | None = None) -> "Joint":
        """The same, looked at ``s`` seconds later.

        Args:
            s: seconds.
            map_: what becomes of the state.
            turn: how that changes with the parameters, shape (2n, p); None where it does not.
        """
        rows = slice(1, 1 + self.x.size)
        root, apart = self.root.copy(), self.apart.copy()
        root[rows] = map_.linear @ root[rows]
        apart[:, rows] = apart[:, rows] @ map_.linear.T
        if turn is not None:
            root[rows] += turn @ root[self.of_theta]
            apart[:, rows] += apart[:, self.of_theta] @ turn.T
        return self._replace(t=self.t + s, e=self.e + s, x=map_.value, root=root, apart=apart)

    def corrected(self, learnt: Correction, H: Matrix, innovation: Vector) -> "Joint":
        """The same after a measurement of ``H (e, x, slow)``."""
        change = learnt.gain @ innovation
        apart = self.apart - (self.apart @ H.T) @ learnt.gain.T
        return self.shifted(change)._replace(root=learnt.root, apart=apart)

    def shifted(self, change: Vector) -> "Joint":
        """The same estimate but for a ``change`` of (e, x, slow), shape (d,)."""
        size = 1 + self.x.size
        return self._replace(
            e=self.e + float(change[0]),
            x=self.x + change[1:size],
            slow=self.slow + change[size:],
        )


class Expected(NamedTuple):
    """What an event is expected to say of a ``Joint``, linearised.

    Attributes:
        about: the state that it is linearised about, shape (2n,).
        expansion: of what is measured, about it.
        turn: how that changes with the parameters, shape (k, p).
        innovation: by what it says something else than ``expansion`` does, shape (k,).
        bent: a square root of the covariance of what is not linear, shape (k, any).
        rounded: standard deviation of what is rounded, shape (k,).
    """

    about: Vector
    expansion: Expansion
    turn: Matrix
    innovation: Vector
    bent: Matrix
    rounded: Vector

    def rows(self, view: Joint) -> Matrix:
        """What is measured of (e, x, slow), shape (k, d)."""
        found, size = np.zeros((len(self.turn), len(view.root))), 1 + view.x.size
        found[:, :size] = self.expansion.H
        found[:, size : size + self.turn.shape[1]] = self.turn
        return found

    def learnt(self, view: Joint) -> Correction:
        """What measuring it tells of ``view``."""
        noise = np.concatenate([self.bent, np.diag(self.rounded)], axis=1)
        return correction(view.root, self.rows(view), noise)

    def settled(self, found: Joint) -> bool:
        """Whether linearising about ``found`` instead would change nothing."""
        _, H, D, E = self.expansion
        bent = found.e * (D @ (found.x - self.about) + E * (found.e / 2))
        noise, left = lengths(self.bent), lengths(product(found.own, D, E)[1])
        scale = np.hypot(np.hypot(H[:, 0] * found.root[0, 0], noise), self.rounded)
        return bool(np.all(np.abs(bent) + np.abs(noise - left) <= _SETTLED * scale))
