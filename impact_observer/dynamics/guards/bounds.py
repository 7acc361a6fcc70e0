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

from impact_observer.dynamics.flow.phase import Phase
from impact_observer.dynamics.guards.watched import Watched
from impact_observer.states import Matrix, Vector

_ORDER = 8
"""Order of the Taylor polynomial."""
_POWERS = np.arange(_ORDER + 1.0)
FACTORIALS = np.array([factorial(k) for k in range(_ORDER + 1)], dtype=float)
"""What derivatives are divided by in the Taylor polynomial."""


def _bernstein(order: int) -> Matrix:
    """Bernstein coefficients from those of powers on [0, 1], shape (order + 1, order + 1)."""
    powers = range(order + 1)
    return np.array([[comb(i, j) / comb(order, j) for j in powers] for i in powers])


_BERNSTEIN = _bernstein(_ORDER)
_BERNSTEIN_OF_RISES = _bernstein(_ORDER - 1)


class Rough(NamedTuple):
    """Watched functions at the ends of adjacent intervals, and a bound between them.

    Attributes:
        values: shape (intervals + 1, w).
        starting: slopes at left ends, shape (intervals, w).
        ending: slopes at right ends where available, shape (intervals, w).
        curvature: bound on the second derivative along each interval, shape (intervals, w).
    """

    values: Matrix
    starting: Matrix
    ending: Matrix
    curvature: Matrix


class Taylor(NamedTuple):
    """Values and slopes of watched functions on intervals, from their left ends.

    Attributes:
        derivatives: the functions and their derivatives there, shape (8, intervals, w).
        remainder: bound on the eighth derivative along each interval, shape (intervals, w).
    """

    derivatives: NDArray[np.float64]
    remainder: Matrix

    def extremes(self, left: Matrix, h: Vector) -> tuple[Matrix, Matrix]:
        """Least value and steepest rise that each function can have on each interval.

        Args:
            left: of the functions at the left ends, shape (intervals, w).
            h: lengths of the intervals, s, shape (intervals,).

        Returns:
            Values and ``h`` times slopes, shape (intervals, w) each.
        """
        terms = np.concatenate([self.derivatives, self.remainder[None]])
        terms *= (h ** _POWERS[:, None] / FACTORIALS[:, None])[..., None]
        terms[0] = left
        rises = _POWERS[1:, None] * terms[1:].reshape(_ORDER, -1)
        terms[-1] *= -1.0
        least = (_BERNSTEIN @ terms.reshape(_ORDER + 1, -1)).min(axis=0)
        steepest = (_BERNSTEIN_OF_RISES @ rises).max(axis=0)
        return least.reshape(left.shape), steepest.reshape(left.shape)


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
        self.watched = watched
        forcing, c = phase.equations.forcing, watched.force
        self._of_velocity = bool(np.any(watched.velocity))
        self._of_force = bool(np.any(c))
        self._gaps = ~np.any(watched.velocity, axis=1) & ~np.any(c, axis=1)
        self._reach_a, self._reach_b = (
            _lengths(rows, phase.inverse) for rows in (watched.position, watched.velocity)
        )
        self._work = forcing.bound(phase.inverse)
        self._force = [forcing.bound(np.outer(row, row)) for row in c] if self._of_force else []
        self._scales, self._timescale = phase.scales, phase.scales.timescale
        self._prepare_scale(phase)

    def _prepare_scale(self, phase: Phase) -> None:
        """Absolute values of each function for unit modes and for unit forces."""
        equations, watched = phase.equations, self.watched
        self._sees_a = phase.scales.seen(watched.position)
        self._sees_b = phase.scales.seen(watched.velocity)
        rows = [watched.position, watched.velocity] if self._of_velocity else [watched.position]
        pushed = linalg.solve(equations.M, np.vstack(rows).T, assume_a="pos").T
        self._pushes = [equations.forcing.bound(np.outer(row, row)) for row in pushed]
        self._pulls = np.abs(np.hstack([pushed @ equations.K, pushed @ equations.C]))

    def scale(self, t: Vector, p: Matrix, u: Matrix, s: Vector) -> Matrix:
        """Magnitudes that the functions are rounded against: absolute values for unit modes.

        After a start from rest that is little, and what the forces have made of it counts too.

        Args:
            t: where intervals begin, s since the epoch, shape (intervals,).
            p: at all left ends, then at all right ends, shape (2 intervals, n).
            u: velocities there, shape (2 intervals, n).
            s: where intervals end, seconds since the start of the motion, shape (intervals,).

        Returns:
            Shape (intervals, w).
        """
        least = self._least_scale(t, p, u) if self._least > 0 else 0.0
        s = np.minimum(s, self._timescale)[:, None]
        forces = _widest(np.abs(np.hstack([p, u])) @ self._pulls.T)
        forces += np.stack([bound(0, t) for bound in self._pushes], axis=1)
        deflections, speeds = self._scales.amplitudes(p, u)
        moved = _widest((deflections + speeds * self._timescale) @ self._sees_a.T)
        w = self.watched.constant.size
        scale = np.abs(self.watched.constant) + moved + forces[:, :w] * s**2 / 2
        if self._of_velocity:
            scale += _widest(speeds @ self._sees_b.T) + forces[:, w:] * s
        if self._of_force:
            scale += self._forces(0, t)
        return np.asarray(np.maximum(scale, least))

    def _least_scale(self, t: Vector, p: Matrix, u: Matrix) -> Matrix:
        """Least scale, shape (intervals, w): a body may rest exactly while others move."""
        energy = np.einsum("si,si->s", u @ self._equations.M, u)
        energy += np.einsum("si,si->s", p @ self._equations.K, p)
        speed = _widest(np.sqrt(np.maximum(energy, 0.0))) + self._work(0, t) * self._timescale
        reach = self._reach_a * self._timescale + self._reach_b
        return self._least * np.outer(speed, reach)

    def rough(self, t: Vector, values: Matrix, x: Matrix, h: Vector) -> Rough:
        """A first test that a function stays away from zero, which mostly decides.

        Args:
            t: where intervals begin, s since the epoch, shape (intervals,).
            values: of the functions at the ends of the intervals, shape (intervals + 1, w).
            x: states (p, u) there, shape (intervals + 1, 2n).
            h: lengths of the intervals, s, shape (intervals,).
        """
        n = x.shape[1] // 2
        derivatives, motion = self._derived(t, x[:-1], 2)
        ending = x[1:, n:] @ self.watched.position.T
        return Rough(values, derivatives[1], ending, self._largest(2, t, motion, h))

    def taylor(self, t: Vector, x: Matrix, h: Vector) -> Taylor:
        """Derivatives of the functions at the left ends of intervals, with bounds along them.

        Args:
            t: s since the epoch, shape (intervals,).
            x: states (p, u), shape (intervals, 2n).
            h: lengths of the intervals, s, shape (intervals,).
        """
        derivatives, motion = self._derived(t, x, _ORDER)
        return Taylor(derivatives, self._largest(_ORDER, t, motion, h))

    def _derived(
        self, t: Vector, x: Matrix, orders: int
    ) -> tuple[NDArray[np.float64], list[Matrix]]:
        """Derivatives of the functions below ``orders``, and those of ``p`` that bounds need."""
        equations, a, b = self._equations, self.watched.position, self.watched.velocity
        n, highest = x.shape[1] // 2, orders + self._of_velocity
        f = equations.forcing.derivatives(t, highest - 1)
        motion = [x[:, :n], x[:, n:]]
        for k in range(highest - 1):
            load = f[k] - motion[-1] @ equations.C.T - motion[-2] @ equations.K
            motion.append(load @ self._inverse)
        derivatives = np.stack(motion[:orders]) @ a.T
        if self._of_velocity:
            derivatives += np.stack(motion[1 : orders + 1]) @ b.T
        if self._of_force:
            derivatives += f[:orders] @ self.watched.force.T
        derivatives[0] += self.watched.constant
        return derivatives, motion

    def lower(self, rough: Rough, h: Vector) -> Matrix:
        """Least value that each function can take on each interval, shape (intervals, w).

        Args:
            rough: values and slopes of them.
            h: lengths of the intervals, s, shape (intervals,).
        """
        twice = parabolas(rough, h)
        if self._gaps.all():
            return twice
        left, h = rough.values[:-1], h[:, None]
        once = np.minimum(left, left + rough.starting * h - rough.curvature * h**2 / 2)
        return np.where(self._gaps, twice, once)

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
    """The larger of both ends of each interval, left ends standing first."""
    half = len(samples) // 2
    return np.asarray(np.maximum(samples[:half], samples[half:]))


def parabolas(rough: Rough, h: Vector) -> Matrix:
    """Least value above the parabolas from both ends, shape (intervals, w).

    ``g_j + gamma_j s - B s^2 / 2`` and its mirror from the other end are lower bounds; both are
    concave and differ by a linear function, so the larger of them is least at an end or where
    they meet.

    Args:
        rough: values and slopes of the functions.
        h: lengths of the intervals, s, shape (intervals,).
    """
    left, right, h = rough.values[:-1], rough.values[1:], h[:, None]
    bend = rough.curvature * h
    # p_l(s) - p_r(s) = left - right + rate_r h + B h^2 / 2 + (rate_l - rate_r - B h) s
    slope = rough.starting - rough.ending - bend
    at_zero = left - right + (rough.ending + bend / 2) * h
    meet = np.clip(np.where(slope == 0, 0.0, -at_zero / np.where(slope == 0, 1.0, slope)), 0.0, h)
    middle = left + (rough.starting - rough.curvature * meet / 2) * meet
    return np.asarray(np.minimum(np.minimum(left, right), middle))
