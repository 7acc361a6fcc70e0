"""What is kept of messages in constant memory: arrivals, courses, the newest states."""

import statistics
from collections import OrderedDict, deque

from impact_observer.ros.snapshot import EstimateHistory, TopicRate
from impact_observer.stamps import NS_PER_S

_MEMORY = 2000
"""States kept until their counterpart comes."""
_BINS = 240
"""Values of a course."""
_ARRIVALS = 64
"""Arrivals that a rate or a latency is taken from."""
_APART = 0.1
"""How far apart those of a rate are at least, s: what waits for us comes in bursts."""
_SETTLE = 1.0
"""How long a topic is heard before its rate counts, s: what was kept for us comes at once."""


class Arrivals:
    """When the messages of a topic came."""

    def __init__(self) -> None:
        self.count = 0
        self._begin = self._last = 0.0
        self._times: deque[tuple[float, int]] = deque(maxlen=_ARRIVALS)
        self._latencies: deque[float] = deque(maxlen=_ARRIVALS)

    def add(self, now: float, latency: float | None) -> None:
        """One came at wall time ``now`` (s), ``latency`` (s) after its stamp."""
        if not self.count:
            self._begin = now
        self.count += 1
        self._last = now
        if now > self._begin + _SETTLE:
            if not self._times or now >= self._times[-1][0] + _APART:
                self._times.append((now, self.count))
            if latency is not None:
                self._latencies.append(latency)

    def flow(self, topic: str, now: float) -> TopicRate:
        """How they come, at wall time ``now`` (s)."""
        rate = None
        if len(self._times) > 1:
            (begin, first), (end, last) = self._times[0], self._times[-1]
            rate = (last - first) / (end - begin)
        latency = statistics.median(self._latencies) if self._latencies else None
        return TopicRate(topic, self.count, rate, latency, now - self._last)


class ValueBuffer:
    """A quantity over the last seconds, in bins of time; each keeps the last value that came."""

    def __init__(self, seconds: float) -> None:
        """Keep the last ``seconds`` (s)."""
        self._seconds = seconds
        self._width = max(round(seconds * NS_PER_S / _BINS), 1)
        self._bins: OrderedDict[int, float] = OrderedDict()
        self._now: float | None = None

    def add(self, stamp: int, value: float) -> None:
        """A value at a ``stamp`` (ns); an older one than is kept begins anew."""
        place = stamp // self._width
        if self._bins and place <= next(reversed(self._bins)) - _BINS:
            self._bins.clear()
        self._now = value
        self._bins[place] = value
        while len(self._bins) > _BINS:
            self._bins.popitem(last=False)

    def course(self) -> EstimateHistory:
        """What is kept; a bin without a value has that of the bin before."""
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


class Newest:
    """The last states of a topic as bytes, by stamp, in the order in which they came."""

    def __init__(self) -> None:
        self._data: OrderedDict[int, bytes] = OrderedDict()

    def add(self, stamp: int, data: bytes) -> None:
        """Keep a state, and forget the oldest."""
        self._data[stamp] = data
        self._data.move_to_end(stamp)
        if len(self._data) > _MEMORY:
            self._data.popitem(last=False)

    def last(self, other: "Newest | None" = None) -> int | None:
        """The stamp of the newest state that the ``other`` has too; of the newest without one."""
        stamps = reversed(self._data)
        if other is None:
            return next(stamps, None)
        return next((stamp for stamp in stamps if stamp in other), None)

    def __contains__(self, stamp: int) -> bool:
        return stamp in self._data

    def data(self, stamp: int) -> bytes:
        """The message at a stamp that is here."""
        return self._data[stamp]
