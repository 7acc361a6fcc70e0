# SPDX-License-Identifier: Apache-2.0
"""Tells the peaks of one ringing hit, which a short dead time lets pass, from real hits."""

from impact_observer.stamps import seconds_between

_REACH = 10
"""Dead times within which a peak follows another one of its bunch."""
_LOWER = 0.8
"""Height of a peak of ringing, at most, relative to the first peak of its bunch."""
_PAUSES = 10.0
"""Least mean pause between bunches, relative to the mean interval inside."""
_FEW, _SHARE = 5, 0.2
"""Least number and least share of the peaks of ringing that make a doubt."""


class Bunches:
    """The peaks of a sensor in bunches, in constant memory.

    The intervals of real bounces shrink from one to the next, and real strokes are about as high
    as the first one. Peaks of ringing are lower than the first one, at intervals that do not
    shrink.
    """

    def __init__(self) -> None:
        self._peaks = self._ringing = self._pauses = 0
        self._inside = self._outside = self._longest = 0
        self._begin, self._height = 0, 0.0
        self._last = self._interval = 0

    def note_peak(self, stamp: int, height: float, dead_time: int) -> None:
        """Count a peak with its top at ``stamp`` (ns), of a sensor with a ``dead_time`` (ns)."""
        interval, self._last = stamp - self._last, stamp
        self._peaks += 1
        if 0 < interval <= _REACH * dead_time:
            is_low = height < _LOWER * self._height
            self._ringing += is_low and 0 < self._interval <= interval
            self._inside, self._interval = self._inside + interval, interval
            self._longest = max(self._longest, stamp - self._begin)
            return
        if 0 < interval < stamp:
            self._pauses, self._outside = self._pauses + 1, self._outside + interval
        self._begin, self._height, self._interval = stamp, height, 0

    @property
    def doubt(self) -> str:
        """Why the peaks look like ringing, with the remedy; empty where they do not."""
        inside = self._peaks - 1 - self._pauses
        if self._ringing < max(_FEW, _SHARE * self._peaks) or not self._pauses:
            return ""
        spacing = seconds_between(0, self._inside) / inside
        pause = seconds_between(0, self._outside) / self._pauses
        if pause < _PAUSES * spacing:
            return ""
        return (
            f"{inside} of {self._peaks} impacts follow another after {spacing:.2g} s, lower and at"
            f" intervals that do not shrink, in bunches {pause:.2g} s apart: peaks of one ringing"
            f" hit; give a dead time (--dead-time) longer than a bunch, which lasts up to"
            f" {seconds_between(0, self._longest):.2g} s"
        )
