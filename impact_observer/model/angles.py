# SPDX-License-Identifier: Apache-2.0
"""Angles of harmonics, accurate however late it is.

The product ``omega t`` of two floats is rounded by ``eps omega t``. So the turns of a harmonic in
a nanosecond are an integer of many digits, and whole turns are left out before it is rounded.
"""

from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from impact_observer.stamps import NS_PER_S, Elapsed
from impact_observer.states import Vector

_TURN = Fraction(62831853071795864769252867665590057683943, 10**40)
_UNIT = 1 << 128
"""Parts that a turn is counted in."""
_PART = float(_TURN / _UNIT)
"""One of them, rad."""


class Angles:
    """``omega t`` of some harmonics.

    Attributes:
        frequency: ``omega``, shape (h,), rad/s.
        turns: in a nanosecond, in parts of 2^-128: their high and low 64 bits, shape (h, 2).
    """

    def __init__(self, frequency: Vector) -> None:
        """Count the turns in a nanosecond."""
        self.frequency = frequency
        turns = [Fraction(omega) / (_TURN * NS_PER_S) for omega in frequency.tolist()]
        parts = [round(each * _UNIT) % _UNIT for each in turns]
        halves = [divmod(each, 1 << 64) for each in parts]
        self.turns = np.array(halves, dtype=np.uint64).reshape(-1, 2)
        self._each = list(zip(frequency.tolist(), parts, strict=True))

    def at(self, t: float) -> list[float]:
        """The angles at ``t`` s since the epoch, rad, less whole turns where ``t`` is exact."""
        if not isinstance(t, Elapsed):
            return [omega * t for omega, _ in self._each]
        ns, rest = t.ns, t.remainder
        return [ns * parts % _UNIT * _PART + omega * rest for omega, parts in self._each]

    def after(self, t: float, s: Vector) -> Vector:
        """The angles ``s`` seconds after ``t``, shape (h, samples)."""
        return np.asarray(np.array(self.at(t))[:, None] + np.multiply.outer(self.frequency, s))

    def each(self, ns: NDArray[np.int64]) -> NDArray[np.float64]:
        """The angles at instants, ns since the epoch, less whole turns, shape (samples, h)."""
        found = [[at * parts % _UNIT * _PART for _, parts in self._each] for at in ns.tolist()]
        return np.reshape(np.array(found, dtype=np.float64), (ns.size, self.frequency.size))
