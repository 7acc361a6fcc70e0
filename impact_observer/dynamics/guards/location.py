"""The first instant at which a watched function falls below zero, found with a guarantee.

A motion is sampled, and each function is bounded from below between the samples (``traces.py``).
Where the bound stays above zero no crossing can hide; elsewhere the interval is divided until the
bound decides.
"""

from abc import ABC, abstractmethod
from functools import cache
from typing import NamedTuple

import numpy as np

from impact_observer.dynamics.flow.flow import Motion
from impact_observer.dynamics.flow.phase import Phase
from impact_observer.dynamics.guards.bounds import Bounds
from impact_observer.dynamics.guards.roots import ROOT, Suspect, root, traced
from impact_observer.dynamics.guards.traces import Trace
from impact_observer.dynamics.guards.watched import Watched
from impact_observer.kernel import Guards, RootSearch
from impact_observer.states import Vector

DEPTH = 1e-13
"""Depth below zero that counts as none, relative to what a function is rounded against."""
_ZERO = 1e-12
"""Value that counts as zero at a crossing, relative to what a function is rounded against."""
_SAMPLES = 16
"""Intervals that are looked at together."""
_KNOTS = 64
"""Knots of a sampled forcing that are looked at together."""
_GRID = np.linspace(0.0, 1.0, _SAMPLES + 1)
"""Ends of intervals in a window."""
_FINE = np.concatenate([_GRID[:1], _GRID[1] * 8.0 ** np.arange(-8, 0), _GRID[1:]])
"""The same where the first one after a start is divided: flights may be short."""
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


class Search:
    """Looks for the first crossing of watched functions along motions of one phase.

    Attributes:
        window: length of the stretch that is looked at closely together, s.
        forcing: of the phase.
    """

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
        self.window = window
        self.forcing = phase.equations.forcing
        self._count = watched.constant.size
        self._bounds = cache(lambda: Bounds(phase, watched, least))
        self._view = phase.flow.view(watched.functions(self.forcing))

    @property
    def guards(self) -> Guards | None:
        """The functions as the kernel has them; None where motions have no closed form."""
        return None if self._view is None else self._view.guards

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
        found = self.along(motion, start).first(horizon)
        return None if found is None or found.s > horizon else found

    def along(self, motion: Motion, start: float = 0.0) -> "Hunt":
        """A search along ``motion`` from ``start`` s on, which can be extended again and again."""
        end = self.forcing.end - motion.t
        closed = None if self._view is None else self._view.of(motion)
        if closed is not None:
            return _ClosedHunt(RootSearch(closed, self.window, end, start))
        trace = Trace(motion, self._bounds(), self.forcing) if self._count else None
        return _SampledHunt(self, trace, start, end)

    def first_within(self, trace: Trace, start: float, stop: float) -> Crossing | None:
        """The first crossing from ``start`` to ``stop``, s, by windows."""
        while start < stop:
            s = self._grid(trace.motion.t, start, min(start + self.window, stop))
            found = self._first_in(trace, s)
            if found is not None:
                return found
            start = float(s[-1])
        return None

    def _grid(self, t: float, start: float, stop: float) -> Vector:
        """Ends of intervals from ``start`` on, up to ``stop`` or so many knots of the forcing.

        Finer just after the start of a motion, and divided wherever the forcing is not smooth.
        """
        knots = self.forcing.knots(t + start, t + stop)[:_KNOTS] - t
        if knots.size == _KNOTS:
            stop = float(knots[-1])
        s = start + (stop - start) * (_GRID if start > 0.0 else _FINE)
        s[-1] = stop
        if knots.size:
            s = np.unique(np.concatenate([s, knots[(knots > start) & (knots < stop)]]))
        return s

    def _first_in(self, trace: Trace, s: Vector, scale: Vector | None = None) -> Crossing | None:
        """The first crossing in adjacent intervals with ends ``s``.

        Args:
            trace: the functions.
            s: s since the start of the motion, shape (intervals + 1,).
            scale: what each is rounded against on the whole of them, shape (w,), where it is
                available: that of parts is not computed again.
        """
        h, rough = np.diff(s), trace.rough(s)
        if s[0] == 0.0:
            rough.values[0] = np.maximum(rough.values[0], 0.0)  # below zero by rounding only
        low = trace.lower(rough, h)
        doubtful = np.flatnonzero(low.min(axis=1) < 0)
        if not doubtful.size:
            return None
        # Mostly one interval is left, on which it is worth while to look closely.
        start, stop, h = s[doubtful], s[doubtful + 1], h[doubtful]
        taylor = trace.taylor(start, stop)
        least, steepest = taylor.extremes(rough.values[doubtful], h)
        low = np.maximum(low[doubtful], least)
        if low.min() >= 0:
            return None
        scales = trace.scale(start, stop) if scale is None else np.tile(scale, (h.size, 1))
        suspects = low < -DEPTH * scales
        for j in np.flatnonzero(suspects.any(axis=1)):
            suspect = Suspect(
                float(start[j]),
                float(stop[j]),
                np.flatnonzero(suspects[j]),
                rough.values[doubtful[j] : doubtful[j] + 2],
                steepest[j] < 0,
                taylor.derivatives[:, j],
                scales[j],
            )
            found = self._decide(trace, suspect)
            if found is not None:
                return found
        return None

    def _decide(self, trace: Trace, suspect: Suspect) -> Crossing | None:
        """The first crossing in one interval that may hold one."""
        start, stop, which, values = suspect[:4]
        scale = suspect.scale
        below = which[values[0, which] < -DEPTH * scale[which]]
        if below.size:  # it jumped there, with the forcing
            return _crossing(trace, traced(trace, start, int(below[0])), int(below[0]), scale)
        if np.all((values[1, which] < 0) & suspect.falling[which]):
            roots = [root(trace, suspect, int(i)) for i in which]
            first = int(np.argmin(roots))
            return _crossing(trace, roots[first], int(which[first]), scale)
        if stop - start <= ROOT * max(stop, _FIRST * self.window):
            return _crossing(trace, traced(trace, start, int(which[0])), int(which[0]), scale)
        s = start + (stop - start) * _GRID
        s[-1] = stop
        return self._first_in(trace, s, scale)


class Hunt(ABC):
    """A search along one motion that goes on where it has stopped.

    What it finds does not depend on who asks when.
    """

    @abstractmethod
    def first(self, horizon: float) -> Crossing | None:
        """The first crossing, if all before ``horizon`` s had to be looked at to find it."""


class _ClosedHunt(Hunt):
    """By the kernel, in closed form."""

    def __init__(self, hunt: RootSearch) -> None:
        self._hunt = hunt

    def first(self, horizon: float) -> Crossing | None:
        found = self._hunt.first(horizon)
        return None if found is None else Crossing(*found)


class _SampledHunt(Hunt):
    """It looks at whole stretches, each twice as long as the one before."""

    def __init__(self, search: Search, trace: Trace | None, start: float, end: float) -> None:
        self._search = search
        self._trace = trace
        self._length, self._end, self._reached = search.window, end, start
        self._found: Crossing | None = None

    def first(self, horizon: float) -> Crossing | None:
        if self._trace is None:
            return None
        while self._found is None and self._reached <= horizon and self._reached < self._end:
            start, self._reached = self._reached, min(self._reached + self._length, self._end)
            self._length *= 2
            self._found = self._search.first_within(self._trace, start, self._reached)
        return self._found


def _crossing(trace: Trace, s: float, which: int, scale: Vector) -> Crossing:
    """The crossing of ``which`` at ``s`` and of all that are zero but for rounding."""
    if scale.size == 1:
        return Crossing(float(s), (which,))
    zero = trace.values(np.array([s]))[0] <= _ZERO * scale
    zero[which] = True
    return Crossing(float(s), tuple(np.flatnonzero(zero).tolist()))
