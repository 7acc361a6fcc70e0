# SPDX-License-Identifier: Apache-2.0
"""Messages in constant memory: their rate, histories of quantities, the most recent states."""

import statistics
from collections import OrderedDict, deque

from impact_observer.ros.watch.snapshot import EstimateHistory, TopicRate
from impact_observer.stamps import NS_PER_S

_STATES = 2000
"""States kept to be matched by stamp."""
_BINS = 240
"""Values of a history."""
_ARRIVALS = 64
"""Arrivals from which a rate or a latency is computed."""
_MIN_SPACING = 0.1
"""Least time between two arrivals for a rate, s: messages are read in bursts."""
_SETTLING_TIME = 1.0
"""Time of reception before arrivals count, s: past messages arrive in one burst."""


class Arrivals:
    """Arrival times and latencies of the messages of a topic."""

    def __init__(self) -> None:
        self.count = 0
        self._begin = self._last = 0.0
        self._times: deque[tuple[float, int]] = deque(maxlen=_ARRIVALS)
        self._latencies: deque[float] = deque(maxlen=_ARRIVALS)

    def add(self, now: float, latency: float | None) -> None:
        """Add a message that arrived at wall time ``now`` (s), ``latency`` (s) after its stamp."""
        if not self.count:
            self._begin = now
        self.count += 1
        self._last = now
        if now > self._begin + _SETTLING_TIME:
            if not self._times or now >= self._times[-1][0] + _MIN_SPACING:
                self._times.append((now, self.count))
            if latency is not None:
                self._latencies.append(latency)

    def rate(self, topic: str, now: float) -> TopicRate:
        """Rate, latency and silence of ``topic`` at wall time ``now`` (s)."""
        rate = None
        if len(self._times) > 1:
            (begin, first), (end, last) = self._times[0], self._times[-1]
            rate = (last - first) / (end - begin)
        latency = statistics.median(self._latencies) if self._latencies else None
        return TopicRate(topic, self.count, rate, latency, now - self._last)


class HistoryBuffer:
    """A quantity over the last seconds in bins of time; each bin keeps its last value."""

    def __init__(self, seconds: float) -> None:
        """Keep the last ``seconds`` (s)."""
        self._seconds = seconds
        self._width = max(round(seconds * NS_PER_S / _BINS), 1)
        self._bins: OrderedDict[int, float] = OrderedDict()
        self._now: float | None = None

    def add(self, stamp: int, value: float) -> None:
        """Add a value at a ``stamp`` (ns); one before all bins clears them first."""
        place = stamp // self._width
        if self._bins and place <= next(reversed(self._bins)) - _BINS:
            self._bins.clear()
        self._now = value
        self._bins[place] = value
        while len(self._bins) > _BINS:
            self._bins.popitem(last=False)

    def history(self) -> EstimateHistory:
        """All bins; one without a value has that of the bin before."""
        if not self._bins:
            return EstimateHistory(seconds=self._seconds)
        last = max(self._bins)
        earlier = [place for place in self._bins if place <= last - _BINS]
        value = self._bins[max(earlier)] if earlier else None
        values = []
        for place in range(last - _BINS + 1, last + 1):
            value = self._bins.get(place, value)
            values.append(value)
        return EstimateHistory(self._now, tuple(values), self._seconds)


class RecentMessages:
    """The most recent messages of a topic as bytes, by stamp, in the order of arrival."""

    def __init__(self) -> None:
        self._data: OrderedDict[int, bytes] = OrderedDict()

    def add(self, stamp: int, data: bytes) -> None:
        """Keep a message, and drop the oldest."""
        self._data[stamp] = data
        self._data.move_to_end(stamp)
        if len(self._data) > _STATES:
            self._data.popitem(last=False)

    def last(self, other: "RecentMessages | None" = None) -> int | None:
        """The last stamp; with ``other``, the last that both have."""
        stamps = reversed(self._data)
        if other is None:
            return next(stamps, None)
        return next((stamp for stamp in stamps if stamp in other), None)

    def __contains__(self, stamp: int) -> bool:
        return stamp in self._data

    def data(self, stamp: int) -> bytes:
        """The message at a stamp that is kept."""
        return self._data[stamp]
