"""Replicas that are run together: the estimate, and others as differences from it."""

from typing import NamedTuple

import numpy as np

from impact_observer.states import Matrix, Vector

_SAME = 1e-200
"""Squared size of a map that leaves nothing of any difference."""


class Ensemble(NamedTuple):
    """The estimate and, for each other replica, by how much it differs.

    What acts on all of them alike is a map of differences, however many there are: it is only
    noted, and made of them when somebody asks for numbers.

    Attributes:
        x: the estimate (q, u), shape (2n,).
        columns: differences at some earlier time, one a column, shape (2n, N - 1).
        due: what has become of them since, shape (2n, 2n); None for nothing.
    """

    x: Vector
    columns: Matrix
    due: Matrix | None = None

    @classmethod
    def of(cls, replicas: Matrix) -> "Ensemble":
        """``replicas`` (q, u), shape (N, 2n), the estimate first."""
        x, others = replicas[0], replicas[1:].T
        return cls(x, np.subtract(others, x[:, None], order="C") if others.size else others)

    @property
    def others(self) -> int:
        """How many replicas there are besides the estimate."""
        found: int = self.columns.shape[1]
        return found

    @property
    def apart(self) -> Matrix:
        """Differences from the estimate, one a column, shape (2n, N - 1)."""
        return self.columns if self.due is None else self.due.dot(self.columns)

    @property
    def replicas(self) -> Matrix:
        """States (q, u), shape (N, 2n), the estimate first."""
        return np.concatenate([self.x[None], self.apart.T + self.x])

    def seen(self, functions: Matrix) -> Matrix:
        """What linear ``functions``, shape (k, 2n), see of the differences, (k, N - 1)."""
        due = functions if self.due is None else functions.dot(self.due)
        return np.asarray(due @ self.columns)

    def carried(self, x: Vector, map_: Matrix) -> "Ensemble":
        """The estimate is ``x`` now; ``map_``, shape (2n, 2n), has acted on all differences."""
        due = map_ if self.due is None else map_.dot(self.due)
        size = due.ravel()
        if size.dot(size) < _SAME:
            return Ensemble(x, np.zeros_like(self.columns))
        return Ensemble(x, self.columns, due)
