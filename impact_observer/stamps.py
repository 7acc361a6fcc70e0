# SPDX-License-Identifier: Apache-2.0
"""Instants: int64 nanoseconds outside, float seconds only inside a phase.

A *stamp* is an ``int`` of nanoseconds, as in ROS messages and bags. The plant's impact
times are more precise, so it keeps an :class:`Instant`: a stamp and a float remainder.
"""

import math
from operator import index
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from impact_observer.errors import UsageError

NS_PER_S = 1_000_000_000
MAX_STAMP = (2**31 - 1) * NS_PER_S + (NS_PER_S - 1)
"""The last stamp that ``builtin_interfaces/Time`` can carry (int32 seconds)."""
_WHOLE = "expected whole nanoseconds, an int"
_EXAMPLE = "round(1e9 * seconds)"
MOST_SAMPLES = 100_000_000
"""Largest number of samples in a grid."""


class Instant(NamedTuple):
    """An instant more precise than one nanosecond.

    Attributes:
        stamp: nanoseconds, rounded to the nearest.
        remainder: the instant minus the stamp, s, in [-0.5e-9, 0.5e-9].
    """

    stamp: int
    remainder: float = 0.0

    def shifted_by(self, seconds: float) -> "Instant":
        """The instant ``seconds`` (s, either sign) later."""
        nanoseconds = round(seconds * 1e9)
        left = (seconds - nanoseconds * 1e-9) + self.remainder
        carry = round(left * 1e9)
        return Instant(self.stamp + nanoseconds + carry, left - carry * 1e-9)

    def until(self, stamp: int) -> float:
        """Seconds from here to ``stamp``."""
        return seconds_between(self.stamp, stamp) - self.remainder


class Elapsed(float):
    """Seconds since the epoch, with the rounding error of the float: 1e-11 s after a day.

    Code that needs no more uses the ``float``. Sums with seconds and differences of two times keep
    the rounding error; sums with arrays lose the error.

    Attributes:
        ns: whole nanoseconds.
        remainder: the time minus ``ns``, s, in [-0.5e-9, 0.5e-9].
    """

    ns: int
    remainder: float

    __slots__ = ("ns", "remainder")

    def __new__(cls, ns: int, remainder: float = 0.0) -> "Elapsed":  # noqa: PYI034 (Python 3.11 has Self)
        """Add nanoseconds and a remainder."""
        self = float.__new__(cls, ns / NS_PER_S + remainder)
        self.ns, self.remainder = ns, remainder
        return self

    def __getnewargs__(self) -> tuple[int, float]:  # type: ignore[override]
        """The arguments for a copy or for unpickling."""
        return self.ns, self.remainder

    def __add__(self, seconds: "float | NDArray[np.float64]") -> "Elapsed":
        """The time ``seconds`` later."""
        if not isinstance(seconds, float | int):
            return NotImplemented
        return Elapsed(*Instant(self.ns, self.remainder).shifted_by(seconds))

    def __sub__(self, other: "float | NDArray[np.float64]") -> float:
        """Seconds from another time to this one, or the time some seconds earlier."""
        if isinstance(other, Elapsed):
            return seconds_between(other.ns, self.ns) + (self.remainder - other.remainder)
        return self + -other

    def __eq__(self, other: object) -> bool:
        """Whether two times are equal, rounding errors included."""
        if isinstance(other, Elapsed):
            return self.ns == other.ns and self.remainder == other.remainder
        return super().__eq__(other)

    def __ne__(self, other: object) -> bool:
        """Whether two times differ."""
        return not self == other

    __hash__ = float.__hash__


def elapsed(t: float) -> Elapsed:
    """A time, s since the epoch, with its rounding error where that is known."""
    return t if isinstance(t, Elapsed) else Elapsed(0) + float(t)


def whole_stamp(stamp: object, name: str = "stamp") -> int:
    """A ``stamp`` of any integer type as an int, ns.

    Raises:
        UsageError: ``stamp`` is no integer, such as seconds as a float; the line has the ``name``.
    """
    try:
        return index(stamp)  # type: ignore[arg-type]
    except TypeError:
        raise UsageError(f"{name}: {stamp!r} found; {_WHOLE}, such as {_EXAMPLE}") from None


def whole_stamps(stamps: NDArray[np.int64]) -> NDArray[np.int64]:
    """An array of stamps of any integer type, ns, of the same shape.

    Raises:
        UsageError: the array holds no integers, such as seconds as floats.
    """
    array = np.asarray(stamps)
    if array.size and array.dtype.kind not in "iu":
        raise UsageError(f"stamps: {array.dtype} found; {_WHOLE}, such as {_EXAMPLE}")
    return array.astype(np.int64, copy=False)


def nanoseconds(seconds: ArrayLike, name: str) -> NDArray[np.int64]:
    """Finite ``seconds`` in whole nanoseconds, shape (times,).

    Raises:
        UsageError: text, or numbers that no stamp can carry; the line has the ``name``.
    """
    most = MAX_STAMP // NS_PER_S
    try:
        found = np.ravel(np.asarray(seconds, dtype=float))
    except (TypeError, ValueError):
        raise UsageError(f"{name}: no numbers found; expected seconds") from None
    for wrong in found[~(np.abs(found) <= most)].tolist():
        raise UsageError(f"{name}: {wrong:g} found; expected seconds, at most {most}")
    return np.round(found * NS_PER_S).astype(np.int64)


def seconds_between(start: int, stop: int) -> float:
    """Seconds from stamp ``start`` to stamp ``stop``: integers are subtracted first."""
    return (stop - start) / NS_PER_S


def grid(start: int, stop: int, rate: float) -> NDArray[np.int64]:
    """Stamps ``start + k / rate`` up to and including ``stop``, ns, for ``rate`` in Hz.

    Every stamp is rounded from its own product, never summed up. Shape (samples,); empty when
    ``stop < start``.

    Raises:
        UsageError: more samples than memory holds, stamps that no message can carry, or that are
            no integers, or a rate that is not above 0.
    """
    if not 0 < rate < math.inf:
        raise UsageError(f"rate: {rate:g} found; expected a number of Hz above 0")
    start, stop = whole_stamp(start, "start"), whole_stamp(stop, "stop")
    if stop < start:
        return np.empty(0, dtype=np.int64)
    if stop > MAX_STAMP:
        raise UsageError(f"stamp {text(stop)} s: too late; the last one is {text(MAX_STAMP)} s")
    if seconds_between(start, stop) * rate > MOST_SAMPLES:
        raise UsageError(
            f"{seconds_between(start, stop) * rate:.3g} samples: too many; lower rate or duration"
            f" to {MOST_SAMPLES:g}"
        )
    if NS_PER_S / rate > stop - start + 1:  # also infinite
        return np.array([start])
    last = int(seconds_between(start, stop) * rate) + 1
    stamps = start + np.rint(np.arange(last + 1) * (NS_PER_S / rate)).astype(np.int64)
    return np.asarray(stamps[stamps <= stop])


def from_seconds(seconds: float) -> int:
    """The nearest stamp or length in ns to ``seconds``.

    Raises:
        UsageError: no number of nanoseconds is near.
    """
    if not math.isfinite(seconds * NS_PER_S):
        raise UsageError(f"{seconds:g} s: too long; the last stamp is {text(MAX_STAMP)} s")
    return round(seconds * NS_PER_S)


def text(stamp: int) -> str:
    """``stamp`` as decimal seconds with all nine digits, such as ``12.000000345``."""
    sign = "-" if stamp < 0 else ""
    whole, part = divmod(abs(stamp), NS_PER_S)
    return f"{sign}{whole}.{part:09d}"
