"""How low a gap can get between two samples, with certainty.

Two lower bounds on ``g`` over an interval; the larger one counts.

- Two parabolas, one from each end, whose curvature is a bound on ``|g''|``.
- The Taylor polynomial of order ``_ORDER`` from the left end, less a bound on its remainder; the
  least of its Bernstein coefficients. It decides where a gap stays near zero for long, such as
  that of a body at rest against its stop while others move.

Both need bounds on derivatives of ``g``. Those of the motion obey the equation of motion as well:
``M y'' = -C y' - K y + f^(k)(t)`` for ``y = q^(k)``. So ``y'^T M y' + y^T K y`` grows only as fast
as ``f^(k)`` does work, and bounds ``g^(k+1) = W^T y'`` by Cauchy and Schwarz.
"""

from math import comb, factorial

import numpy as np
from scipy import linalg

from impact_observer.model import System
from impact_observer.states import Matrix, Vector

_ORDER = 8
"""Order of the Taylor polynomial."""


class GapBounds:
    """Bounds on the gaps of one system between samples of a motion without contact."""

    def __init__(self, system: System) -> None:
        """Prepare norms of contacts and forcing."""
        self._system = system
        forcing = system.forcing
        self._Minv = linalg.inv(system.M)
        self._reach = np.sqrt(np.einsum("ij,ij->j", system.W, self._Minv @ system.W))
        amplitudes = np.stack([forcing.cosine, forcing.sine])
        self._work = np.sqrt(np.einsum("...i,...i->...", amplitudes @ self._Minv, amplitudes)).sum(
            axis=0
        )
        stiffest = float(linalg.eigh(system.K, system.M, eigvals_only=True)[-1])
        # A mode's amplitude is u / omega; a slower one has not got there within a second.
        self._slowness = 1.0 / max(stiffest, 1.0)
        self._bernstein = _bernstein(_ORDER)

    def scale(self, q: Matrix, u: Matrix) -> Matrix:
        """What gaps are rounded against: all of the motion, whose modes superpose to ``q``.

        Args:
            q: coordinates, shape (samples, n).
            u: velocities, shape (samples, n).

        Returns:
            Shape (samples - 1, m), m.
        """
        M = self._system.M
        size = np.einsum("si,si->s", q @ M, q) + np.einsum("si,si->s", u @ M, u) * self._slowness
        largest = np.sqrt(np.maximum(size[:-1], size[1:]))
        return np.asarray(np.abs(self._system.q_r) + np.outer(largest, self._reach))

    def acceleration(self, derivatives: list[Matrix], h: float) -> Matrix:
        """Bound on ``|g''|`` over intervals of length ``h``, shape (intervals, m)."""
        return self._derivative(derivatives, 2, h)

    def derivatives(self, t: Vector, q: Matrix, u: Matrix) -> list[Matrix]:
        """``q`` and its derivatives up to ``_ORDER`` along the motion, shape (samples, n) each.

        Args:
            t: s since the epoch, shape (samples,).
            q: coordinates, shape (samples, n).
            u: velocities, shape (samples, n).
        """
        system, forcing = self._system, self._system.forcing
        angle = np.outer(t, forcing.frequency)
        wave = np.exp(1j * angle)
        amplitude = forcing.cosine - 1j * forcing.sine
        found, force = [q, u], forcing.constant
        for _ in range(_ORDER - 1):
            load = force + (wave @ amplitude).real - found[-1] @ system.C.T - found[-2] @ system.K
            found.append(load @ self._Minv)
            force, amplitude = np.zeros(system.n), amplitude * 1j * forcing.frequency[:, None]
        return found

    def lower(self, g: Matrix, derivatives: list[Matrix], ends: Matrix, h: float) -> Matrix:
        """Least value that each gap can take on each interval.

        Args:
            g: gaps at the samples, shape (intervals + 1, m).
            derivatives: of the coordinates at the left ends, from ``derivatives``.
            ends: contact speeds at the samples, shape (intervals + 1, m).
            h: length of the intervals, s.

        Returns:
            Shape (intervals, m).
        """
        parabolas = _parabolas(g, ends, self.acceleration(derivatives, h), h)
        scaled = [g[:-1]] + [
            derivatives[k] @ self._system.W * (h**k / factorial(k)) for k in range(1, _ORDER)
        ]
        remainder = self._derivative(derivatives, _ORDER, h) * (h**_ORDER / factorial(_ORDER))
        polynomial = np.tensordot(self._bernstein, np.stack([*scaled, -remainder]), axes=1)
        return np.asarray(np.maximum(parabolas, polynomial.min(axis=0)))

    def _derivative(self, derivatives: list[Matrix], k: int, h: float) -> Matrix:
        """Bound on the ``k``-th derivative of each gap, shape (intervals, m)."""
        y, rate = derivatives[k - 1], derivatives[k]
        energy = np.einsum("si,si->s", rate @ self._system.M, rate)
        energy += np.einsum("si,si->s", y @ self._system.K, y)
        growth = float(self._work @ self._system.forcing.frequency ** (k - 1))
        return np.outer(np.sqrt(np.maximum(energy, 0.0)) + growth * h, self._reach)


def _bernstein(degree: int) -> Matrix:
    """Bernstein coefficients from those of powers on [0, 1], shape (degree + 1, degree + 1)."""
    rows = range(degree + 1)
    return np.array([[comb(i, j) / comb(degree, j) for j in rows] for i in rows])


def _parabolas(g: Matrix, gamma: Matrix, bound: Matrix, h: float) -> Matrix:
    """Least value above the parabolas from both ends, shape (intervals, m).

    ``g_j + gamma_j s - B s^2 / 2`` and its mirror from the other end are lower bounds; both are
    concave and differ by a linear function, so the larger of them is least at an end or where
    they meet.
    """
    left, right, rate_l, rate_r = g[:-1], g[1:], gamma[:-1], gamma[1:]
    # p_l(s) - p_r(s) = left - right + rate_r h + B h^2 / 2 + (rate_l - rate_r - B h) s
    slope = rate_l - rate_r - bound * h
    at_zero = left - right + rate_r * h + bound * h**2 / 2
    meet = np.clip(np.where(slope == 0, 0.0, -at_zero / np.where(slope == 0, 1.0, slope)), 0.0, h)
    middle = left + rate_l * meet - bound * meet**2 / 2
    return np.asarray(np.minimum(np.minimum(left, right), middle))
