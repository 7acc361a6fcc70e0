# SPDX-License-Identifier: Apache-2.0
"""The forcing ``f(t)`` of a system: constant, harmonics, squares, samples, and its bounds."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from impact_observer.errors import ModelError
from impact_observer.model.document import finite
from impact_observer.model.force_samples import JETS, Samples
from impact_observer.model.square_waves import SquareWaves
from impact_observer.states import Matrix, Vector


@dataclass(frozen=True, slots=True, eq=False)
class Forcing:
    """``constant + sum_k cosine_k cos(omega_k t) + sine_k sin(omega_k t) + sampled + squares``.

    The displacements of moving grounds are such functions, too, without squares. Their unit is m.

    Attributes:
        constant: shape (n,), N or Nm.
        frequency: angular frequencies ``omega``, shape (h,), rad/s, each positive.
        cosine: shape (h, n), N or Nm.
        sine: shape (h, n), N or Nm.
        sampled: forces at instants; None without samples.
        squares: forces of constant size that change their sign; None without any.
    """

    constant: Vector
    frequency: Vector
    cosine: Matrix
    sine: Matrix
    sampled: Samples | None = None
    squares: SquareWaves | None = None

    @classmethod
    def none(cls, n: int) -> "Forcing":
        """The forcing of ``n`` coordinates that is always zero."""
        return cls(np.zeros(n), np.zeros(0), np.zeros((0, n)), np.zeros((0, n)))

    @classmethod
    def of_samples(cls, samples: Samples) -> "Forcing":
        """The forcing by ``samples`` alone."""
        return replace(cls.none(np.shape(samples.force)[1]), sampled=samples)

    @property
    def depends_on_time(self) -> bool:
        """Whether ``f`` is not constant: it has samples, or a wave with an amplitude."""
        waves = [self.cosine, self.sine] + ([] if self.squares is None else [self.squares.force])
        return self.sampled is not None or any(bool(np.any(each)) for each in waves)

    @property
    def fastest(self) -> float:
        """The largest angular frequency, rad/s; 0 without any."""
        squares = np.zeros(0) if self.squares is None else self.squares.frequency
        return float(max([0.0, *self.frequency, *squares]))

    @property
    def end(self) -> float:
        """Instant of the last sample, s since the epoch; infinity without samples."""
        return np.inf if self.sampled is None else self.sampled.end

    @property
    def sampled_at(self) -> Vector | None:
        """Instants of the samples, s since the epoch: another array once live samples come."""
        return None if self.sampled is None else self.sampled.time

    def held(self, t: float) -> str:
        """A warning if ``t``, s since the epoch, is after the last sample; otherwise empty."""
        if t <= self.end:
            return ""
        return (
            f"forcing.sampled: the samples end at t = {self.end:.9g} s; from then on their last"
            " force is held"
        )

    def __call__(self, t: float) -> Vector:
        """``f(t)``, shape (n,), at ``t`` seconds since the epoch.

        Raises:
            DynamicsError: ``t`` lies before the first sample.
        """
        return np.asarray(self.derivatives(np.array([t]), 0)[0, 0])

    def derivatives(self, t: Vector, order: int) -> NDArray[np.float64]:
        """``f`` and its time derivatives up to ``order``; after the jump where ``f`` jumps.

        Args:
            t: s since the epoch, shape (samples,).
            order: the highest derivative.

        Returns:
            Shape (order + 1, samples, n).

        Raises:
            DynamicsError: some ``t`` lies before the first sample.
        """
        jets = np.zeros((order + 1, t.size, self.constant.size))
        jets[0] = self.constant
        if self.frequency.size:
            rate, angle = self.frequency, t[:, None] * self.frequency
            cosine, sine = np.cos(angle), np.sin(angle)
            for k in range(order + 1):
                jets[k] += cosine @ self.cosine + sine @ self.sine
                cosine, sine = -rate * sine, rate * cosine
        if self.sampled is not None:
            jets[:JETS] += self.sampled.derivatives(t)[: order + 1]
        if self.squares is not None:
            jets[0] += self.squares.values(t)
        return jets

    def bound(self, X: Matrix) -> Callable[[int, Vector], Vector]:
        """A bound on the size of ``f`` and its derivatives in the metric ``X`` >= 0, shape (n, n).

        Returns:
            A function of ``k`` and ``t``, s since the epoch, shape (samples,): an upper bound of
            ``sqrt(f^(k)' X f^(k))`` from each ``t`` to the next knot, shape (samples,). It raises
            DynamicsError before the first sample.
        """
        constant = float(_norms(self.constant, X))
        if self.squares is not None:
            constant += float(np.sum(_norms(self.squares.force, X)))
        amplitudes = _norms(self.cosine, X) + _norms(self.sine, X)
        sampled = None if self.sampled is None else _bound_of_samples(self.sampled, X)
        rates = self.frequency

        def bounded(k: int, t: Vector) -> Vector:
            size = float(amplitudes @ rates**k)
            smooth = np.full(t.shape, size if k else size + constant)
            return smooth if sampled is None else smooth + sampled(k, t)

        return bounded

    def knots(self, start: float, stop: float) -> Vector:
        """Instants in (``start``, ``stop``), s since the epoch, where ``f`` is not smooth."""
        knots = np.zeros(0) if self.sampled is None else self.sampled.knots(start, stop)
        if self.squares is None:
            return knots
        return np.union1d(knots, start + self.squares.switches(start, stop - start))

    def plus(self, constant: Vector) -> "Forcing":
        """The forcing ``f(t) + constant``, shape (n,)."""
        return replace(self, constant=self.constant + constant)

    def added(self, other: "Forcing") -> "Forcing":
        """The sum with ``other``; the harmonics of ``other`` come last."""
        sampled = self.sampled or other.sampled
        if self.sampled is not None and other.sampled is not None:
            sampled = self.sampled.plus(other.sampled)
        squares = self.squares or other.squares
        if self.squares is not None and other.squares is not None:
            squares = self.squares.plus(other.squares)
        return Forcing(
            self.constant + other.constant,
            np.concatenate([self.frequency, other.frequency]),
            np.vstack([self.cosine, other.cosine]),
            np.vstack([self.sine, other.sine]),
            sampled,
            squares,
        )

    def responded(self, P: Matrix, Q: Matrix, R: Matrix) -> "Forcing":
        """The forcing ``P f + Q df/dt + R d2f/dt2``, for matrices of shape (r, n).

        The response has as many harmonics as ``f``, which has no squares.
        """
        omega, c, s, sampled = self.frequency[:, None], self.cosine, self.sine, self.sampled
        if sampled is not None:
            rate = sampled.derivative()
            jets = [sampled.jets, rate.jets, rate.derivative().jets]
            terms = [part @ T.T for part, T in zip(jets, (P, Q, R), strict=True)]
            sampled = Samples.of_jets(sampled.time, np.sum(terms, axis=0))
        return Forcing(
            P @ self.constant,
            self.frequency,
            c @ P.T + omega * (s @ Q.T) - omega**2 * (c @ R.T),
            s @ P.T - omega * (c @ Q.T) - omega**2 * (s @ R.T),
            sampled,
        )

    def checked(self, n: int) -> "Forcing":
        """The same forcing of ``n`` coordinates, copied, frozen and checked.

        Raises:
            ModelError: a value is wrong; the error names the key of the model file.
        """
        h, wanted = np.size(self.frequency), f"{n} numbers, one a coordinate"
        driven = {"sampled.force": self.sampled, "squares.amplitude": self.squares}
        for key, part in driven.items():
            if part is not None and part.force.shape[1] != n:
                columns = part.force.shape[1]
                raise ModelError(f"forcing.{key}", f"has {columns} columns; expected {n}")
        frequency = finite("forcing.harmonics.frequency", self.frequency, (h,), "a list")
        if np.any(frequency <= 0):
            problem = f"is {np.min(frequency):g}; expected positive numbers, rad/s"
            raise ModelError("forcing.harmonics.frequency", problem)
        rows = f"{h} rows, one a frequency, of {n} numbers"
        return Forcing(
            finite("forcing.constant", self.constant, (n,), wanted),
            frequency,
            finite("forcing.harmonics.cosine", self.cosine, (h, n), rows),
            finite("forcing.harmonics.sine", self.sine, (h, n), rows),
            self.sampled,
            self.squares,
        )


def _norms(forces: NDArray[np.float64], X: Matrix) -> NDArray[np.float64]:
    """``sqrt(f' X f)`` of forces, shape (..., n)."""
    return np.asarray(np.sqrt(np.maximum(np.einsum("...i,...i->...", forces @ X, forces), 0.0)))


def _bound_of_samples(samples: Samples, X: Matrix) -> Callable[[int, Vector], Vector]:
    """The bound of ``Forcing.bound`` for samples.

    A cubic is nowhere larger than the sum of the sizes of its terms at the end of its interval.
    """

    def bounded(k: int, t: Vector) -> Vector:
        j = samples.index(t)
        if k >= JETS:
            return np.zeros(t.shape)
        last = samples.time.size - 1
        after = np.minimum(j + 1, last)
        if samples.hold == "linear" and k == 0:  # a linear force is largest at an end
            ends = _norms(samples.force[np.stack([j, after])], X)
            return np.asarray(np.max(ends, axis=0))
        step, factor = samples.time[after] - samples.time[j], np.ones(t.shape)
        total = _norms(samples.jets[k, j], X)
        for order in range(k + 1, JETS):
            factor = factor * step / (order - k)
            total = total + factor * _norms(samples.jets[order, j], X)
        return np.asarray(total)

    return bounded
