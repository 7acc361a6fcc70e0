# SPDX-License-Identifier: Apache-2.0
"""The coordinates that held contacts leave free.

One coordinate per contact is determined by the others, which remain as they are: so most zeros in
the matrices of a system are kept.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from impact_observer.states import Matrix, Vector


class ReducedCoordinates(NamedTuple):
    """Coordinates of the motions with ``W^T u = 0``.

    Attributes:
        free: coordinates that are free, ascending, shape (r,).
        following: the others, which the free ones determine, shape (n - r,).
        ties: ``q_following = ties q_free``, shape (n - r, r).
    """

    free: NDArray[np.intp]
    following: NDArray[np.intp]
    ties: Matrix

    @classmethod
    def of(cls, W: Matrix, M: Matrix) -> "ReducedCoordinates":
        """The coordinates for ``p`` independent contacts.

        The lightest coordinates are chosen to follow.

        Args:
            W: directions of the contacts, shape (n, p).
            M: mass matrix, shape (n, n).
        """
        weighed = W / np.sqrt(np.diag(M))[:, None]
        order = linalg.qr(weighed.T, mode="r", pivoting=True)[1]
        following, free = order[: W.shape[1]], np.sort(order[W.shape[1] :])
        if not free.size:
            return cls(free, following, np.zeros((following.size, 0)))
        return cls(free, following, -linalg.solve(W[following].T, W[free].T))

    def restricted(self, A: Matrix) -> Matrix:
        """``S^T A S``, shape (r, r), for ``A`` of shape (n, n) and the free motions ``S``."""
        seen = self.seen(A)
        return np.asarray(seen[:, self.free] + seen[:, self.following] @ self.ties)

    def seen(self, A: Matrix) -> Matrix:
        """``S^T A``, shape (r, columns), for ``A`` of shape (n, columns)."""
        return np.asarray(A[self.free] + self.ties.T @ A[self.following])

    def all(self, y: Matrix) -> Matrix:
        """All coordinates, shape (rows, n), from the free ones, shape (rows, r)."""
        found = np.empty((len(y), self.free.size + self.following.size))
        found[:, self.free] = y
        found[:, self.following] = y @ self.ties.T
        return found


class PhaseFrame(NamedTuple):
    """Where the coordinates of a phase lie in which contacts are held or fixed.

    Attributes:
        free: those that are free.
        inverse: free coordinates of the nearest motion, shape (r, n).
        held: the part of ``p`` that does not move, shape (n, n), or empty where all moves.
        Q: ``dq/dt = Q u``, shape (n, n), or empty where ``p`` is ``q``.
        rest: ``q = Q p + rest``, shape (n,), m, or empty.
    """

    free: ReducedCoordinates
    inverse: Matrix
    held: Matrix
    Q: Matrix
    rest: Vector
