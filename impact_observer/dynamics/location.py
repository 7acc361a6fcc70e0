"""The first instant at which a watched function falls below zero, found with a guarantee.

A motion is sampled, and each function is bounded from below between the samples (``bounds.py``).
Where the bound stays above zero no crossing can hide; elsewhere the interval is divided until the
bound decides.
"""

from typing import NamedTuple

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from scipy import optimize

from impact_observer.dynamics.bounds import FACTORIALS, Bounds
from impact_observer.dynamics.flow import Motion
from impact_observer.dynamics.phase import Phase
from impact_observer.dynamics.watched import Watched
from impact_observer.states import Matrix, Vector

DEPTH = 1e-13
"""How far below zero counts as not at all, relative to what a function is rounded against."""
_TOUCH = 1e-12
"""Value that counts as zero at the instant of a crossing, relative to the same."""
_SAMPLES = 16
"""Intervals that are looked at together."""
_KNOTS = 64
"""Knots of a sampled forcing that are looked at together."""
_FINER = 8.0 ** np.arange(-8, 0)
"""Where the first interval after a start is divided: flights may be short."""
_ROOT = 4 * np.finfo(np.float64).eps
"""Relative accuracy of a root: brentq's finest."""
_ROUNDED = 1e-14
"""Value that one more step of Newton's method ends at, relative to the same scale."""
_NEWTON = 8
"""Steps of Newton's method before brentq's."""
_LEAST = 1e-30
"""Absolute accuracy of a root, s: none, but brentq wants one."""
_FIRST = 1e-9
"""Fraction of a window at its start below which intervals are not divided further."""


class Crossing(NamedTuple):
    """The instant at which watched functions reach zero.

    Attributes:
        s: seconds since the start of the motion.
        which: indices of all functions that are zero then.
    """

    s: float
    which: tuple[int, ...]


class _Suspect(NamedTuple):
    """An interval that may hold a crossing.

    Attributes:
        start: its left end, s.
        stop: its right end, s.
        which: indices of the functions that may cross.
        values: of all functions at both ends, shape (2, w).
        falling: whether each falls all the way, shape (w,).
        derivatives: of each at the left end, shape (8, w).
        scale: what each is rounded against, shape (w,).
    """

    start: float
    stop: float
    which: NDArray[np.intp]
    values: Matrix
    falling: NDArray[np.bool_]
    derivatives: Matrix
    scale: Vector


class Search:
    """Looks for the first crossing of watched functions along motions of one phase."""

    def __init__(
        self, phase: Phase, watched: Watched, window: float, *, least: float = 0.0
    ) -> None:
        """Prepare the bounds.

        Args:
            phase: whose motions are searched.
            watched: what must not fall below zero.
            window: length of the stretch that is looked at together, s.
            least: scale of a function that sees nothing of a motion, relative to what it could:
                for those that may be exactly zero for long.
        """
        self._forcing = phase.equations.forcing
        self._watched = watched
        self._window = window
        self._bounds = Bounds(phase, watched, least)

    def first(self, motion: Motion, horizon: float, start: float = 0.0) -> Crossing | None:
        """Seconds until the first function falls below zero; None if none does.

        Args:
            motion: of (p, u), with no function below zero at its start but for rounding.
            horizon: where to stop looking, s; the end of the forcing, if that is earlier.
            start: where to begin, s; nothing crosses before.

        Returns:
            Where in [start, horizon] the first function reaches zero from above, with all others
            that are zero there. Crossings no deeper than ``DEPTH`` of a function's scale may be
            passed over.
        """
        if not self._watched.constant.size:
            return None
        horizon = min(horizon, self._forcing.end - motion.t)
        while start < horizon:
            s = self._grid(motion.t, start, min(start + self._window, horizon))
            found = self._first_in(motion, s)
            if found is not None:
                return found
            start = float(s[-1])
        return None

    def _grid(self, t: float, start: float, stop: float) -> Vector:
        """Ends of intervals from ``start`` on, up to ``stop`` or so many knots of the forcing.

        Finer just after the start of a motion, and divided wherever the forcing is not smooth.
        """
        knots = self._forcing.knots(t + start, t + stop)[:_KNOTS] - t
        if knots.size == _KNOTS:
            stop = float(knots[-1])
        s = np.linspace(start, stop, _SAMPLES + 1)
        if start == 0.0:
            s = np.concatenate([s[:1], s[1] * _FINER, s[1:]])
        if knots.size:
            s = np.unique(np.concatenate([s, knots[(knots > start) & (knots < stop)]]))
        return s

    def _first_in(self, motion: Motion, s: Vector) -> Crossing | None:
        """The first crossing in adjacent intervals with ends ``s``."""
        h, t = np.diff(s), motion.t + s
        x = motion.states(s)
        n = x.shape[1] // 2
        p, u = x[:, :n], x[:, n:]
        values = self._watched.values(self._forcing, t, x)
        if s[0] == 0.0:
            values[0] = np.maximum(values[0], 0.0)  # below zero by rounding only
        taylor = self._bounds.taylor(t[:-1], p[:-1], u[:-1], h)
        low = self._bounds.lower(values, u @ self._watched.position.T, taylor, h)
        scale = self._bounds.scale(t, p, u, s)
        suspects = low < -DEPTH * scale
        falling = taylor.derivatives[1] + taylor.curvature * h[:, None] < 0
        for j in np.flatnonzero(suspects.any(axis=1)):
            suspect = _Suspect(
                float(s[j]),
                float(s[j + 1]),
                np.flatnonzero(suspects[j]),
                values[j : j + 2],
                falling[j],
                taylor.derivatives[:, j],
                scale[j],
            )
            found = self._decide(motion, suspect)
            if found is not None:
                return found
        return None

    def _decide(self, motion: Motion, suspect: _Suspect) -> Crossing | None:
        """The first crossing in one interval that may hold one."""
        start, stop, which, values = suspect[:4]
        scale = suspect.scale
        below = which[values[0, which] < -DEPTH * scale[which]]
        if below.size:  # it jumped there, with the forcing
            at = self._traced(motion, start, int(below[0]))
            return self._crossing(motion, at, int(below[0]), scale)
        if np.all((values[1, which] < 0) & suspect.falling[which]):
            roots = [self._root(motion, suspect, int(i)) for i in which]
            first = int(np.argmin(roots))
            return self._crossing(motion, roots[first], int(which[first]), scale)
        if stop - start <= _ROOT * max(stop, _FIRST * self._window):
            at = self._traced(motion, start, int(which[0]))
            return self._crossing(motion, at, int(which[0]), scale)
        return self._first_in(motion, np.linspace(start, stop, _SAMPLES + 1))

    def _values(self, motion: Motion, s: float) -> Vector:
        """All functions at ``s``, shape (w,)."""
        at = np.array([s])
        values = self._watched.values(self._forcing, motion.t + at, motion.states(at))
        return np.asarray(values[0])

    def _root(self, motion: Motion, suspect: _Suspect, which: int) -> float:
        """The single root of one function that falls all the way along an interval."""
        start, stop = suspect.start, suspect.stop

        def value(s: float) -> float:
            return float(self._values(motion, s)[which])

        # Newton's method from the root of the Taylor polynomial: two or three values, not twenty.
        taylor = Polynomial(suspect.derivatives[:, which] / FACTORIALS)
        slope, s, last = taylor.deriv(), start, stop - start
        if taylor(0.0) > 0 > taylor(stop - start):
            s += float(optimize.brentq(taylor, 0.0, stop - start, xtol=_LEAST, rtol=_ROOT))
        for _ in range(_NEWTON):
            left = value(s)
            step = -left / float(slope(s - start))
            rounded = abs(left) <= _ROUNDED * suspect.scale[which]
            if not (start <= s + step <= stop and (rounded or abs(step) <= last / 4)):
                break
            s += step
            if abs(step) <= _ROOT * s or rounded:
                return s
            last = abs(step)
        # The ends are evaluated alone here; rounding may tell them differently than before.
        if value(start) > 0 > value(stop):
            return float(optimize.brentq(value, start, stop, xtol=_LEAST, rtol=_ROOT))
        return self._traced(motion, stop, which)

    def _traced(self, motion: Motion, s: float, which: int) -> float:
        """The last root of one function before ``s``; ``s`` itself where it is not below zero.

        Samples that are below zero by less than ``DEPTH`` raise no suspicion: the root of what
        falls on afterwards lies before them.
        """

        def value(s: float) -> float:
            return float(self._values(motion, s)[which])

        step, below = _ROOT * s, s
        while value(s) < 0:
            if s == 0.0:
                return s
            below, s, step = s, max(s - step, 0.0), 4 * step
        if s == below:
            return s
        return float(optimize.brentq(value, s, below, xtol=_LEAST, rtol=_ROOT))

    def _crossing(self, motion: Motion, s: float, which: int, scale: Vector) -> Crossing:
        """The crossing of ``which`` at ``s`` and of all that are zero but for rounding."""
        zero = self._values(motion, s) <= _TOUCH * scale
        zero[which] = True
        return Crossing(float(s), tuple(np.flatnonzero(zero).tolist()))
