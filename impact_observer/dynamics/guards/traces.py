"""Watched functions along one motion, with what bounds them between samples.

Where the motion has a closed form by modes these are waves (``waves.py``), and nothing but the
functions themselves is evaluated. Otherwise they are computed from its states (``bounds.py``).
"""

from abc import ABC, abstractmethod

import numpy as np

from impact_observer.dynamics.flow.flow import Motion
from impact_observer.dynamics.flow.waves import Aging, Waves
from impact_observer.dynamics.guards.bounds import Bounds, Rough, Taylor, parabolas
from impact_observer.model import Forcing
from impact_observer.states import Matrix, Vector


class Trace(ABC):
    """``w`` functions along one motion.

    Attributes:
        motion: the motion.
        bounds: bounds on what motions of its phase do to the functions.
    """

    def __init__(self, motion: Motion, bounds: Bounds) -> None:
        """Look along ``motion``."""
        self.motion = motion
        self.bounds = bounds

    @property
    def nothing(self) -> bool:
        """Whether there is no function at all."""
        return self.bounds.watched.constant.size == 0

    @abstractmethod
    def values(self, s: Vector) -> Matrix:
        """The functions ``s`` seconds after the start, shape (samples, w)."""

    @abstractmethod
    def rough(self, s: Vector) -> Rough:
        """The functions on adjacent intervals with ends ``s``."""

    @abstractmethod
    def lower(self, rough: Rough, h: Vector) -> Matrix:
        """Least value of each function on intervals of lengths ``h``, shape (intervals, w)."""

    @abstractmethod
    def taylor(self, start: Vector, stop: Vector) -> Taylor:
        """The same much closer, from each ``start`` to its ``stop``."""

    def scale(self, start: Vector, stop: Vector) -> Matrix:
        """What the functions are rounded against there, shape (intervals, w)."""
        x = self.motion.states(np.concatenate([start, stop]))
        n = x.shape[1] // 2
        return self.bounds.scale(self.motion.t + start, x[:, :n], x[:, n:], stop)


class WaveTrace(Trace):
    """Functions of a motion that has a closed form."""

    def __init__(self, motion: Motion, bounds: Bounds, waves: Waves | Aging) -> None:
        """Look along ``motion``, which shows itself by ``waves``."""
        super().__init__(motion, bounds)
        self._waves = waves

    def values(self, s: Vector) -> Matrix:
        """Of order 0."""
        return np.asarray(self._waves.derivatives(s, 1)[0])

    def rough(self, s: Vector) -> Rough:
        """All slopes are available."""
        values, slopes = self._waves.derivatives(s, 2)
        return Rough(values, slopes[:-1], slopes[1:], self._waves.largest(2, s[:-1], s[1:]))

    def lower(self, rough: Rough, h: Vector) -> Matrix:
        """From both ends."""
        return parabolas(rough, h)

    def taylor(self, start: Vector, stop: Vector) -> Taylor:
        """With all derivatives in closed form."""
        return Taylor(self._waves.derivatives(start, 8), self._waves.largest(8, start, stop))


class StateTrace(Trace):
    """Functions of a motion that gives nothing but its states."""

    def __init__(self, motion: Motion, bounds: Bounds, forcing: Forcing) -> None:
        """Look along ``motion`` under ``forcing``."""
        super().__init__(motion, bounds)
        self._forcing = forcing

    def values(self, s: Vector) -> Matrix:
        """Of states."""
        x = self.motion.states(s)
        return self.bounds.watched.values(self._forcing, self.motion.t + s, x)

    def rough(self, s: Vector) -> Rough:
        """By the equations of motion."""
        x, t = self.motion.states(s), self.motion.t + s
        values = self.bounds.watched.values(self._forcing, t, x)
        return self.bounds.rough(t[:-1], values, x, np.diff(s))

    def lower(self, rough: Rough, h: Vector) -> Matrix:
        """From both ends where functions are gaps."""
        return self.bounds.lower(rough, h)

    def taylor(self, start: Vector, stop: Vector) -> Taylor:
        """By the equations of motion."""
        return self.bounds.taylor(self.motion.t + start, self.motion.states(start), stop - start)
