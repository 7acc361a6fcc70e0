"""Pairs of modes that harmonics drive, answered from a phase's start on: resonance included.

From rest a pair answers ``b e^{mu s}`` by ``phi_1 b + phi_2 (J - l_1) b`` with the divided
differences ``phi_1 = exp[l_1, mu]`` and ``phi_2 = exp[l_1, l_2, mu]`` of the exponential.
"""

import numpy as np
from numpy.typing import NDArray

from impact_observer.dynamics.flow.angles import Angles
from impact_observer.dynamics.flow.divided_differences import Complex, first, second
from impact_observer.dynamics.flow.modes import Modes
from impact_observer.states import Vector


class Driven:
    """Pairs and the harmonics that drive them.

    Attributes:
        block: a pair for each of ``r`` answers, shape (r,).
        harmonic: which harmonic drives it, 0 for the constant, shape (r,).
        mu: that harmonic's ``i omega``, shape (r,), 1/s.
        beta: its load on the pair at ``t = 0``, shape (r, 2).
        turned: ``(J - l_1) beta``, shape (r, 2).
    """

    def __init__(
        self, modes: Modes, beta: Complex, angles: Angles, driven: NDArray[np.bool_]
    ) -> None:
        """Take loads ``beta``, shape (n, 1 + h, 2), of those that are ``driven``, (n, 1 + h)."""
        block, harmonic = np.nonzero(driven)
        one, two = modes.eigenvalues
        self.block, self.harmonic = block, harmonic
        self._angles = angles
        self._one, self._two = one[block], two[block]
        self.mu = 1j * np.concatenate([[0.0], angles.frequency])[harmonic]
        to_one = (modes.rates.a[block] - self._one)[:, None, None] * np.eye(2)
        self.beta = beta[block, harmonic]
        self.turned = ((modes.deviator[block] + to_one) @ self.beta[..., None])[..., 0]

    @property
    def nothing(self) -> bool:
        """Whether nothing is driven (gravity on a free body is)."""
        return self.block.size == 0

    def phases(self, t: float) -> Complex:
        """What loads have turned by until ``t`` s since the epoch, shape (r,)."""
        return np.asarray(np.exp(1j * np.array([0.0, *self._angles.at(t)])[self.harmonic]))

    def answers(self, s: Vector) -> Complex:
        """``phi_1`` and ``phi_2``, shape (2, r, samples)."""
        s = s[:, None]
        phi_2 = second(self._one, self._two, self.mu, s)
        return np.stack([first(self._one, self.mu, s).T, phi_2.T])

    def largest(self, stop: Vector) -> NDArray[np.float64]:
        """Bounds on their sizes until each ``stop``, shape (2, r, intervals).

        No point has a positive real part: a difference of order ``k`` is at most ``s^k / k!``,
        and at most the sum of two of order ``k - 1`` over the distance of two points.
        """
        near, far, both = (
            np.divide(1.0, gap, out=np.full(gap.shape, np.inf), where=gap > 0)[:, None]
            for gap in map(
                np.abs, (self._one - self.mu, self._two - self.mu, self._one - self._two)
            )
        )
        one = np.minimum(stop, 2 * near)
        other = np.minimum(np.minimum(stop, 2 * far), 2 * both)
        once = np.where(
            np.isinf(near), np.inf, (one + other) * np.where(np.isinf(near), 1.0, near)
        )
        return np.stack([one, np.minimum(stop**2 / 2, once)])

    def response(self, t: float, y: NDArray[np.float64], s: Vector) -> NDArray[np.float64]:
        """Pairs ``y``, shape (n, 2, samples), and their answer since ``t``."""
        if self.nothing:
            return y
        phi_1, phi_2 = self.answers(s)[:, :, None]
        phases = self.phases(t)[:, None]
        loads, turned = (self.beta * phases)[..., None], (self.turned * phases)[..., None]
        answer = phi_1 * loads + phi_2 * turned
        y = y.copy()
        for k, pair in enumerate(self.block):
            y[pair] += answer[k].real
        return y
