"""How low a watched function can get between two samples, with certainty.

Two lower bounds on ``h = a p + b u + c f(t) + d`` over an interval; the larger one counts.

- A parabola from the left end whose curvature is a bound on ``|h''|``, and, where ``h`` is a gap,
  another one from the right end.
- The Taylor polynomial of order ``_ORDER`` from the left end, less a bound on its remainder; the
  least of its Bernstein coefficients. It decides where a function stays near zero for long, such
  as the gap of a body at rest against its stop while others move.

Both need bounds on derivatives. Those of the motion obey the equation of motion as well,
``M y'' = -C y' - K y + f^(k)(t) + W lambda^(k)`` for ``y = p^(k)``, ``k > 0``, and the loads do no
work on ``y'``. So ``y'^T M y' + y^T K y`` grows only as fast as ``f^(k)`` does work, and bounds
``a y'`` by Cauchy and Schwarz.
"""

from math import comb, factorial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from impact_observer.dynamics.phase import Phase
from impact_observer.dynamics.watched import Watched
from impact_observer.states import Matrix, Vector

_ORDER = 8
"""Order of the Taylor polynomial."""
_POWERS = np.arange(_ORDER)[:, None, None]
FACTORIALS = np.array([factorial(k) for k in range(_ORDER)], dtype=float)
"""What derivatives are divided by in the Taylor polynomial."""
_BERNSTEIN = np.array(
    [[comb(i, j) / comb(_ORDER, j) for j in range(_ORDER + 1)] for i in range(_ORDER + 1)]
)
"""Bernstein coefficients from those of powers on [0, 1]."""


class Taylor(NamedTuple):
    """What is known of watched functions on intervals from their left ends.

    Attributes:
        derivatives: the functions and their derivatives there, shape (8, intervals, w).
        curvature: bound on the second derivative along each interval, shape (intervals, w).
        remainder: the same of the eighth.
    """

    derivatives: NDArray[np.float64]
    curvature: Matrix
    remainder: Matrix


class Bounds:
    """Bounds on watched functions of one phase between samples of a motion."""

    def __init__(self, phase: Phase, watched: Watched, least: float = 0.0) -> None:
        """Prepare norms of the functions and the forcing.

        Args:
            phase: whose motions are looked at.
            watched: the functions.
            least: scale of a function that sees nothing of a motion, relative to what it could.
        """
        self._least = least
        self._equations, self._inverse = phase.equations, phase.inverse
        self._watched = watched
        forcing, c = phase.equations.forcing, watched.force
        self._of_velocity = bool(np.any(watched.velocity))
        self._of_force = bool(np.any(c))
        self._moving = np.any(watched.velocity, axis=1)
        self._gaps = ~np.any(watched.velocity, axis=1) & ~np.any(c, axis=1)
        self._reach_a, self._reach_b = (
            _lengths(rows, phase.inverse) for rows in (watched.position, watched.velocity)
        )
        self._work = forcing.bound(phase.inverse)
        self._force = [forcing.bound(np.outer(row, row)) for row in c] if self._of_force else []
        self._scales, self._timescale = phase.scales, phase.scales.timescale
        self._prepare_scale(phase)

    def _prepare_scale(self, phase: Phase) -> None:
        """What each function sees of the modes, and of forces at once, signs apart."""
        equations, watched = phase.equations, self._watched
        self._sees_a = phase.scales.seen(watched.position)
        self._sees_b = phase.scales.seen(watched.velocity)
        pushed = linalg.solve(
            equations.M, (watched.position + watched.velocity).T, assume_a="pos"
        ).T
        self._pushes = [equations.forcing.bound(np.outer(row, row)) for row in pushed]
        self._stiff, self._damped = np.abs(pushed @ equations.K), np.abs(pushed @ equations.C)

    def scale(self, t: Vector, p: Matrix, u: Matrix, s: Vector) -> Matrix:
        """What the functions are rounded against: what they see of each mode, signs apart.

        After a start from rest that is little, and what the forces have made of it counts too.

        Args:
            t: s since the epoch, shape (samples,).
            p: shape (samples, n).
            u: velocities, shape (samples, n).
            s: seconds since the start of the motion, shape (samples,).

        Returns:
            Shape (samples - 1, w), of intervals.
        """
        least = self._least_scale(t, p, u) if self._least > 0 else 0.0
        s = np.minimum(s[1:], self._timescale)[:, None]
        forces = np.stack([bound(0, t[:-1]) for bound in self._pushes], axis=1)
        forces += _widest(np.abs(p) @ self._stiff.T + np.abs(u) @ self._damped.T)
        moved = _widest(self._scales.reach(p, u) @ self._sees_a.T)
        scale = np.abs(self._watched.constant) + moved
        if not self._of_velocity:
            scale += forces * s**2 / 2
        else:
            speeds = _widest(np.abs(u @ self._scales.modes) @ self._sees_b.T)
            scale += speeds + forces * np.where(self._moving, s, s**2 / 2)
        if self._of_force:
            scale += self._forces(0, t[:-1])
        return np.asarray(np.maximum(scale, least))

    def _least_scale(self, t: Vector, p: Matrix, u: Matrix) -> Matrix:
        """Least scale, shape (samples - 1, w): a body may rest exactly while others move."""
        energy = np.einsum("si,si->s", u @ self._equations.M, u)
        energy += np.einsum("si,si->s", p @ self._equations.K, p)
        speed = np.sqrt(np.maximum(energy, 0.0)) + self._work(0, t) * self._timescale
        reach = self._reach_a * self._timescale + self._reach_b
        return self._least * np.outer(_widest(speed), reach)

    def taylor(self, t: Vector, p: Matrix, u: Matrix, h: Vector) -> Taylor:
        """Derivatives of the functions at the left ends of intervals, with bounds along them.

        Args:
            t: s since the epoch, shape (intervals,).
            p: shape (intervals, n).
            u: velocities, shape (intervals, n).
            h: lengths of the intervals, s, shape (intervals,).
        """
        equations, a, b = self._equations, self._watched.position, self._watched.velocity
        orders = _ORDER + self._of_velocity
        f = equations.forcing.derivatives(t, orders - 1)
        motion = [p, u]
        for k in range(orders - 1):
            load = f[k] - motion[-1] @ equations.C.T - motion[-2] @ equations.K
            motion.append(load @ self._inverse)
        derivatives = np.stack(motion[:_ORDER]) @ a.T
        if self._of_velocity:
            derivatives += np.stack(motion[1 : _ORDER + 1]) @ b.T
        if self._of_force:
            derivatives += f[:_ORDER] @ self._watched.force.T
        derivatives[0] += self._watched.constant
        curvature, remainder = (self._largest(k, t, motion, h) for k in (2, _ORDER))
        return Taylor(derivatives, curvature, remainder)

    def lower(self, values: Matrix, ends: Matrix, taylor: Taylor, h: Vector) -> Matrix:
        """Least value that each function can take on each interval.

        Args:
            values: of the functions at the ends of the intervals, shape (intervals + 1, w).
            ends: ``a u`` there: slopes of gaps, shape (intervals + 1, w).
            taylor: at the left ends.
            h: lengths of the intervals, s, shape (intervals,).

        Returns:
            Shape (intervals, w).
        """
        h, left, slope = h[:, None], values[:-1], taylor.derivatives[1]
        once = np.minimum(left, left + slope * h - taylor.curvature * h**2 / 2)
        twice = _parabolas(values, ends, taylor.curvature, h)
        scaled = taylor.derivatives * (h**_POWERS / FACTORIALS[:, None, None])
        scaled[0] = left
        remainder = taylor.remainder * (h**_ORDER / factorial(_ORDER))
        polynomial = np.tensordot(_BERNSTEIN, np.concatenate([scaled, -remainder[None]]), axes=1)
        return np.asarray(np.maximum(np.where(self._gaps, twice, once), polynomial.min(axis=0)))

    def _largest(self, k: int, t: Vector, motion: list[Matrix], h: Vector) -> Matrix:
        """Bound on the ``k``-th derivative of each function along intervals, (intervals, w)."""
        found = np.outer(self._speed(k - 1, t, motion, h), self._reach_a)
        if self._of_velocity:
            found += np.outer(self._speed(k, t, motion, h), self._reach_b)
        if self._of_force:
            found += self._forces(k, t)
        return found

    def _speed(self, k: int, t: Vector, motion: list[Matrix], h: Vector) -> Vector:
        """Bound on ``sqrt(y'^T M y')``, ``y = p^(k)``, along intervals, shape (intervals,)."""
        y, rate = motion[k], motion[k + 1]
        energy = np.einsum("si,si->s", rate @ self._equations.M, rate)
        energy += np.einsum("si,si->s", y @ self._equations.K, y)
        return np.asarray(np.sqrt(np.maximum(energy, 0.0)) + self._work(k, t) * h)

    def _forces(self, k: int, t: Vector) -> Matrix:
        """Bound on ``|c f^(k)|``, shape (intervals, w)."""
        return np.stack([bound(k, t) for bound in self._force], axis=1)


def _lengths(rows: Matrix, metric: Matrix) -> Vector:
    """``sqrt(r metric r^T)`` of each row, shape (w,)."""
    return np.asarray(np.sqrt(np.maximum(np.einsum("wi,wi->w", rows @ metric, rows), 0.0)))


def _widest(samples: Matrix) -> Matrix:
    """The larger of both ends of each interval, shape (samples - 1, w)."""
    return np.asarray(np.maximum(samples[:-1], samples[1:]))


def _parabolas(g: Matrix, gamma: Matrix, bound: Matrix, h: Vector) -> Matrix:
    """Least value above the parabolas from both ends, shape (intervals, w).

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
