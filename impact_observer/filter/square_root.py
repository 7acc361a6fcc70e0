# SPDX-License-Identifier: Apache-2.0
"""Linear estimation by square roots of covariances, ``P = S S^T``.

Roots are propagated, never ``P``: stamps of 1 ns let variances fall to 1e-18 of what they were.
Every step is one orthogonal triangulation (Kailath, Sayed and Hassibi, Linear Estimation, 2000,
chapter 12).
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy import linalg

from impact_observer.dynamics.contact.projection import KEPT
from impact_observer.states import Matrix, Vector, frozen

_BLOCK = 32
"""Columns that LAPACK turns together, if it has room for them: of large matrices this takes 0.6 of
the time."""
_SQRT2 = math.sqrt(2.0)
_FEW = 32
"""Columns of a root that cost less than to make it triangular."""


class Correction(NamedTuple):
    """The correction of a state of ``d`` numbers by a measurement.

    Attributes:
        gain: change of the state per innovation in standard deviations, shape (d, k).
        innovation: a square root of the innovation's covariance, lower triangular, shape (k, k).
        root: a square root of the posterior covariance, lower triangular, shape (d, d).
    """

    gain: Matrix
    innovation: Matrix
    root: Matrix

    def change(self, seen: Matrix) -> Matrix:
        """The change of the state, shape (d, ...), by innovations ``seen``, shape (k, ...)."""
        return np.asarray(self.gain.dot(np.linalg.solve(self.innovation, seen)))


def lengths(rows: Matrix) -> list[float]:
    """Euclidean lengths of ``rows``: standard deviations, of rows of a covariance's root."""
    return [math.hypot(*row) for row in rows.tolist()]


def triangular(root: Matrix) -> Matrix:
    """A lower triangular square root, shape (d, d), of the same covariance; (d, any) is given."""
    d, columns = root.shape
    if columns < d:
        root = np.concatenate([root, np.zeros((d, d - columns))], axis=1)
    # LAPACK's routine itself: of small matrices checks cost more than it.
    turned = linalg.lapack.dgeqrf(root.T, _BLOCK * d)[0] if d else root.T
    found: Matrix = (turned[:d] * _upper(d)).T
    return found


def narrow(root: Matrix) -> Matrix:
    """``root``, shape (d, any), or ``triangular`` of it where it has many columns."""
    return triangular(root) if root.shape[1] > max(_FEW, len(root)) else root


@lru_cache(KEPT)
def _upper(d: int) -> Matrix:
    """Ones where an upper triangular matrix has its entries, shape (d, d)."""
    return np.asarray(frozen(np.tri(d)).T)  # column after column, as LAPACK's matrices are


def correction(
    root: Matrix,
    H: Matrix,
    noise: Matrix,
    rounded: Sequence[float] = (),
    considered: Sequence[int] = (),
) -> Correction:
    """The correction of ``z`` by measuring ``H z + noise``: the Kalman filter's array form.

    Considered parameters keep their values and variances. The others have the gain of the joint
    covariance (Schmidt, Application of state-space methods to navigation problems, 1966).

    Args:
        root: a square root of the covariance of ``z``, shape (d, any).
        H: the measurement matrix, shape (k, d).
        noise: a root of the measurement noise's covariance, with ``rounded`` positive definite,
            shape (k, any).
        rounded: standard deviations of independent noise of each measurement, k or none.
        considered: rows of ``root`` that have an error, but are not estimated.
    """
    seen, (k, d) = _seen(root, H, noise, rounded), H.shape
    joint = np.zeros((k + d, seen.shape[1]))
    joint[:k], joint[k:, seen.shape[1] - root.shape[1] :] = seen, root
    found = triangular(joint)
    gain, innovation, posterior = found[k:, :k], found[:k, :k], found[k:, k:]
    if considered:
        kept, rows = np.zeros((d, k)), list(considered)
        kept[rows], gain[rows] = gain[rows], 0.0
        posterior = triangular(np.hstack([posterior, kept]))
    return Correction(gain, innovation, posterior)


def innovation_root(
    root: Matrix, H: Matrix, noise: Matrix, rounded: Sequence[float] = ()
) -> Matrix:
    """``Correction.innovation`` alone; the arguments are those of ``correction``."""
    return triangular(_seen(root, H, noise, rounded))


def _seen(root: Matrix, H: Matrix, noise: Matrix, rounded: Sequence[float]) -> Matrix:
    """A root of the innovation's covariance, shape (k, any); its last columns are ``H root``."""
    first, seen = noise.shape[1], H.dot(root)
    last = first + len(rounded)
    found = np.zeros((len(H), last + seen.shape[1]))
    found[:, :first], found[:, last:] = noise, seen
    for i, each in enumerate(rounded):
        found[i, first + i] = each
    return found


def product(root: Matrix, D: Matrix, E: Vector) -> tuple[Vector, Matrix]:
    """Mean and a root of the covariance of ``e D x + 1/2 E e^2``, ``(e, x)`` normal about zero.

    It is the remainder of a product that was linearised about its best estimate (Garcia-Fernandez,
    Svensson, Morelande and Särkkä, Posterior linearization filter, 2015).

    Args:
        root: of the covariance of ``(e, x)``, its first row zero but for the first entry,
            shape (1 + d, 1 + c).
        D: shape (k, d).
        E: shape (k,).

    Returns:
        Shapes (k,) and (k, 1 + c).
    """
    deviation = float(root[0, 0])
    noise: Matrix = D.dot(root[1:])
    noise *= deviation
    mean: Vector = noise[:, 0] + E * (deviation * deviation / 2)
    noise[:, 0] = mean * _SQRT2
    return mean, noise


def sparse_basis(rows: Matrix) -> Matrix:
    """Another basis of the span of ``rows``, each zero where another has its pivot."""
    if len(rows) == 0:
        return rows
    pivots = linalg.qr(rows, mode="r", pivoting=True)[1][: len(rows)]
    return np.asarray(linalg.solve(rows[:, sorted(pivots.tolist())], rows))
