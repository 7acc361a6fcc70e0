# SPDX-License-Identifier: Apache-2.0
"""Process noise: accelerations that the model does not have."""

import math
from collections.abc import Callable

import numpy as np

from impact_observer.dynamics.equations import balanced
from impact_observer.dynamics.phase import Phase
from impact_observer.filter.square_root import triangular
from impact_observer.states import Matrix

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
"""Of Gauss and Legendre on [-1, 1]: over the inverse of the fastest rate exact to rounding."""


def with_noise(
    root: Matrix, size: int, noise: float, diffusion_over: Callable[[float], Matrix], s: float
) -> Matrix:
    """A covariance's root with the process noise of ``s`` seconds, of any number of columns.

    Args:
        root: of (q, u), or of (q, u, constants), shape (2n or more, any).
        size: of (q, u), 2n.
        noise: of the accelerations, as white noise, m/s^1.5.
        diffusion_over: ``diffusion`` of the phase, by time.
        s: seconds.
    """
    if not noise or s <= 0:
        return root
    added = np.zeros((len(root), size))
    added[:size] = noise * diffusion_over(s)
    return np.concatenate([root, added], axis=1)


def fastest_rate(A: Matrix) -> float:
    """A bound of the rates of ``dx/dt = A x``, 1/s."""
    return float(np.linalg.norm(balanced(A)[0], 1))


def diffusion(phase: Phase, s: float, rate: float) -> Matrix:
    """A square root, shape (2n, 2n), of what white accelerations add in ``s`` >= 0 seconds.

    ``Q(s)``, the integral of ``Phi(r) B B^T Phi(r)^T`` for r from 0 to s, by quadrature over a
    step shorter than the fastest rate's inverse, and then by ``Q(2h) = Phi(h) Q(h) Phi(h)^T +
    Q(h)``. Only motion forward in time is needed, which never overflows. The noise on every
    velocity has the intensity 1 m/s^1.5; contacts that are held get none. ``rate`` is the
    ``fastest_rate``.
    """
    n = phase.equations.n
    if not s:
        return np.zeros((2 * n, 2 * n))
    doublings = max(0, math.ceil(math.log2(max(s * rate, 1.0))))
    h = math.ldexp(s, -doublings)
    columns = [
        math.sqrt(weight * h / 2) * phase.transition((1 + node) * h / 2)[:, n:]
        for node, weight in zip(_NODES.tolist(), _WEIGHTS.tolist(), strict=True)
    ]
    root = triangular(np.hstack(columns))
    for k in range(doublings):
        root = triangular(np.hstack([phase.transition(math.ldexp(h, k)) @ root, root]))
    return root
