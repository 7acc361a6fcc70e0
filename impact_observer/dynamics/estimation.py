"""Linear estimation by square roots of covariances, ``P = S S^T``.

The roots are carried, never ``P``: stamps of 1 ns let variances fall to 1e-18 of what they were,
and the difference of two such matrices would be rounding. Every step is one orthogonal
triangulation (Kailath, Sayed and Hassibi, Linear Estimation, 2000, chapter 12).

A quantity that is the product of two unknown ones is linear about the best estimate of both, and
what is left of it is noise whose mean and variance follow from theirs: about the estimate before
a measurement, and once more about that after it (Garcia-Fernandez, Svensson, Morelande and
Särkkä, Posterior linearization filter, 2015).
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy import linalg

from impact_observer.dynamics.projection import KEPT
from impact_observer.states import Matrix, Vector, frozen

_SQRT2 = math.sqrt(2.0)


class Correction(NamedTuple):
    """What a measurement does to a state of ``d`` numbers.

    Attributes:
        gain: what the state moves by per unit of innovation, shape (d, k).
        innovation: a square root of the innovation's covariance, lower triangular, shape (k, k).
        root: a square root of the covariance after it, lower triangular, shape (d, d).
    """

    gain: Matrix
    innovation: Matrix
    root: Matrix

    @property
    def deviations(self) -> Vector:
        """Standard deviations of the innovations, shape (k,)."""
        return lengths(self.innovation)


def lengths(rows: Matrix) -> Vector:
    """Euclidean lengths of ``rows``: deviations, of rows of a covariance's root."""
    return np.asarray(np.sqrt((rows * rows).sum(axis=1)))


def triangular(root: Matrix) -> Matrix:
    """A lower triangular square root, shape (d, d), of the same covariance; (d, any) is given."""
    d, rank = len(root), min(root.shape)
    found = np.zeros((d, d))
    if rank:
        # LAPACK's routine itself: of small matrices checks cost more than it.
        found[:, :rank] = linalg.lapack.dgeqrf(root.T)[0][:rank].T
    return found * _lower(d)


@lru_cache(KEPT)
def _lower(d: int) -> Matrix:
    """Ones where a lower triangular matrix has its entries, shape (d, d)."""
    return frozen(np.tri(d))


def correction(root: Matrix, H: Matrix, noise: Matrix) -> Correction:
    """What measuring ``H z + noise`` tells of ``z``: the Kalman filter's array form.

    Args:
        root: a square root of the covariance of ``z``, shape (d, any).
        H: rows measured, shape (k, d).
        noise: a root of the measurement's own covariance, positive definite, shape (k, any).
    """
    (k, d), own = H.shape, noise.shape[1]
    joint = np.zeros((k + d, own + root.shape[1]))
    joint[:k, :own], joint[:k, own:], joint[k:, own:] = noise, H @ root, root
    found = triangular(joint)
    innovation = found[:k, :k]
    gain = found[k:, :k]
    if k:
        gain = linalg.lapack.dtrtrs(innovation, gain.T, lower=1, trans=1)[0].T
    return Correction(gain, innovation, found[k:, k:])


def product(root: Matrix, D: Matrix, E: Vector) -> tuple[Vector, Matrix]:
    """Mean and a root of the covariance of ``e D x + 1/2 E e^2``, ``(e, x)`` normal about zero.

    Args:
        root: of the covariance of ``(e, x)``, its first row zero but for the first entry,
            shape (1 + d, 1 + c).
        D: shape (k, d).
        E: shape (k,).

    Returns:
        Shapes (k,) and (k, 1 + c).
    """
    deviation, along, apart = root[0, 0], root[1:, 0], root[1:, 1:]
    mean = deviation * (D @ along + E * (deviation / 2))
    noise = np.empty((len(D), root.shape[1]))
    noise[:, 0], noise[:, 1:] = _SQRT2 * mean, deviation * (D @ apart)
    return mean, noise
