# SPDX-License-Identifier: Apache-2.0
"""The rules by which events are shed that are too many for an observer to apply."""

from impact_observer.stamps import NS_PER_S

_PERIOD = NS_PER_S // 4
"""Length of the periods of stamps that are flooded or not, ns."""
MOST_DENSE = 10
"""Events stamped within a period that are never shed."""
LONGEST = NS_PER_S // 2
"""Work that may wait before events are shed, ns."""
LATE = NS_PER_S // 4
"""How far the stamp of an event that is late lies behind, ns."""
KEEPS_COMING = 4
"""Quarters of a second in a row in which late events come, from which on they are a flood."""
_MOST_PERIODS = 1000
"""Periods whose events are counted."""


class FloodRule:
    """Which quarters of a second are flooded; events that are stamped in these are shed.

    One is flooded once it has more than ``MOST_DENSE`` events while what waits would take the
    observer longer than ``LONGEST``; so are its neighbours, in which a flood begins and ends. So
    an observer that keeps up sheds nothing, and neither do past events that a late observer
    receives at once: their stamps lie far apart.

    A late event has all later events applied again, so a few are a flood. Late events are shed
    once they have come in ``KEEPS_COMING`` quarters of a second in a row while what waits would
    take longer than ``LONGEST``, until none comes for a quarter of a second.

    Attributes:
        sheds_late: whether late events are shed.
    """

    def __init__(self) -> None:
        """No event has come."""
        self._counts: dict[int, int] = {}
        self._flooded: set[int] = set()
        self._cost = 0
        self._newest = 0
        self._late_since = self._late_until = -1
        self.sheds_late = False

    def is_late(self, stamp: int) -> bool:
        """Whether an event with a stamp (ns) is late: others are stamped long after it."""
        return stamp < self._newest - LATE

    def note_event(self, stamp: int, now: int, received: int) -> None:
        """Count an event.

        Args:
            stamp: of the event, ns.
            now: time of the clock of the stamps, ns; nothing is late as others are ahead of it.
            received: when the event has come, on the monotonic clock, ns.
        """
        self._newest = max(self._newest, min(stamp, now))
        if self.is_late(stamp):
            quarter = received // _PERIOD
            if quarter > self._late_until + 1:
                self._late_since, self.sheds_late = quarter, False
            self._late_until = quarter
        period = stamp // _PERIOD
        self._counts[period] = self._counts.get(period, 0) + 1
        if len(self._counts) > _MOST_PERIODS:
            oldest = next(iter(self._counts))
            del self._counts[oldest]
            near = {oldest - 1, oldest, oldest + 1}
            self._flooded -= near - self._counts.keys()

    def note_cost(self, work: int) -> None:
        """Learn that the latest events took the observer ``work`` (ns) each."""
        self._cost = (self._cost + work) // 2

    def looks_for_floods(self, waiting: int, cost: int) -> bool:
        """Look for flooded periods while ``waiting`` events wait; return whether new ones are.

        The batch that is being applied has taken ``cost`` (ns) for each of its events so far.
        """
        if waiting * max(self._cost, cost) <= LONGEST:
            return False
        keeps_coming = self._late_until - self._late_since >= KEEPS_COMING
        if keeps_coming and not self.sheds_late:
            self.sheds_late = True
            return True
        direct = [each for each, count in self._counts.items() if count > MOST_DENSE]
        dense = {each + k for each in direct for k in (-1, 0, 1)}
        if dense <= self._flooded:
            return False
        self._flooded |= dense
        return True

    def sheds(self, stamp: int) -> bool:
        """Whether an event with a stamp (ns) is shed."""
        return self.is_dense(stamp) or (self.sheds_late and self.is_late(stamp))

    def is_dense(self, stamp: int) -> bool:
        """Whether the period of a stamp (ns) is flooded."""
        return stamp // _PERIOD in self._flooded
