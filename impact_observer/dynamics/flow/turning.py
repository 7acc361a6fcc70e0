"""One state of a motion whose modes all oscillate, for the price of one complex exponential.

A block ``J = a + D``, ``D^2 = -d^2``, turns a complex number: with ``zeta = y_1 + i (D y)_1 / d``
it is ``zeta(s) = e^{(a - i d) s} zeta(0)``. Harmonics turn too, without decay, and a constant is
one of no frequency. So all of a state is ``V e^{lambda s} zeta``, real and imaginary parts one
after the other. Many states together are cheaper by real functions (``spectral.py``); of one
alone nothing costs but the calls.
"""

from math import cos, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_observer.dynamics.flow.angles import Angles
from impact_observer.dynamics.flow.divided_differences import Complex
from impact_observer.dynamics.flow.modes import Modes
from impact_observer.states import Matrix, Vector

_SWINGING = 0.1
"""Least frequency of a pair, over its decay, for which ``zeta`` keeps its digits."""


class Steady(NamedTuple):
    """``constant + sum_k cosine_k cos(omega_k t) + sine_k sin(omega_k t)`` of states.

    Attributes:
        angles: of the ``h`` harmonics.
        constant: shape (2n,).
        cosine: shape (2n, h).
        sine: shape (2n, h).
    """

    angles: Angles
    constant: Vector
    cosine: Matrix
    sine: Matrix


class Turning:
    """What turns in the motions of one flow."""

    def __init__(self, modes: Modes, steady: Steady) -> None:
        """Take ``modes`` that ``suits`` says yes of, and the response to the forcing."""
        a, d = modes.rates.a, modes.rates.d
        to_pair = _to_pairs(modes)
        frequency = steady.angles.frequency
        n, h = d.size, frequency.size
        pairs = modes.T.reshape(2 * n, n, 1, 2) @ to_pair
        self._V = np.zeros((2 * n, 2 * (n + h + 1)))
        self._V[:, : 2 * n] = pairs.reshape(2 * n, 2 * n)
        self._V[:, 2 * n : -2 : 2], self._V[:, 2 * n + 1 : -2 : 2] = steady.cosine, steady.sine
        self._V[:, -2] = steady.constant
        inverse = np.linalg.inv(to_pair) @ modes.T_inverse.reshape(n, 2, 2 * n)
        # From the state, and cosine and sine of each harmonic; a constant has 1 and 0.
        self._start = np.eye(2 * (n + h + 1), 2 * (n + h) + 1)
        self._start[: 2 * n, : 2 * n] = inverse.reshape(2 * n, 2 * n)
        self._start[: 2 * n, 2 * n :] = -self._start[: 2 * n, : 2 * n] @ self._V[:, 2 * n : -1]
        shapes = pairs[..., 0, 0] - 1j * pairs[..., 0, 1]
        amplitudes = inverse[:, 0] + 1j * inverse[:, 1]
        # Differences turn by e^{lambda s} only: what that makes of a unit, in all its places.
        places = np.einsum("xp,py->xyp", shapes, amplitudes).conj()
        self._places = places.reshape(4 * n * n, n).view(np.float64)
        self._angles = steady.angles
        self._rates = np.concatenate([a - 1j * d, 1j * np.append(frequency, 0.0)])
        self._turns = self._rates[:n]

    @staticmethod
    def suits(modes: Modes) -> bool:
        """Whether all pairs oscillate by more than rounding."""
        rates = modes.rates
        return bool(np.all(rates.oscillates & (rates.d >= _SWINGING * np.abs(rates.a))))

    def start(self, t: float, x: Vector) -> Complex:
        """``zeta`` of the motion through ``x`` at ``t``, with what harmonics are then."""
        known = x.tolist()
        for angle in self._angles.at(t):
            known += cos(angle), sin(angle)
        known.append(1.0)
        zeta: Complex = self._start.dot(known).view(np.complex128)
        return zeta

    def state(self, zeta: Complex, s: float) -> Vector:
        """The state (q, u), shape (2n,), ``s`` seconds after the start."""
        turned = self._rates.dot(s)
        np.exp(turned, out=turned)
        np.multiply(turned, zeta, out=turned)
        x: Vector = self._V.dot(turned.view(np.float64))
        return x

    def transition(self, s: float) -> Matrix:
        """How the difference of two motions goes on in ``s`` seconds, shape (2n, 2n)."""
        turned = self._turns.dot(s)
        np.exp(turned, out=turned)
        return self._transition(turned)

    def moved(self, zeta: Complex, s: float) -> tuple[Vector, Matrix]:
        """``state``, in every bit, and ``transition``."""
        turned = self._rates.dot(s)
        np.exp(turned, out=turned)
        x: Vector = self._V.dot((turned * zeta).view(np.float64))
        return x, self._transition(turned[: self._turns.size])

    def _transition(self, turned: Complex) -> Matrix:
        """``transition`` by the complex exponentials of the pairs, shape (n,)."""
        n = turned.size
        found: Matrix = self._places.dot(turned.view(np.float64)).reshape(2 * n, 2 * n)
        return found

    def each(self, zeta: Complex, s: Vector) -> NDArray[np.float64]:
        """``state`` at each of ``s``, in every bit, shape (samples, 2n).

        Products of a matrix with one column, over and over: one with many columns may add up in
        another order.
        """
        turned = (np.exp(np.multiply.outer(s, self._rates)) * zeta).view(np.float64)
        return np.asarray((self._V @ turned[..., None])[..., 0])


def _to_pairs(modes: Modes) -> NDArray[np.float64]:
    """``R`` of ``y = R (Re zeta, Im zeta)``, shape (n, 2, 2)."""
    D, d = modes.deviator, modes.rates.d
    R = np.zeros(D.shape)
    R[:, 0, 0] = 1.0
    R[:, 1, 0], R[:, 1, 1] = -D[:, 0, 0] / D[:, 0, 1], d / D[:, 0, 1]
    return R
