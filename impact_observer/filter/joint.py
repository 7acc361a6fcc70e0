# SPDX-License-Identifier: Apache-2.0
"""The instant of an event and the state then, as one normal vector."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from impact_observer.filter.gaussian_state import GaussianState, propagate_errors
from impact_observer.filter.saltation import Expansion
from impact_observer.filter.square_root import (
    Correction,
    correction,
    innovation_root,
    lengths,
    product,
)
from impact_observer.kernel._kernel import SETTLED
from impact_observer.states import Matrix, Vector


class Joint(NamedTuple):
    """The instant of an event and the state then, as one normal vector (e, x, constants).

    Attributes:
        t: the instant of the state x, s since the epoch.
        z: the estimate (e, x, constants), shape (d,), d = 1 + 2n + k: by how much the event is
            earlier than ``t``, s; the state (q, u) at ``t``, as if before the event; and the
            constants of a ``GaussianState``.
        root: a square root of the covariance of (e, x, constants); its first row zero but for the
            first entry, shape (d, d).
        differences: (e, x, constants) of other replicas less that of the estimate, one a column,
            shape (d, N - 1).
        size: of the state, 2n.
        parameters: how many are estimated, k or k - 1.
    """

    t: float
    z: Vector
    root: Matrix
    differences: Matrix
    size: int
    parameters: int = 0

    @classmethod
    def of(
        cls, t: float, e: float, state: GaussianState, root: Matrix, differences: Matrix
    ) -> "Joint":
        """The instant ``t - e``, and ``state`` at ``t``."""
        size = state.x.size
        z = np.empty(len(root))
        z[0], z[1 : 1 + size], z[1 + size :] = e, state.x, state.constants
        return cls(t, z, root, differences, size, state.parameters)

    @staticmethod
    def differences_of(state: GaussianState) -> Matrix:
        """``differences`` of replicas whose events are earlier by their clock offsets."""
        d, others = state.differences.shape
        differences = np.empty((1 + d, others))
        if others:
            differences[1:] = state.differences
            differences[0] = state.differences[state.x.size + state.parameters :].sum(axis=0)
        return differences

    @property
    def e(self) -> float:
        """By how much the event is earlier than ``t``, s."""
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

    def propagated(
        self, s: float, x: Vector, map_: Matrix, sensitivity: Matrix | None = None
    ) -> "Joint":
        """The same with the state ``s`` seconds later.

        Args:
            s: seconds.
            x: the state then, shape (2n,).
            map_: its derivative by the state, shape (2n, 2n).
            sensitivity: of the state to the parameters, shape (2n, p); None where it is zero.
        """
        z = self.z.copy()
        z[0] += s
        z[1 : 1 + self.size] = x
        root = propagate_errors(self.root, 1, map_, sensitivity)
        differences = propagate_errors(self.differences, 1, map_, sensitivity)
        return Joint(self.t + s, z, root, differences, self.size, self.parameters)

    def corrected(self, update: Correction, H: Matrix, innovation: Vector) -> "Joint":
        """The posterior of a measurement of ``H z`` with this ``innovation``, shape (k,)."""
        differences = self.differences
        if differences.size:
            differences = differences - update.change(H.dot(differences))
        z = self.z + update.change(innovation)
        return Joint(self.t, z, update.root, differences, self.size, self.parameters)


class Expected(NamedTuple):
    """The predicted measurement of an event, linearised.

    Attributes:
        about: the state that it is linearised about, shape (2n,).
        expansion: of the measured functions, about that state.
        sensitivity: of these to the parameters, shape (k, p).
        innovation: measured less predicted, shape (k,).
        nonlinear: a square root of the covariance of what is not linear, shape (k, any).
        rounded: standard deviation of the rounding of each.
    """

    about: Vector
    expansion: Expansion
    sensitivity: Matrix
    innovation: Vector
    nonlinear: Matrix
    rounded: list[float]

    def rows(self, view: Joint) -> Matrix:
        """The measurement matrix for (e, x, constants), shape (k, d)."""
        H, d = self.expansion.H, len(view.root)
        (k, size), p = H.shape, self.sensitivity.shape[1]
        if d == size:
            return H
        found = np.zeros((k, d))
        found[:, :size], found[:, size : size + p] = H, self.sensitivity
        return found

    @property
    def noise(self) -> Matrix:
        """A square root of the covariance of what is not linear, and of rounding, (k, any)."""
        return np.hstack([self.nonlinear, np.diag(self.rounded)])

    def correction(self, view: Joint, considered: Sequence[int]) -> Correction:
        """The Kalman correction of ``view`` by this measurement; see ``square_root``."""
        return correction(view.root, self.rows(view), self.nonlinear, self.rounded, considered)

    def innovation_root(self, view: Joint) -> Matrix:
        """A square root of the innovation's covariance, lower triangular, shape (k, k)."""
        return innovation_root(view.root, self.rows(view), self.nonlinear, self.rounded)

    def settled(self, found: Joint) -> bool:
        """Whether linearising about ``found`` instead would change next to nothing."""
        _, H, D, E = self.expansion
        e, deviation = found.e, float(found.root[0, 0])
        bent = D.dot(found.x - self.about) + E * (e / 2)
        noises = zip(lengths(self.nonlinear), lengths(product(found.own, D, E)[1]), strict=True)
        each = zip(bent.tolist(), H[:, 0].tolist(), self.rounded, noises, strict=True)
        return all(
            abs(e * change) + abs(noise - left)
            <= SETTLED * math.hypot(slope * deviation, noise, rounded)
            for change, slope, rounded, (noise, left) in each
        )
