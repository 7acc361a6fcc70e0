# SPDX-License-Identifier: Apache-2.0
"""The stamps at which an observer node publishes estimates: ``epoch + k / rate``."""

import math
from typing import NamedTuple

from impact_observer.stamps import NS_PER_S, seconds_between

MOST_DUE = 20
"""Estimates that are published together, such as after a jump of simulated time."""


class DueEstimates(NamedTuple):
    """The estimates to publish now.

    Attributes:
        stamps: stamps of the estimates, ascending, ns.
        skipped: how many older estimates are not published.
    """

    stamps: list[int]
    skipped: int


class EstimateTimes:
    """Counts the estimates on the grid ``epoch + k / rate``, so that each is due once."""

    def __init__(self, rate: float) -> None:
        """Estimates at ``rate`` (Hz); none is published yet."""
        self.rate = rate
        self._last: int | None = None

    def due(self, epoch: int, start: int, now: int) -> DueEstimates:
        """The estimates that have become due since the last call.

        The first estimate is never skipped, as ratios of distances refer to it.

        Args:
            epoch: stamp of k = 0, ns.
            start: stamp before which there is no estimate, ns.
            now: stamp up to which estimates are due, ns.
        """
        first, newest = self._number(epoch, start - 1) + 1, self._number(epoch, now)
        last = first - 1 if self._last is None else self._last
        if newest <= max(last, first - 1):
            return DueEstimates([], 0)
        numbers = [*range(max(last + 1, first, newest - MOST_DUE + 1), newest + 1)]
        if self._last is None and numbers[0] > first:
            numbers.insert(0, first)
        self._last = newest
        stamps = [self._stamp(epoch, k) for k in numbers]
        return DueEstimates(stamps, newest - last - len(numbers))

    def restart(self) -> None:
        """Return to the state before the first estimate."""
        self._last = None

    def change_rate(self, rate: float, epoch: int, last: int) -> None:
        """Go on at another ``rate`` (Hz) after the stamp ``last`` (ns) of the last estimate."""
        self.rate = rate
        if self._last is not None:
            self._last = self._number(epoch, last)

    def _stamp(self, epoch: int, k: int) -> int:
        """The stamp of number ``k``, ns."""
        return epoch + round(k * NS_PER_S / self.rate)

    def _number(self, epoch: int, stamp: int) -> int:
        """The largest k whose stamp is at most ``stamp`` (ns)."""
        k = math.floor(seconds_between(epoch, stamp) * self.rate) + 1  # may be rounded by one
        while self._stamp(epoch, k) > stamp:
            k -= 1
        return k
