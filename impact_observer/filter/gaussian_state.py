# SPDX-License-Identifier: Apache-2.0
"""A state with its square-root covariance, and how a linear map propagates both."""

import math
from typing import NamedTuple

import numpy as np

from impact_observer.events import Contacts
from impact_observer.filter.ensemble import Ensemble
from impact_observer.states import Matrix, Vector


class GaussianState(NamedTuple):
    """The estimate and the square root of its covariance.

    Attributes:
        x: the estimate (q, u), shape (2n,).
        constants: what no flight and no impact changes, shape (k,): the parameters theta that
            are estimated; then, where it is estimated, the offset of the sensor's clock.
        root: a square root ``S`` of the covariance ``S S^T`` of (q, u, constants), shape
            (2n + k, any).
        differences: (q, u, constants) of the other replicas less the estimate, one a column,
            shape (2n + k, N - 1).
        closed: contacts that are closed.
        parameters: how many are estimated, k or k - 1.
    """

    x: Vector
    constants: Vector
    root: Matrix
    differences: Matrix
    closed: Contacts = ()
    parameters: int = 0

    @classmethod
    def of(cls, replicas: Matrix, root: Matrix, closed: Contacts = ()) -> "GaussianState":
        """A state without parameters; with an offset of 0 where ``root`` has a row for it.

        The ``replicas`` (q, u) have shape (N, 2n), the estimate first.
        """
        size = replicas.shape[1]
        differences = np.zeros((len(root), len(replicas) - 1))
        differences[:size] = (replicas[1:] - replicas[0]).T
        return cls(replicas[0], np.zeros(len(root) - size), root, differences, closed)

    @property
    def theta(self) -> Vector:
        """The parameters that are estimated, shape (p,)."""
        return np.asarray(self.constants[: self.parameters])

    @property
    def of_theta(self) -> slice:
        """The rows of ``root`` for the parameters."""
        return slice(self.x.size, self.x.size + self.parameters)

    @property
    def offset(self) -> float:
        """The offset of the sensor's clock, s: by how much its stamps are late."""
        p = self.parameters
        return float(self.constants[p]) if self.constants.size > p else 0.0

    @property
    def ensemble(self) -> Ensemble:
        """The states of all replicas."""
        return Ensemble(self.x, self.differences[: self.x.size])

    @property
    def is_finite(self) -> bool:
        """Whether the states of all replicas are finite."""
        if not math.isfinite(self.x.dot(self.x)):
            return False
        others = self.differences.ravel()
        return not others.size or math.isfinite(others.dot(others))

    def with_error(self, added: Matrix) -> "GaussianState":
        """With another error of (q, u), one independent part a column, shape (2n, any)."""
        (d, columns), (size, more) = self.root.shape, added.shape
        root = np.zeros((d, columns + more))
        root[:, :columns], root[:size, columns:] = self.root, added
        return self._replace(root=root)

    def with_offset_error(self, deviation: float, offset: float = 0.0) -> "GaussianState":
        """With another error of the clock's offset, s; an ``offset`` where it had none."""
        size, (d, columns) = self.x.size + self.parameters, self.root.shape
        root = np.zeros((size + 1, columns + 1))
        root[:d, :columns], root[size, columns] = self.root, deviation
        if d > size:
            return self._replace(root=root)
        constants, differences = np.append(self.constants, offset), self.differences
        differences = np.pad(differences, ((0, 1), (0, 0)))
        return self._replace(constants=constants, root=root, differences=differences)

    def propagated(
        self, x: Vector, map_: Matrix, sensitivity: Matrix | None = None
    ) -> "GaussianState":
        """The estimate is ``x``; ``map_``, shape (2n, 2n), propagates covariance and differences.

        ``sensitivity`` of the state to the parameters has shape (2n, p); None where it is zero.
        """
        root = propagate_errors(self.root, 0, map_, sensitivity)
        differences = propagate_errors(self.differences, 0, map_, sensitivity)
        return GaussianState(x, self.constants, root, differences, self.closed, self.parameters)


def propagate_errors(
    errors: Matrix, first: int, map_: Matrix, sensitivity: Matrix | None = None
) -> Matrix:
    """Errors after a map of the state; those of everything else stay.

    Args:
        errors: one a column, shape (d, any); after the state's rows come the parameters'.
        first: of the state's rows.
        map_: shape (2n, 2n).
        sensitivity: of the state to the parameters, shape (2n, p); None where it is zero.
    """
    found: Matrix
    if len(errors) == len(map_):
        found = map_.dot(errors)
        return found
    last, found = first + len(map_), errors.copy()
    found[first:last] = map_.dot(errors[first:last])
    if sensitivity is not None:
        found[first:last] += sensitivity.dot(errors[last : last + sensitivity.shape[1]])
    return found
