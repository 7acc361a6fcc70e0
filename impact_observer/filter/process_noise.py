# SPDX-License-Identifier: Apache-2.0
"""Process noise: accelerations that the model does not have, and parameters that drift."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from impact_observer.dynamics.equations import balanced
from impact_observer.dynamics.phase import Phase
from impact_observer.filter.square_root import triangular
from impact_observer.states import Matrix, Vector

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
"""Of Gauss and Legendre on [-1, 1]: over the inverse of the fastest rate exact to rounding."""


class ProcessNoise(NamedTuple):
    """Process noise of a flight.

    Attributes:
        model_error: of the accelerations, as white noise, m/s^1.5.
        drift: standard deviation of the random walk of the parameters in a minute, shape (p,).
    """

    model_error: float
    drift: Vector

    def added_to(
        self, root: Matrix, size: int, diffusion_over: Callable[[float], Matrix], s: float
    ) -> Matrix:
        """A covariance's root with the process noise of ``s`` seconds, of any number of columns.

        Args:
            root: of (q, u), or of (q, u, constants), shape (2n or more, any).
            size: of (q, u), 2n.
            diffusion_over: ``diffusion`` of the phase, by time.
            s: seconds.
        """
        columns = [root]
        if self.model_error and s > 0:
            added = np.zeros((len(root), size))
            added[:size] = self.model_error * diffusion_over(s)
            columns.append(added)
        if np.any(self.drift) and s > 0 and len(root) > size:
            added = np.diag(self.drift * math.sqrt(s / 60.0))
            columns.append(np.pad(added, ((size, len(root) - size - len(added)), (0, 0))))
        return np.concatenate(columns, axis=1) if len(columns) > 1 else root


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
