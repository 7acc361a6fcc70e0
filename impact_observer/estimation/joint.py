"""The instant of an event and the state then, together: one normal vector."""

import math
from typing import NamedTuple

import numpy as np

from impact_observer.estimation.gaussian_state import GaussianState, carried
from impact_observer.estimation.parametric import Map
from impact_observer.estimation.saltation import Expansion
from impact_observer.estimation.square_root import Correction, correction, lengths, product
from impact_observer.states import Matrix, Vector

SETTLED = 0.05
"""What another linearisation may change, relative to the deviation of what was measured."""


class Joint(NamedTuple):
    """The instant of an event and the state then, as one normal vector (e, x, slow).

    Attributes:
        t: where the state is looked at, s since the epoch.
        z: the estimate, shape (d,), d = 1 + 2n + k: how much earlier than ``t`` the event is
            believed to have been, s; the state (q, u) at ``t``, before the event; parameters and,
            where it is unknown, the offset, as of ``GaussianState``.
        root: a square root of the covariance of (e, x, slow); its first row zero but for the
            first entry, shape (d, d).
        differences: (e, x, slow) of other replicas less that of the estimate, one a column,
            shape (d, N - 1).
        size: of the state, 2n.
        parameters: how many are learnt, k or k - 1.
    """

    t: float
    z: Vector
    root: Matrix
    differences: Matrix
    size: int
    parameters: int = 0

    @classmethod
    def of(
        cls, t: float, e: float, known: GaussianState, root: Matrix, differences: Matrix
    ) -> "Joint":
        """Where the state is that of ``known`` at ``t``."""
        size = known.x.size
        z = np.empty(len(root))
        z[0], z[1 : 1 + size], z[1 + size :] = e, known.x, known.slow
        return cls(t, z, root, differences, size, known.parameters)

    @staticmethod
    def differences_of(known: GaussianState) -> Matrix:
        """``differences`` of replicas whose stamps are late by nothing but their offsets."""
        d, others = known.differences.shape
        differences = np.empty((1 + d, others))
        if others:
            differences[1:] = known.differences
            differences[0] = known.differences[known.x.size + known.parameters :].sum(axis=0)
        return differences

    @property
    def e(self) -> float:
        """How much earlier than ``t`` the event is believed to have been, s."""
        return float(self.z[0])

    @property
    def x(self) -> Vector:
        """The state (q, u) at ``t``, before the event, shape (2n,)."""
        return self.z[1 : 1 + self.size]

    @property
    def own(self) -> Matrix:
        """The rows of ``root`` for (e, x), shape (1 + 2n, d)."""
        return self.root[: 1 + self.size]

    @property
    def of_theta(self) -> slice:
        """The rows of ``root`` for the parameters."""
        return slice(1 + self.size, 1 + self.size + self.parameters)

    @property
    def theta(self) -> Vector:
        """The parameters, shape (p,)."""
        return self.z[self.of_theta]

    def moved(self, s: float, map_: Map, turn: Matrix | None = None) -> "Joint":
        """The same, looked at ``s`` seconds later.

        Args:
            s: seconds.
            map_: what becomes of the state.
            turn: how that changes with the parameters, shape (2n, p); None where it does not.
        """
        z = self.z.copy()
        z[0] += s
        z[1 : 1 + self.size] = map_.value
        root = carried(self.root, 1, map_.linear, turn)
        differences = carried(self.differences, 1, map_.linear, turn)
        return Joint(self.t + s, z, root, differences, self.size, self.parameters)

    def corrected(self, learnt: Correction, H: Matrix, white: list[float]) -> "Joint":
        """The same after a measurement of ``H (e, x, slow)``, of ``white`` innovations."""
        differences = self.differences
        if differences.size:
            differences = differences - learnt.change(H.dot(differences))
        z = self.z + learnt.gain.dot(white)
        return Joint(self.t, z, learnt.root, differences, self.size, self.parameters)


class Expected(NamedTuple):
    """What an event is expected to say of a ``Joint``, linearised.

    Attributes:
        about: the state that it is linearised about, shape (2n,).
        expansion: of what is measured, about it.
        turn: how that changes with the parameters, shape (k, p).
        innovation: by what it says something else than ``expansion`` does, shape (k,).
        bent: a square root of the covariance of what is not linear, shape (k, any).
        rounded: standard deviation of what is rounded in each.
    """

    about: Vector
    expansion: Expansion
    turn: Matrix
    innovation: Vector
    bent: Matrix
    rounded: list[float]

    def rows(self, view: Joint) -> Matrix:
        """What is measured of (e, x, slow), shape (k, d)."""
        H, d = self.expansion.H, len(view.root)
        (k, size), p = H.shape, self.turn.shape[1]
        if d == size:
            return H
        found = np.zeros((k, d))
        found[:, :size], found[:, size : size + p] = H, self.turn
        return found

    def learnt(self, view: Joint) -> Correction:
        """What measuring it tells of ``view``."""
        return correction(view.root, self.rows(view), self.bent, self.rounded)

    def settled(self, found: Joint) -> bool:
        """Whether linearising about ``found`` instead would change nothing."""
        _, H, D, E = self.expansion
        e, deviation = found.e, float(found.root[0, 0])
        bent = D.dot(found.x - self.about) + E * (e / 2)
        noises = zip(lengths(self.bent), lengths(product(found.own, D, E)[1]), strict=True)
        each = zip(bent.tolist(), H[:, 0].tolist(), self.rounded, noises, strict=True)
        return all(
            abs(e * change) + abs(noise - left)
            <= SETTLED * math.hypot(slope * deviation, noise, rounded)
            for change, slope, rounded, (noise, left) in each
        )
