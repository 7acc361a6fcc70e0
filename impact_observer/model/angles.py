# SPDX-License-Identifier: Apache-2.0
"""Angles of harmonics, accurate at any time after the epoch.

The product ``omega t`` of two floats has a rounding error of ``eps omega t``. So the turns of a
harmonic in one nanosecond are stored as an integer of 128 bits, and whole turns are removed from
the integer product with the time before the product becomes a float.
"""

from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from impact_observer.stamps import NS_PER_S
from impact_observer.states import Vector

TURN = Fraction(62831853071795864769252867665590057683943, 10**40)
_UNIT = 1 << 128
"""Number of parts of one turn."""
_PART = float(TURN / _UNIT)
"""Angle of one part, rad."""


class Angles:
    """The angles ``omega t`` of some harmonics.

    Attributes:
        frequency: ``omega``, shape (h,), rad/s.
    """

    def __init__(self, frequency: Vector) -> None:
        """Compute the turns in a nanosecond of harmonics of ``frequency``, shape (h,), rad/s."""
        self.frequency = frequency
        turns = [Fraction(omega) / (TURN * NS_PER_S) for omega in frequency.tolist()]
        self._parts = [round(each * _UNIT) % _UNIT for each in turns]

    def at_stamps(self, ns: NDArray[np.int64]) -> NDArray[np.float64]:
        """Angles at instants, less whole turns.

        Args:
            ns: nanoseconds since the epoch, shape (samples,).

        Returns:
            Angles, rad, shape (samples, h).
        """
        angles = [[each * parts % _UNIT * _PART for parts in self._parts] for each in ns.tolist()]
        return np.reshape(np.array(angles, dtype=np.float64), (ns.size, self.frequency.size))
