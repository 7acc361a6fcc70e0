# SPDX-License-Identifier: Apache-2.0
"""Linear steps with noise and measurements, from the first node to the last and back.

An unknown ``y = (x, theta)`` at a node is ``a + S e``, ``e`` independent numbers of unit variance.
A measurement is an orthogonal map of its noise and ``e`` to one known number, the innovation, and
the ``e`` after the measurement. A step with process noise is an orthogonal map of the noise and
``e`` to the ``e`` at its end and to numbers on which nothing later depends. So the way back is
these maps transposed, applied to the mean and the root of ``e``. Nothing is inverted, and no
covariance is subtracted: exact measurements, motions without noise and states at rest do no harm.
The measurement is Potter's (in Battin, Astronautical guidance, 1964), the step is that of
Kaminski, Bryson and Schmidt (Discrete square root filtering, 1971).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_observer.states import Matrix, Vector

Array = NDArray[np.float64]
_ALIKE = 0.05
"""Change of the size of a noise that counts as none."""


class NoiseSizes(NamedTuple):
    """Sizes of the noises of L models, each of shape (L,).

    Attributes:
        clock: standard deviation of a stamp, s.
        scatter: standard deviation of a speed of rebound, over the speed of approach.
        model: error of accelerations, over the usual acceleration of each coordinate.
    """

    clock: Vector
    scatter: Vector
    model: Vector

    def is_like(self, other: "NoiseSizes") -> bool:
        """Whether all sizes are nearly those of ``other``."""
        return all(
            np.allclose(*each, rtol=_ALIKE, atol=0.0) for each in zip(self, other, strict=True)
        )


class MeasuredRow(NamedTuple):
    """A measured number ``value + h dy``, which is zero but for noise.

    Attributes:
        h: shape (N,).
        value: where is linearised.
        deviation: of the noise; of an instant over that of the clock.
        is_instant: whether the deviation is over that of the clock.
    """

    h: Vector
    value: float
    deviation: float = 1.0
    is_instant: bool = True


class LinearStep(NamedTuple):
    """From a node to the next: ``dx' = T (dx, dtheta) + offset + noise``, and what is measured.

    Attributes:
        T: shape (2n, N).
        offset: shape (2n,).
        noise: root of the noise of unit size, shape (2n, any).
        is_jump: whether the noise is that of a rebound, else of accelerations.
        rows: measured at the end.
    """

    T: Matrix
    offset: Vector
    noise: Matrix
    is_jump: bool = False
    rows: Sequence[MeasuredRow] = ()


class Gaussian(NamedTuple):
    """Unknowns near where is linearised.

    Attributes:
        mean: shape (..., N).
        root: root of the covariance, shape (..., N, any).
    """

    mean: Array
    root: Array


class _Update(NamedTuple):
    """A measurement, over the deviation of the innovation: ``S' h``, noise and innovation."""

    seen: Vector
    noise: float
    innovation: float


class _StepTrace(NamedTuple):
    """A step by one model: node and root before measurements, root after, and the maps back."""

    node: Gaussian
    root: Matrix
    kept: Matrix
    lost: Matrix
    updates: list[_Update]


class Forward(NamedTuple):
    """The way to the last node by L models.

    Attributes:
        log_density: logarithm of the density of all that is measured, shape (L,).
        innovations: of all rows in order, in standard deviations, shape (L, R).
        spreads: these standard deviations, shape (L, R).
        last: the unknown at the last node, by the measurements up to there.
        traces: of the steps, for ``backward``; none of several models.
    """

    log_density: Vector
    innovations: Matrix
    spreads: Matrix
    last: Gaussian
    traces: list[_StepTrace]


class Backward(NamedTuple):
    """The unknowns by all measurements.

    Attributes:
        nodes: at each node, shape (K + 1, N) and (K + 1, N, any).
        joint: roots of the covariance of the unknown at the end of each step, and below of that at
            its beginning, shape (K, 2N, any).
    """

    nodes: Gaussian
    joint: Array


def forward(
    prior: Gaussian, steps: Sequence[LinearStep], sizes: NoiseSizes, *, keep: bool = False
) -> Forward:
    """Pass through all steps by L models at once.

    Args:
        prior: at the first node, shape (N,) and (N, N).
        steps: K steps.
        sizes: of L models.
        keep: whether ``backward`` will follow, of one model.
    """
    L, N = sizes.clock.size, prior.mean.size
    a = np.broadcast_to(prior.mean, (L, N)).copy()
    S = np.broadcast_to(prior.root, (L, N, N)).copy()
    log_density, traces = np.zeros(L), list[_StepTrace]()
    innovations, spreads = list[Vector](), list[Vector]()
    for step in steps:
        d = len(step.T)
        a[:, :d] = a @ step.T.T + step.offset
        S[:, :d] = step.T @ S
        kept, lost, size = np.eye(N), np.zeros((N, 0)), sizes[1 if step.is_jump else 2]
        if step.noise.size and np.any(size):
            S, kept, lost = _with_noise(S, step, size, keep=keep)
        node, updates = Gaussian(a[0].copy(), S[0].copy()), list[_Update]()
        for row in step.rows:
            sigma = row.deviation * (sizes.clock if row.is_instant else 1.0)
            u = row.h @ S
            s = np.sqrt(sigma**2 + np.einsum("ln,ln->l", u, u))
            nu = -(row.value + a @ row.h) / s
            u /= s[:, None]
            gain = np.einsum("lij,lj->li", S, u)
            a += gain * nu[:, None]
            S -= gain[:, :, None] * (u / (1 + sigma / s)[:, None])[:, None]
            log_density -= nu**2 / 2 + np.log(s)
            innovations.append(nu)
            spreads.append(s)
            if keep:
                updates.append(_Update(u[0], float((sigma / s)[0]), float(nu[0])))
        if keep:
            traces.append(_StepTrace(node, S[0].copy(), kept, lost, updates))
    log_density -= len(innovations) / 2 * np.log(2 * np.pi)
    normalized, spread = (np.reshape(each, (-1, L)).T for each in (innovations, spreads))
    return Forward(log_density, normalized, spread, Gaussian(a, S), traces)


def _with_noise(
    S: Array, step: LinearStep, size: Vector, *, keep: bool
) -> tuple[Array, Matrix, Matrix]:
    """Return roots with the noise of a step, and how ``e`` before comes from ``e`` after."""
    (L, N, _), (d, q) = S.shape, step.noise.shape
    whole = np.zeros((L, N, N + q))
    whole[:, :, :N] = S
    whole[:, :d, N:] = size[:, None, None] * step.noise
    if not keep:
        R = np.asarray(np.linalg.qr(np.swapaxes(whole, 1, 2), mode="r"))
        return np.swapaxes(R, 1, 2).copy(), np.eye(N), np.zeros((N, 0))
    Q, triangular = np.linalg.qr(whole[0].T, mode="complete")
    return triangular[None, :N].swapaxes(1, 2).copy(), Q[:N, :N], Q[:N, N:]


def backward(prior: Gaussian, way: Forward) -> Backward:
    """Return the unknowns at all nodes by all measurements.

    Args:
        prior: at the first node, as for ``forward``.
        way: by one model, with its traces.
    """
    K, N = len(way.traces), prior.mean.size
    mu, Z = np.zeros(N), np.eye(N)
    means, roots = np.empty((K + 1, N)), np.empty((K + 1, N, N))
    width = N + max((each.lost.shape[1] for each in way.traces), default=0)
    joint = np.zeros((K, 2 * N, width))
    for k in range(K - 1, -1, -1):
        trace = way.traces[k]
        for seen, noise, innovation in reversed(trace.updates):
            share = seen / (1 + noise)
            mu = mu - share * (seen @ mu) + seen * innovation
            Z = Z - np.outer(share, seen @ Z)
        means[k + 1] = trace.node.mean + trace.node.root @ mu
        roots[k + 1] = trace.node.root @ Z
        before = prior.root if k == 0 else way.traces[k - 1].root
        whole = np.hstack([trace.kept @ Z, trace.lost])
        joint[k, :N, :N] = roots[k + 1]
        joint[k, N:, : whole.shape[1]] = before @ whole
        mu = trace.kept @ mu
        Z = np.asarray(np.linalg.qr(whole.T, mode="r")).T if trace.lost.size else Z
    means[0], roots[0] = prior.mean + prior.root @ mu, prior.root @ Z
    return Backward(Gaussian(means, roots), joint)
