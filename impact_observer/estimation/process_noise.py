"""What white noise of the accelerations makes of a state: process noise of a linear phase."""

import math

import numpy as np

from impact_observer.dynamics.flow.flow import balanced_state_matrix
from impact_observer.dynamics.flow.phase import Phase
from impact_observer.estimation.square_root import triangular
from impact_observer.states import Matrix

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
"""Of Gauss and Legendre on [-1, 1]: over the inverse of the fastest rate exact to rounding."""


def diffusion(phase: Phase, s: float, intensity: float) -> Matrix:
    """A square root of the covariance that white accelerations add in ``s`` seconds.

    ``Q(s)``, the integral of ``Phi(r) B B^T Phi(r)^T`` for r from 0 to s, by quadrature over a
    step shorter than the fastest rate's inverse, and then by ``Q(2h) = Phi(h) Q(h) Phi(h)^T +
    Q(h)``. Only motion forward in time is asked for, which never overflows.

    Args:
        phase: in which the system moves; what is held does not go astray.
        s: seconds, not negative.
        intensity: of the noise on every velocity, m/s^1.5.

    Returns:
        Shape (2n, 2n).
    """
    n = phase.equations.n
    if not (intensity and s):
        return np.zeros((2 * n, 2 * n))
    rate = float(np.linalg.norm(balanced_state_matrix(phase.equations)[0], 1))
    doublings = max(0, math.ceil(math.log2(max(s * rate, 1.0))))
    h = math.ldexp(s, -doublings)
    columns = [
        math.sqrt(weight * h / 2) * phase.transition((1 + node) * h / 2)[:, n:]
        for node, weight in zip(_NODES.tolist(), _WEIGHTS.tolist(), strict=True)
    ]
    root = triangular(intensity * np.hstack(columns))
    for k in range(doublings):
        root = triangular(np.hstack([phase.transition(math.ldexp(h, k)) @ root, root]))
    return root
