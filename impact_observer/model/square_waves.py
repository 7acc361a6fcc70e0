# SPDX-License-Identifier: Apache-2.0
"""Forces of constant size that change their sign at exact instants: valves and solenoids.

The instants of a wave are ``first + k half``. Both are integers of 2^-64 ns, so no product with a
time loses digits.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np

from impact_observer.model.angles import TURN
from impact_observer.stamps import NS_PER_S, Elapsed
from impact_observer.states import Matrix, Vector, frozen

_NS = 1 << 64
"""Parts of a nanosecond."""
_S = _NS * NS_PER_S
_SAME = 1e-13
"""Largest difference of two instants that counts as rounding, s, beside that of their floats."""


@dataclass(frozen=True, slots=True, eq=False)
class SquareWaves:
    """Forces ``sum_k force_k sign(cos(omega_k t + phase_k))``.

    Attributes:
        frequency: angular frequencies ``omega``, shape (s,), rad/s, each positive.
        phase: shape (s,), rad.
        force: shape (s, n), N or Nm.
        instants: first switch and half period of each wave, 2^-64 ns since the epoch. Derived.
    """

    frequency: Vector
    phase: Vector
    force: Matrix
    instants: tuple[tuple[int, int], ...] = field(init=False)

    def __post_init__(self) -> None:
        """Freeze all fields, and derive the instants."""
        pairs = zip(self.frequency.tolist(), self.phase.tolist(), strict=True)
        object.__setattr__(self, "instants", tuple(_first_and_half(*each) for each in pairs))
        for key in ("frequency", "phase", "force"):
            object.__setattr__(self, key, frozen(getattr(self, key)))

    @classmethod
    def of_rows(cls, rows: Sequence[tuple[float, float, Vector]]) -> "SquareWaves":
        """The waves of frequency, phase and force, shape (n,), in each row."""
        frequency, phase, force = zip(*rows, strict=True)
        return cls(np.array(frequency), np.array(phase), np.array(force))

    def signs(self, t: float) -> Vector:
        """``sign(cos(omega t + phase))`` at ``t``, s since the epoch, shape (s,).

        At a switch the signs are those after the switch.
        """
        late = _parts(t) + _rounding(t)
        odd = [((late - first) // half) % 2 for first, half in self.instants]
        return np.array(odd, dtype=np.float64) * 2 - 1

    def values(self, t: Vector) -> Matrix:
        """Forces at ``t``, s since the epoch, shape (samples,): (samples, n)."""
        signs = np.reshape([self.signs(each) for each in t.tolist()], (-1, self.frequency.size))
        return np.asarray(signs @ self.force)

    def switches(self, t: float, duration: float, most: int | None = None) -> Vector:
        """Switches within ``duration`` after ``t``, s since ``t``, ascending.

        Args:
            t: s since the epoch.
            duration: s.
            most: number of switches of each wave after which the search ends; None for no end.
        """
        now, slack = _parts(t), _rounding(t)
        end = now + _parts(duration) - slack
        found = set[int]()
        for first, half in self.instants:
            start = first + ((now + slack - first) // half + 1) * half
            stop = end if most is None else min(end, start + most * half)
            found.update(range(start, stop, half))
        return np.array([(each - now) / _S for each in sorted(found)])

    def plus(self, other: "SquareWaves") -> "SquareWaves":
        """These waves and the waves of ``other``."""
        return SquareWaves(
            np.concatenate([self.frequency, other.frequency]),
            np.concatenate([self.phase, other.phase]),
            np.vstack([self.force, other.force]),
        )


def _first_and_half(frequency: float, phase: float) -> tuple[int, int]:
    """A switch to the negative sign, and half a period, 2^-64 ns."""
    period = TURN / Fraction(frequency) * _S
    return round((Fraction(1, 4) - Fraction(phase) / TURN) * period), round(period / 2)


def _parts(t: float) -> int:
    """``t``, s, in 2^-64 ns."""
    if isinstance(t, Elapsed):
        return t.ns * _NS + round(t.remainder * _S)
    numerator, denominator = float(t).as_integer_ratio()
    return numerator * _S // denominator


def _rounding(t: float) -> int:
    """How far a switch may be ahead of ``t`` and counts as past, 2^-64 ns."""
    return round((_SAME + 4 * float(np.spacing(abs(float(t))))) * _S)
