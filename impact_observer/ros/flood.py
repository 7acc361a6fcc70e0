# SPDX-License-Identifier: Apache-2.0
"""The rule by which events are shed that are too many for an observer to apply."""

from impact_observer.stamps import NS_PER_S

_PERIOD = NS_PER_S // 4
"""Length of the periods of stamps that are flooded or not, ns."""
MOST_DENSE = 10
"""Events stamped within a period that are never shed."""
LONGEST = NS_PER_S // 2
"""Work that may wait before events are shed, ns."""
_MOST_PERIODS = 1000
"""Periods whose events are counted."""


class FloodRule:
    """Which quarters of a second are flooded; events that are stamped in these are shed.

    One is flooded once it has more than ``MOST_DENSE`` events while what waits would take the
    observer longer than ``LONGEST``. So an observer that keeps up sheds nothing,
    and neither do past events that a late observer receives at once: their stamps lie far apart.
    """

    def __init__(self) -> None:
        """No event has come."""
        self._counts: dict[int, int] = {}
        self._flooded: set[int] = set()
        self._cost = 0

    def note_event(self, stamp: int) -> None:
        """Count an event with a stamp, ns."""
        period = stamp // _PERIOD
        self._counts[period] = self._counts.get(period, 0) + 1
        if len(self._counts) > _MOST_PERIODS:
            oldest = next(iter(self._counts))
            del self._counts[oldest]
            self._flooded.discard(oldest)

    def note_cost(self, work: int) -> None:
        """Learn that the latest events took the observer ``work`` (ns) each."""
        self._cost = (self._cost + work) // 2

    def looks_for_floods(self, waiting: int, cost: int) -> bool:
        """Look for flooded periods while ``waiting`` events wait; return whether new ones are.

        The batch that is being applied has taken ``cost`` (ns) for each of its events so far.
        """
        if waiting * max(self._cost, cost) <= LONGEST:
            return False
        dense = {each for each, count in self._counts.items() if count > MOST_DENSE}
        if dense <= self._flooded:
            return False
        self._flooded |= dense
        return True

    def sheds(self, stamp: int) -> bool:
        """Whether an event with a stamp (ns) is shed."""
        return stamp // _PERIOD in self._flooded
