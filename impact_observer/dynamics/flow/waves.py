"""Functions of a motion in closed form, with all their derivatives.

A motion is ``T e^{Js} z`` of its pairs of modes (``spectral.py``) and a steady response, whose
harmonics go on like pairs that nothing damps. What rows ``r`` see of it needs no state: with
``r T = (r_1, .., r_n)``, a part for each pair, ::

    d^k/ds^k  r T e^{Js} z = sum_p c_p(s) r_p J_p^k z_p + S_p(s) r_p J_p^k (J_p - a_p) z_p

is a product of ``(c, S)``, which all functions and derivatives share, with numbers that stay the
same all along the motion. What bounds ``c`` and ``S`` along an interval bounds every derivative.
"""

from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_observer.dynamics.flow.angles import Angles
from impact_observer.dynamics.flow.driven import Driven
from impact_observer.dynamics.flow.flow import Motion
from impact_observer.dynamics.flow.modes import Modes, Rates
from impact_observer.states import Matrix, Vector

ORDERS = 9
"""Number of derivatives available, the function itself included."""


class Waves(NamedTuple):
    """``w`` functions of one motion.

    Attributes:
        rates: of pairs, modes and harmonics.
        driven: pairs that answer harmonics from the start of the motion on.
        parts: what derivatives have of ``(c, S)`` and of the real and imaginary parts of those
            answers, shape (ORDERS, w, size).
        constant: what is added to the derivatives, shape (ORDERS, w).
    """

    rates: Rates
    driven: Driven
    parts: NDArray[np.float64]
    constant: Matrix

    def derivatives(self, s: Vector, orders: int) -> NDArray[np.float64]:
        """The functions and their derivatives below ``orders``, shape (orders, samples, w)."""
        _, w, size = self.parts.shape
        basis = _rows(self.rates.propagated(s))
        if not self.driven.nothing:
            answers = _rows(self.driven.answers(s))
            basis = np.vstack([basis, answers.real, answers.imag])
        flat = self.parts[:orders].reshape(orders * w, size) @ basis
        found = flat.reshape(orders, w, s.size) + self.constant[:orders, :, None]
        return np.asarray(found.transpose(0, 2, 1))

    def largest(self, order: int, start: Vector, stop: Vector) -> Matrix:
        """A bound on one derivative from each ``start`` to its ``stop``, shape (intervals, w)."""
        bounds = _rows(self.rates.largest(start, stop))
        if not self.driven.nothing:
            answers = _rows(self.driven.largest(stop))
            bounds = np.vstack([bounds, answers, answers])
        return np.asarray((np.abs(self.parts[order]) @ bounds).T + np.abs(self.constant[order]))

    def shifted(self, by: Vector) -> "Waves":
        """The same functions with constants ``by``, shape (w,), more."""
        constant = self.constant.copy()
        constant[0] += by
        return self._replace(constant=constant)


class Aging(NamedTuple):
    """The same functions in one way early in a motion and in another one later.

    Attributes:
        early: what drives the motion answered from its start on.
        late: with steady responses.
        age: when it is late, s since the start.
    """

    early: Waves
    late: Waves
    age: float

    def derivatives(self, s: Vector, orders: int) -> NDArray[np.float64]:
        """As of waves."""
        young = s < self.age
        if young.all() or not young.any():
            return (self.early if young.any() else self.late).derivatives(s, orders)
        found = np.empty((orders, s.size, self.early.constant.shape[1]))
        found[:, young] = self.early.derivatives(s[young], orders)
        found[:, ~young] = self.late.derivatives(s[~young], orders)
        return found

    def largest(self, order: int, start: Vector, stop: Vector) -> Matrix:
        """As of waves."""
        young = start < self.age
        found = np.empty((start.size, self.early.constant.shape[1]))
        for waves, which in ((self.early, young), (self.late, ~young)):
            if which.any():
                found[which] = waves.largest(order, start[which], stop[which])
        return found

    def shifted(self, by: Vector) -> "Aging":
        """The same functions with constants ``by``, shape (w,), more."""
        return self._replace(early=self.early.shifted(by), late=self.late.shifted(by))


def _rows(blocks: NDArray[Any]) -> NDArray[Any]:
    """Blocks one below the other: shape (2, r, samples) as (2r, samples)."""
    return blocks.reshape(2 * blocks.shape[1], blocks.shape[2])


class View(ABC):
    """Functions of the motions of one flow."""

    @abstractmethod
    def of(self, motion: Motion) -> Waves | Aging | None:
        """The functions of one motion; None where it has no closed form of that kind."""


class Rows:
    """What ``w`` functions see of the modes of a flow and of harmonics, with all derivatives."""

    def __init__(
        self,
        modes: Modes,
        seen: Matrix,
        steady: tuple[Angles, NDArray[np.complex128], Vector],
        driven: Driven,
    ) -> None:
        """Prepare what is the same for all motions.

        Args:
            modes: of the flow.
            seen: what the functions see of the pairs, ``r T``, shape (w, 2n).
            steady: angles of ``h`` harmonics; ``b`` of ``Re(b e^{i omega t})``, shape (w, h);
                and a constant, shape (w,).
            driven: pairs that answer harmonics from the start of a motion on.
        """
        rows = [seen.reshape(len(seen), len(modes.J), 2)]
        for _ in range(ORDERS - 1):
            rows.append((rows[-1][..., None, :] @ modes.J)[..., 0, :])
        self._rows = np.stack(rows)
        self._deviator = modes.deviator
        self._angles, harmonics, constant = steady
        self._frequency = self._angles.frequency
        self._rates = modes.rates.beside(self._frequency)
        self._harmonics = harmonics * (1j * self._frequency) ** np.arange(ORDERS)[:, None, None]
        self._constant = np.zeros((ORDERS, len(seen)))
        self._constant[0] = constant
        self._driven = driven
        if not driven.nothing:
            self._prepare_driven()

    def _prepare_driven(self) -> None:
        """Answers ``y' = J y + b e^{mu s}``: each derivative has more of the harmonic itself."""
        driven = self._driven
        rows = self._rows[:, :, driven.block]
        self._loads = np.einsum("kwri,ri->kwr", rows, driven.beta)
        self._turned = np.einsum("kwri,ri->kwr", rows, driven.turned)
        direct = [np.zeros_like(self._loads[0])]
        for load in self._loads[:-1]:
            direct.append(driven.mu * direct[-1] + load)
        self._direct = np.stack(direct)
        self._of = np.eye(1 + self._frequency.size)[driven.harmonic]

    def waves(self, t: float, z: Matrix) -> Waves:
        """The functions of the motion of pairs ``z``, shape (n, 2), from ``t`` s on."""
        orders, w, n, _ = self._rows.shape
        h, r = self._frequency.size, self._driven.block.size
        parts = np.empty((orders, w, 2 * (n + h) + 4 * r))
        of_rates = np.empty((orders, w, 2, n + h))
        pairs = np.stack([z, (self._deviator @ z[..., None])[..., 0]])
        of_rates[..., :n] = np.einsum("kwpi,bpi->kwbp", self._rows, pairs)
        turned = np.exp(1j * np.array(self._angles.at(t)))
        harmonics, constant = self._harmonics * turned, self._constant
        if r:
            phases = self._driven.phases(t)
            answers = np.concatenate([self._loads * phases, self._turned * phases], axis=-1)
            parts[..., -4 * r : -2 * r], parts[..., -2 * r :] = answers.real, -answers.imag
            direct = (self._direct * phases) @ self._of
            harmonics, constant = harmonics + direct[..., 1:], constant + direct[..., 0].real
        of_rates[..., 0, n:] = harmonics.real
        of_rates[..., 1, n:] = -harmonics.imag * self._frequency
        parts[..., : 2 * (n + h)] = of_rates.reshape(orders, w, 2 * (n + h))
        return Waves(self._rates, self._driven, parts, constant)
