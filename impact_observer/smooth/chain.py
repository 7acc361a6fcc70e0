# SPDX-License-Identifier: Apache-2.0
"""Smoothing of a chain of linear steps with normal errors, by square roots alone.

An estimate with a square root ``S`` of its covariance stands for ``z = mean + S zeta``, where
``zeta`` are independent errors of variance one. A step and its measurement turn the errors: by an
orthogonal matrix the errors before the step are functions of the innovation, which is known, of
the errors after the step, and of errors that no later measurement concerns. A backward pass of
orthogonal matrices gives the mean and covariance of ``zeta`` given all measurements; the smoothed
state is ``mean + S E[zeta]``. No matrix is inverted and no covariances are subtracted: jumps
without rebound, exact measurements and stamps of 1 ns do no harm, and no smoothed variance exceeds
the filtered one.

The method is the smoother of Bryson and Frazier (Bierman, Factorization Methods for Discrete
Sequential Estimation, 1977, chapter 10) with the adjoint state and its covariance scaled by ``S``.
"""

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from scipy import linalg

from impact_observer.errors import DynamicsError
from impact_observer.filter.square_root import triangular
from impact_observer.states import Matrix, Vector

_NOTHING = np.zeros(0)


class Step(NamedTuple):
    """``z' = A z + b + N w``, and then ``H z' + V v = y`` is measured; w and v are white noise.

    Attributes:
        A: shape (d', d).
        b: shape (d',).
        N: shape (d', any).
        H: shape (k, d'); k is 0 without a measurement.
        y: shape (k,).
        V: shape (k, any), of rank k unless ``H`` and the prior make the innovation's covariance
            regular.
        density: a further term of the evidence, such as the logarithm of a factor of units.
    """

    A: Matrix
    b: Vector
    N: Matrix
    H: Matrix
    y: Vector
    V: Matrix
    density: float = 0.0

    @classmethod
    def unmeasured(cls, A: Matrix, b: Vector, N: Matrix | None = None) -> "Step":
        """A step without a measurement; ``N`` is None without noise."""
        d = len(b)
        noise = np.zeros((d, 0)) if N is None else N
        return cls(A, b, noise, np.zeros((0, d)), np.zeros(0), np.zeros((0, 0)))

    def preceded_by(self, first: "Step") -> "Step":
        """One step for ``first``, which has no measurement, and then this step."""
        assert not first.y.size, "a measurement cannot be put off"
        noise = np.hstack([self.A @ first.N, self.N])
        return self._replace(A=self.A @ first.A, b=self.A @ first.b + self.b, N=noise)


class Normal(NamedTuple):
    """A normal vector.

    Attributes:
        mean: shape (d,).
        root: a square root of the covariance, shape (d, any).
    """

    mean: Vector
    root: Matrix

    def mapped(self, A: Matrix, b: Vector, N: Matrix | None = None) -> "Normal":
        """``A z + b``, and noise with the root ``N``, if any."""
        root = A @ self.root
        return Normal(A @ self.mean + b, root if N is None else np.hstack([root, N]))

    @property
    def deviations(self) -> Vector:
        """Standard deviations, shape (d,)."""
        return np.asarray(np.sqrt(np.einsum("ij,ij->i", self.root, self.root)))

    @property
    def covariance(self) -> Matrix:
        """Shape (d, d)."""
        return np.asarray(self.root @ self.root.T)


class _Turn(NamedTuple):
    """The errors before a step as a function of the errors after the step.

    Attributes:
        known: their mean by the innovation, shape (c,).
        Q: their rows of the orthogonal matrix, first for the errors after the step, then for
            errors that no later measurement concerns, shape (c, any).
    """

    known: Vector
    Q: Matrix

    def back(self, later: Normal) -> Normal:
        """The errors before the step, from the errors after the step."""
        d = later.mean.size
        root = np.hstack([self.Q[:, :d] @ later.root, self.Q[:, d:]])
        return Normal(self.known + self.Q[:, :d] @ later.mean, _lower(root))


class Chain:
    """Steps from the prior of a first state.

    Attributes:
        first: the state before the first step.
        count: number of steps.
        step: gives the step of an index; called twice for each step.
        evidence: logarithm of the probability density of all measurements. ``states`` sets
            ``evidence`` when it begins.
    """

    def __init__(self, first: Normal, count: int, step: Callable[[int], Step]) -> None:
        """See the attributes."""
        self.first, self.count, self.step = first, count, step
        self.evidence = 0.0

    def states(self) -> Iterator[tuple[int, Normal]]:
        """Index and state after each step given all measurements, the last step first.

        The index -1 comes last, with the first state. The forward pass keeps one state a block of
        steps, so that the memory grows with the square root of the number of steps.

        Raises:
            DynamicsError: an innovation has the variance 0.
        """
        size = max(1, math.isqrt(self.count))
        blocks = [range(k, min(k + size, self.count)) for k in range(0, self.count, size)]
        kept, self.evidence = [self.first], 0.0
        for block in blocks:
            state = kept[-1]
            for k in block:
                state, _, density = _filtered(state, self.step(k))
                self.evidence += density
            kept.append(state)
        d = kept[-1].mean.size
        errors = Normal(np.zeros(d), np.eye(d))
        for before, block in zip(reversed(kept[:-1]), reversed(blocks), strict=True):
            states, turns = [before], list[_Turn]()
            for k in block:
                state, turn = _turned(states[-1], self.step(k))
                states.append(state)
                turns.append(turn)
            for k, state, turn in zip(
                reversed(block), reversed(states[1:]), reversed(turns), strict=True
            ):
                yield k, _given(state, errors)
                errors = turn.back(errors)
        yield -1, _given(self.first, errors)


def _given(state: Normal, errors: Normal) -> Normal:
    """The state ``mean + root zeta`` for the ``errors`` zeta."""
    return Normal(state.mean + state.root @ errors.mean, state.root @ errors.root)


def _joint(before: Normal, step: Step) -> tuple[Vector, Matrix]:
    """The mean after a step, and a root of measurement and state together.

    The root has at least as many columns as rows; the measurement's errors come first.
    """
    (k, d), own = step.H.shape, step.V.shape[1]
    root = np.concatenate([step.A.dot(before.root), step.N], axis=1)
    end = own + root.shape[1]
    joint = np.zeros((k + d, max(end, k + d)))
    joint[:k, :own], joint[:k, own:end], joint[k:, own:end] = step.V, step.H.dot(root), root
    return step.A.dot(before.mean) + step.b, joint


def _corrected(mean: Vector, joint: Matrix, step: Step) -> tuple[Normal, Vector, float]:
    """The state after a measurement, the normalised innovation, and the log density.

    ``joint`` is the triangular root of measurement and state.
    """
    k = len(step.H)
    if not k:
        return Normal(mean, joint), _NOTHING, step.density
    own, seen = joint[:k, :k], step.y - step.H.dot(mean)
    white, row = linalg.lapack.dtrtrs(own, seen, lower=1)
    if row:
        raise DynamicsError(
            "a stamp, gap or sample of the events: its innovation has the variance 0;"
            " expected more"
        )
    sizes = np.abs(np.diag(own)) * math.sqrt(2 * math.pi)
    density = step.density - float(white.dot(white)) / 2 - float(np.sum(np.log(sizes)))
    return Normal(mean + joint[k:, :k].dot(white), joint[k:, k:]), white, density


def _filtered(before: Normal, step: Step) -> tuple[Normal, Vector, float]:
    """Correct like ``_corrected``, from the state before the step."""
    mean, joint = _joint(before, step)
    return _corrected(mean, triangular(joint), step)


def _turned(before: Normal, step: Step) -> tuple[Normal, _Turn]:
    """The state after a step and its measurement, and the turn of the errors."""
    mean, joint = _joint(before, step)
    rows, columns = joint.shape
    # LAPACK's routines without scipy's checks, which cost more for small matrices.
    reflected, tau = linalg.lapack.dgeqrf(joint.T)[:2]
    whole = np.zeros((columns, columns), order="F")
    whole[:, :rows] = reflected
    after, white, _ = _corrected(mean, np.tril(reflected[:rows].T), step)
    own, k = step.V.shape[1], len(step.H)
    turn = linalg.lapack.dorgqr(whole, tau)[0][own : own + before.root.shape[1]]
    return after, _Turn(turn[:, :k].dot(white), turn[:, k:])


def _lower(root: Matrix) -> Matrix:
    """A square root of the same covariance, of as many columns as rows."""
    return triangular(root) if root.shape[1] > len(root) else root
