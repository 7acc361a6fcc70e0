# SPDX-License-Identifier: Apache-2.0
"""Replicas that are run together: the estimate, and others as differences from it."""

from typing import NamedTuple

import numpy as np

from impact_observer.states import Matrix, Vector


class Ensemble(NamedTuple):
    """The estimate and, for each other replica, by how much it differs.

    A map of all differences is only noted, and applied when their numbers are needed.

    Attributes:
        x: the estimate (q, u), shape (2n,).
        columns: by how much they differed at some earlier time, one a column, shape (2n, N - 1).
        due: the map from then to now, shape (2n, 2n); None for the identity.
    """

    x: Vector
    columns: Matrix
    due: Matrix | None = None

    @classmethod
    def of(cls, replicas: Matrix) -> "Ensemble":
        """``replicas`` (q, u), shape (N, 2n), the estimate first."""
        x, others = replicas[0], replicas[1:].T
        columns = np.subtract(others, x[:, None], order="C") if others.size else others
        return cls(x, columns)

    @property
    def others(self) -> int:
        """How many replicas there are besides the estimate."""
        return int(self.columns.shape[1])

    @property
    def differences(self) -> Matrix:
        """Differences from the estimate, one a column, shape (2n, N - 1)."""
        return self.columns if self.due is None else self.due.dot(self.columns)

    @property
    def replicas(self) -> Matrix:
        """States (q, u), shape (N, 2n), the estimate first."""
        return np.concatenate([self.x[None], self.differences.T + self.x])

    def mapped(self, functions: Matrix) -> Matrix:
        """Values of linear ``functions``, shape (k, 2n) or (2n,), at the differences."""
        due = functions if self.due is None else functions.dot(self.due)
        return np.asarray(due.dot(self.columns))

    def sizes_by(self, metric: Matrix) -> tuple[float, float]:
        """``x^T metric x``, and the largest ``d^T metric d`` between two replicas; (2n, 2n)."""
        with np.errstate(over="ignore", invalid="ignore"):
            columns = self.differences
            products = columns.T.dot(metric.dot(columns))
            squares = np.diagonal(products)
            apart = squares[:, None] + squares - 2 * products
            largest = np.maximum(np.max(squares, initial=0.0), np.max(apart, initial=0.0))
            return float(self.x.dot(metric.dot(self.x))), float(largest)

    def propagated(self, x: Vector, map_: Matrix) -> "Ensemble":
        """The estimate is ``x`` now; ``map_``, shape (2n, 2n), propagates all differences."""
        return Ensemble(x, self.columns, map_ if self.due is None else map_.dot(self.due))
