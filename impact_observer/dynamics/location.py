"""The first instant at which a gap closes, found with a guarantee.

A motion is sampled, and each gap is bounded from below between the samples (``bounds.py``). Where
the bound stays above zero no crossing can hide; elsewhere the interval is divided until the bound
decides.
"""

from typing import NamedTuple

import numpy as np
from scipy import linalg, optimize

from impact_observer.dynamics.bounds import GapBounds
from impact_observer.dynamics.flow import Motion
from impact_observer.model import System
from impact_observer.states import Vector

DEPTH = 1e-13
"""Penetration that counts as none, relative to the scale of the gap."""
_TOUCH = 1e-12
"""Gap that counts as closed at the instant of an impact, relative to its scale."""
_SAMPLES = 16
"""Intervals that are looked at together."""
_ROOT = 4 * np.finfo(np.float64).eps
"""Relative accuracy of a root: brentq's finest."""


class Closing(NamedTuple):
    """The instant at which gaps close.

    Attributes:
        s: seconds since the start of the motion.
        contacts: indices of the contacts that are closed then.
    """

    s: float
    contacts: tuple[int, ...]


class ContactSearch:
    """Looks for the first closing gap along motions of one system without contact.

    Attributes:
        window: length of the stretch that is looked at together, s.
    """

    def __init__(self, system: System) -> None:
        """Prepare the bounds; ``window`` is two periods of the fastest mode or harmonic."""
        self._system = system
        self._bounds = GapBounds(system)
        stiffest = float(linalg.eigh(system.K, system.M, eigvals_only=True)[-1])
        fastest = max([np.sqrt(max(stiffest, 0.0)), *system.forcing.frequency])
        self.window = _SAMPLES * (2 * np.pi / fastest / 8 if fastest > 0 else 1.0)

    def first_closing(self, motion: Motion, horizon: float, start: float = 0.0) -> Closing | None:
        """Seconds until the first gap closes along ``motion``; None if none does.

        Args:
            motion: a motion without contact that starts with no gap below zero.
            horizon: where to stop looking, s.
            start: where to begin, s; nothing closes before.

        Returns:
            Where in [start, horizon] the first gap reaches zero from above, with all others that
            do. Crossings no deeper than ``DEPTH`` of the gap's scale may be passed over.
        """
        while start < horizon:
            stop = min(start + self.window, horizon)
            found = self._first_in(motion, start, stop)
            if found is not None:
                return found
            start = stop
        return None

    def _first_in(self, motion: Motion, start: float, stop: float) -> Closing | None:
        """The first closing in one interval, looked at in ``_SAMPLES`` parts."""
        s = np.linspace(start, stop, _SAMPLES + 1)
        h = s[1] - s[0]
        x = motion.states(s)
        q, u = x[:, : self._system.n], x[:, self._system.n :]
        g, gamma = q @ self._system.W + self._system.q_r, u @ self._system.W
        if start == 0.0:
            g[0] = np.maximum(g[0], 0.0)  # below zero by rounding only: the last impact was there
        derivatives = self._bounds.derivatives(motion.t + s[:-1], q[:-1], u[:-1])
        low = self._bounds.lower(g, derivatives, gamma, h)
        scale = self._bounds.scale(q, u)
        suspects = low < -DEPTH * scale
        falling = gamma[:-1] + self._bounds.acceleration(derivatives, h) * h < 0
        for j in np.flatnonzero(suspects.any(axis=1)):
            contacts = np.flatnonzero(suspects[j]).tolist()
            clear = (g[j, contacts] >= 0) & (g[j + 1, contacts] < 0) & falling[j, contacts]
            if clear.all():
                roots = [self._root(motion, i, s[j], s[j + 1]) for i in contacts]
                return self._closing(motion, min(roots), contacts[np.argmin(roots)], scale[j])
            if h <= _ROOT * max(s[j + 1], 1e-9):
                return self._closing(motion, float(s[j]), contacts[0], scale[j])
            found = self._first_in(motion, s[j], s[j + 1])
            if found is not None:
                return found
        return None

    def _root(self, motion: Motion, contact: int, start: float, stop: float) -> float:
        """The single root of one gap that falls all the way from ``start`` to ``stop``."""
        w, q_r, n = self._system.W[:, contact], self._system.q_r[contact], self._system.n

        def gap(s: float) -> float:
            return float(w @ motion.state(s)[:n] + q_r)

        # The ends are evaluated alone here; rounding may tell them differently than before.
        if gap(start) <= 0:
            return start
        if gap(stop) >= 0:
            return stop
        return float(optimize.brentq(gap, start, stop, xtol=1e-16, rtol=_ROOT))

    def _closing(self, motion: Motion, s: float, contact: int, scale: Vector) -> Closing:
        """The closing of ``contact`` at ``s`` and of all whose gap is zero but for rounding."""
        gap = self._system.gap(motion.state(s)[: self._system.n])
        closed = gap <= _TOUCH * scale
        closed[contact] = True
        return Closing(float(s), tuple(np.flatnonzero(closed).tolist()))
