# SPDX-License-Identifier: Apache-2.0
"""What a fit to impacts leaves: a motion that may be early or late."""

from typing import NamedTuple

import numpy as np

from impact_observer.states import Vector


class TimeShift(NamedTuple):
    """A time by which a motion may be early or late, always alike.

    Shifts of stamps that are no white errors of a clock do not average out.

    Attributes:
        largest: the largest shift that a motion leaves, s.
        interval: the mean time between two impacts, s.
    """

    largest: float
    interval: float

    @classmethod
    def of(cls, shifts: Vector, stamps: Vector) -> "TimeShift":
        """The shift of a motion that leaves ``shifts`` at ``stamps``, s, shape (k,), k > 1."""
        return cls(float(np.max(np.abs(shifts))), float(np.ptp(stamps)) / (stamps.size - 1))

    def errors(self, x: Vector) -> Vector:
        """Errors of a state (q, u), shape (2n,), in SI units.

        Where the motion goes during the shift; and of each component, the phase by which an
        oscillation with one turn an interval is off.
        """
        error = 2.0 * np.pi * self.largest / self.interval * np.abs(x)
        n = x.size // 2
        error[:n] += self.largest * np.abs(x[n:])
        return np.asarray(error)


NO_SHIFT = TimeShift(0.0, 1.0)
