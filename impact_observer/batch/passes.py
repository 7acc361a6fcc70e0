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
WORTH = 3.0
"""Logarithm of the odds by which one more kind of noise must explain a recording better."""


class NoiseSizes(NamedTuple):
    """Sizes of the noises.

    Attributes:
        clock: standard deviation of a stamp, s.
        scatter: standard deviation of a speed of rebound, over the speed of approach.
        model: error of accelerations, over the usual acceleration of each coordinate.
    """

    clock: float
    scatter: float = 0.0
    model: float = 0.0

    @property
    def price(self) -> float:
        """Logarithm of the odds by which the optional kinds must explain a recording better."""
        return WORTH * ((self.scatter > 0) + (self.model > 0))


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


class Update(NamedTuple):
    """A measurement.

    Attributes:
        innovation: in standard deviations.
        spread: this standard deviation, s or the unit of the sample.
        gain: what the unknown moves by for an innovation of one deviation, shape (N,).
        seen: ``S' h`` over the deviation, shape (any,).
        noise: that of the measurement over the deviation.
    """

    innovation: float
    spread: float
    gain: Vector
    seen: Vector
    noise: float


class StepTrace(NamedTuple):
    """A step on the way forward.

    Attributes:
        node: the unknown at the end of the step, before the measurements.
        root: after the measurements, shape (N, N).
        kept: part of ``e`` before the step by ``e`` after the step, shape (N, N).
        lost: part of ``e`` before the step on which nothing later depends, shape (N, any).
        updates: the measurements.
    """

    node: Gaussian
    root: Matrix
    kept: Matrix
    lost: Matrix
    updates: Sequence[Update]


class Forward(NamedTuple):
    """The way to the last node.

    Attributes:
        log_density: logarithm of the density of all that is measured.
        traces: of the steps.
    """

    log_density: float
    traces: Sequence[StepTrace]


class Backward(NamedTuple):
    """The unknowns by all measurements.

    Attributes:
        nodes: at each node, shape (K + 1, N) and (K + 1, N, any).
        joint: roots of the covariance of the unknown at the end of each step, and below of that at
            its beginning, shape (K, 2N, any).
    """

    nodes: Gaussian
    joint: Array


def forward(prior: Gaussian, steps: Sequence[LinearStep], sizes: NoiseSizes) -> Forward:
    """Pass through all steps.

    Args:
        prior: at the first node, shape (N,) and (N, N).
        steps: K steps.
        sizes: of the noises.
    """
    a, S, N = prior.mean.copy(), prior.root, prior.mean.size
    whole, nothing, traces, log_density = np.eye(N), np.zeros((N, 0)), list[StepTrace](), 0.0
    for step in steps:
        d, size = len(step.T), sizes.scatter if step.is_jump else sizes.model
        a[:d] = step.T @ a + step.offset
        S = np.concatenate([step.T @ S, S[d:]])
        kept, lost = whole, nothing
        if size and step.noise.size:
            q = step.noise.shape[1]
            wide = np.zeros((N + q, N))
            wide[:N], wide[N:, :d] = S.T, size * step.noise.T
            Q, R = np.linalg.qr(wide, mode="complete")
            S, kept, lost = R[:N].T, Q[:N, :N], Q[:N, N:]
        node, updates = Gaussian(a.copy(), S), list[Update]()
        for row in step.rows:
            sigma = row.deviation * (sizes.clock if row.is_instant else 1.0)
            u = row.h @ S
            s = float(np.sqrt(sigma**2 + u @ u))
            nu, seen = -(row.value + float(row.h @ a)) / s, u / s
            gain = S @ seen
            a += gain * nu
            S = S - np.outer(gain, seen / (1 + sigma / s))
            log_density -= nu * nu / 2 + float(np.log(s)) + float(np.log(2 * np.pi)) / 2
            updates.append(Update(nu, s, gain, seen, sigma / s))
        traces.append(StepTrace(node, S, kept, lost, updates))
    return Forward(log_density, traces)


def backward(prior: Gaussian, way: Forward) -> Backward:
    """Return the unknowns at all nodes by all measurements.

    Args:
        prior: at the first node, as for ``forward``.
        way: from there.
    """
    K, N = len(way.traces), prior.mean.size
    mu, Z = np.zeros(N), np.eye(N)
    means, roots = np.empty((K + 1, N)), np.empty((K + 1, N, N))
    width = N + max((each.lost.shape[1] for each in way.traces), default=0)
    joint = np.zeros((K, 2 * N, width))
    for k in range(K - 1, -1, -1):
        trace = way.traces[k]
        for update in reversed(trace.updates):
            seen, share = update.seen, update.seen / (1 + update.noise)
            mu = mu - share * (seen @ mu) + seen * update.innovation
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
