"""Watched functions along one motion that has no closed form, with bounds between samples."""

import numpy as np

from impact_observer.dynamics.flow.flow import Motion
from impact_observer.dynamics.guards.bounds import Bounds, Rough, Taylor
from impact_observer.model import Forcing
from impact_observer.states import Matrix, Vector


class Trace:
    """``w`` functions along a motion that gives nothing but its states.

    Attributes:
        motion: the motion.
        bounds: bounds on what motions of its phase do to the functions.
    """

    def __init__(self, motion: Motion, bounds: Bounds, forcing: Forcing) -> None:
        """Look along ``motion`` under ``forcing``."""
        self.motion = motion
        self.bounds = bounds
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

    def scale(self, start: Vector, stop: Vector) -> Matrix:
        """What the functions are rounded against there, shape (intervals, w)."""
        x = self.motion.states(np.concatenate([start, stop]))
        n = x.shape[1] // 2
        return self.bounds.scale(self.motion.t + start, x[:, :n], x[:, n:], stop)
