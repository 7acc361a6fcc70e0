# SPDX-License-Identifier: Apache-2.0
"""The coordinates that held contacts leave free.

Each contact makes one coordinate a function of the free coordinates. The free coordinates are not
transformed, so most zeros in the matrices of a system are kept.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from impact_observer.states import Matrix, Vector


class ReducedCoordinates(NamedTuple):
    """Coordinates of the motions with ``W^T u = 0``.

    Attributes:
        free: indices of the free coordinates, ascending, shape (r,).
        following: indices of the coordinates that the free ones determine, shape (n - r,).
        ties: ``q_following = ties q_free``, shape (n - r, r).
    """

    free: NDArray[np.intp]
    following: NDArray[np.intp]
    ties: Matrix

    @classmethod
    def of_directions(cls, W: Matrix, M: Matrix) -> "ReducedCoordinates":
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
        coordinates = np.empty((len(y), self.free.size + self.following.size))
        coordinates[:, self.free] = y
        coordinates[:, self.following] = y @ self.ties.T
        return coordinates


class PhaseFrame(NamedTuple):
    """The coordinates of a phase in which contacts are held or fixed.

    Attributes:
        free: the free coordinates.
        inverse: free coordinates of the nearest motion, shape (r, n).
        held: the part of ``p`` that does not move, shape (n, n), or empty if all of ``p`` moves.
        Q: ``dq/dt = Q u``, shape (n, n), or empty if ``p`` is ``q``.
        rest: ``q = Q p + rest``, shape (n,), m, or empty.
    """

    free: ReducedCoordinates
    inverse: Matrix
    held: Matrix
    Q: Matrix
    rest: Vector
