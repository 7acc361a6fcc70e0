"""Exact flow of a linear phase ``M du/dt = -C u - K q + f(t)``, ``dq/dt = u``.

Two ways lead to it. ``SpectralFlow`` splits the motion into ``n`` pairs of modes, each in closed
form; it costs a few microseconds. Where that splitting is ill-conditioned (eigenvectors of
a non-proportionally damped system that almost coincide), ``DenseFlow`` takes a matrix
exponential, a hundred times slower and indifferent to the spectrum.
"""

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from impact_observer.states import Vector


class Motion(ABC):
    """One solution of a linear phase: everything that its initial state fixes.

    Attributes:
        t: when the phase starts, s since the epoch.
    """

    t: float

    @abstractmethod
    def states(self, s: NDArray[np.float64]) -> NDArray[np.float64]:
        """States at ``s`` seconds after the phase's start.

        Args:
            s: shape (samples,), s.

        Returns:
            States (q, u), shape (samples, 2n).
        """

    def state(self, s: float) -> Vector:
        """The state (q, u), shape (2n,), at ``s`` seconds after the phase's start."""
        return np.asarray(self.states(np.array([s]))[0])


class Flow(ABC):
    """The flow of one linear phase."""

    @abstractmethod
    def start(self, t: float, x: Vector) -> Motion:
        """The motion through state ``x`` = (q, u), shape (2n,), at ``t`` s since the epoch."""
