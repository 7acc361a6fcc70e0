"""Functions of a motion in closed form, with all their derivatives.

A motion is ``T e^{Js} z`` of its pairs of modes (``spectral.py``) and a steady response, whose
harmonics go on like pairs that nothing damps. What rows ``r`` see of it needs no state: with
``r T = (r_1, .., r_n)``, a part for each pair, ::

    d^k/ds^k  r T e^{Js} z = sum_p c_p(s) r_p J_p^k z_p + S_p(s) r_p J_p^k (J_p - a_p) z_p

is a product of ``(c, S)``, which all functions and derivatives share, with numbers that stay the
same all along the motion. What bounds ``c`` and ``S`` along an interval bounds every derivative.
"""

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_observer.dynamics.flow import Motion
from impact_observer.dynamics.modes import Modes, Rates
from impact_observer.states import Matrix, Vector

ORDERS = 9
"""Orders of derivatives that are known, that of the function itself included."""


class Waves(NamedTuple):
    """``w`` functions of one motion.

    Attributes:
        rates: of ``r`` pairs, modes and harmonics.
        parts: what derivatives have of ``(c, S)``, shape (ORDERS, w, 2r).
        constant: what is added to the functions themselves, shape (w,).
    """

    rates: Rates
    parts: NDArray[np.float64]
    constant: Vector

    def derivatives(self, s: Vector, orders: int) -> NDArray[np.float64]:
        """The functions and their derivatives below ``orders``, shape (orders, samples, w)."""
        _, w, size = self.parts.shape
        basis = self.rates.propagated(s).reshape(size, s.size)
        flat = self.parts[:orders].reshape(orders * w, size) @ basis
        found = flat.reshape(orders, w, s.size)
        found[0] += self.constant[:, None]
        return np.asarray(found.transpose(0, 2, 1))

    def largest(self, order: int, start: Vector, stop: Vector) -> Matrix:
        """A bound on one derivative from each ``start`` to its ``stop``, shape (intervals, w)."""
        bounds = self.rates.largest(start, stop).reshape(-1, start.size)
        return np.asarray((np.abs(self.parts[order]) @ bounds).T)

    def shifted(self, by: Vector) -> "Waves":
        """The same functions with constants ``by``, shape (w,), more."""
        return self._replace(constant=self.constant + by)


class View(ABC):
    """Functions of the motions of one flow."""

    @abstractmethod
    def of(self, motion: Motion) -> Waves | None:
        """The functions of one motion; None where it has no closed form of that kind."""


class Rows:
    """What ``w`` functions see of the modes of a flow and of harmonics, with all derivatives."""

    def __init__(
        self, modes: Modes, seen: Matrix, frequency: Vector, harmonics: NDArray[np.complex128]
    ) -> None:
        """Prepare what is the same for all motions.

        Args:
            modes: of the flow.
            seen: what the functions see of the pairs, ``r T``, shape (w, 2n).
            frequency: of the harmonics, shape (h,), rad/s.
            harmonics: ``b`` of ``Re(b e^{i omega t})``, shape (w, h).
        """
        rows = [seen.reshape(len(seen), len(modes.J), 2)]
        for _ in range(ORDERS - 1):
            rows.append(np.einsum("wpi,pij->wpj", rows[-1], modes.J))
        self._rows = np.stack(rows)
        self._deviator = modes.deviator
        self._rates = modes.rates.beside(frequency)
        self._frequency = frequency
        self._harmonics = harmonics * (1j * frequency) ** np.arange(ORDERS)[:, None, None]

    def waves(self, t: float, z: Matrix, constant: Vector) -> Waves:
        """The functions of the motion of pairs ``z``, shape (n, 2), from ``t`` s on."""
        orders, w, n, _ = self._rows.shape
        parts = np.empty((orders, w, 2, n + self._frequency.size))
        pairs = np.stack([z, (self._deviator @ z[..., None])[..., 0]])
        np.einsum("kwpi,bpi->kwbp", self._rows, pairs, out=parts[..., :n])
        turned = self._harmonics * np.exp(1j * (self._frequency * t))
        parts[..., 0, n:] = turned.real
        parts[..., 1, n:] = -turned.imag * self._frequency
        return Waves(self._rates, parts.reshape(orders, w, -1), constant)
