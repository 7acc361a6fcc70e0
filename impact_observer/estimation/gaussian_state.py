"""A state with its square-root covariance, and what a linear map makes of both."""

import math
from typing import NamedTuple

import numpy as np

from impact_observer.estimation.ensemble import Differences, Ensemble
from impact_observer.events import Contacts
from impact_observer.states import Matrix, Vector


class GaussianState(NamedTuple):
    """A state and how surely it is known.

    Attributes:
        x: the estimate (q, u), shape (2n,).
        slow: what stays between events, shape (k,): the parameters theta that are learnt, then,
            where it is unknown, what the sensor's stamps are late by.
        root: a square root ``S`` of the covariance ``S S^T`` of (q, u, slow), shape (2n + k, any).
        differences: (q, u, slow) of the other replicas less the estimate, one a column,
            shape (2n + k, N - 1).
        closed: contacts that are closed.
        parameters: how many are learnt, k or k - 1.
    """

    x: Vector
    slow: Vector
    root: Matrix
    differences: Matrix
    closed: Contacts = ()
    parameters: int = 0

    @classmethod
    def of(cls, replicas: Matrix, root: Matrix, closed: Contacts = ()) -> "GaussianState":
        """With nothing slow, or with an offset of 0 where ``root`` has a row for it.

        Args:
            replicas: states (q, u), shape (N, 2n), the estimate first.
            root: as of ``GaussianState``.
            closed: likewise.
        """
        size = replicas.shape[1]
        differences = np.zeros((len(root), len(replicas) - 1))
        differences[:size] = (replicas[1:] - replicas[0]).T
        return cls(replicas[0], np.zeros(len(root) - size), root, differences, closed)

    @property
    def theta(self) -> Vector:
        """The estimate's parameters, shape (p,)."""
        return np.asarray(self.slow[: self.parameters])

    @property
    def offset(self) -> float:
        """What the sensor's stamps are late by to the estimate, s."""
        p = self.parameters
        return float(self.slow[p]) if self.slow.size > p else 0.0

    @property
    def ensemble(self) -> Ensemble:
        """The states of all replicas."""
        return Ensemble(self.x, Differences(self.differences[: self.x.size]))

    @property
    def is_finite(self) -> bool:
        """Whether the states of all replicas are."""
        if not math.isfinite(self.x.dot(self.x)):
            return False
        return not self.differences.size or bool(np.isfinite(self.differences).all())

    def carried(self, x: Vector, map_: Matrix, turn: Matrix | None = None) -> "GaussianState":
        """What ``map_`` makes of errors, and ``x`` of the estimate itself.

        Args:
            x: the estimate (q, u) afterwards, shape (2n,).
            map_: shape (2n, 2n).
            turn: how the state changes with the parameters, shape (2n, p); None where it does not.
        """
        root = carried(self.root, 0, map_, turn)
        differences = carried(self.differences, 0, map_, turn)
        return GaussianState(x, self.slow, root, differences, self.closed, self.parameters)


def carried(errors: Matrix, first: int, map_: Matrix, turn: Matrix | None = None) -> Matrix:
    """What a map of states makes of errors of more than a state.

    Args:
        errors: one a column, shape (d, any); after the state's rows come the parameters'.
        first: of the state's rows.
        map_: shape (2n, 2n).
        turn: how the state changes with the parameters, shape (2n, p); None where it does not.
    """
    found: Matrix
    if len(errors) == len(map_):
        found = map_.dot(errors)
        return found
    last, found = first + len(map_), errors.copy()
    found[first:last] = map_.dot(errors[first:last])
    if turn is not None:
        found[first:last] += turn.dot(errors[last : last + turn.shape[1]])
    return found
