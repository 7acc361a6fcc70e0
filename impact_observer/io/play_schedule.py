# SPDX-License-Identifier: Apache-2.0
"""How a bag is played, and when each message is due. The publishing is in ``ros/player.py``."""

import math
import queue
import threading
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from enum import Enum
from typing import final

from impact_observer.errors import UsageError
from impact_observer.io.qos_overrides import Profile
from impact_observer.io.reader import RawMessage
from impact_observer.stamps import NS_PER_S

_READ_AHEAD = 5000
"""Messages read before they are due: to open the next chunk of a bag takes a while."""
_PATIENCE = 0.05
"""How often a reader with a full queue checks whether it is closed, s."""


class Control(Enum):
    """How the user controls a bag that is played."""

    PAUSE = "pause, or go on"
    NEXT = "the next message, while paused"
    FASTER = "a tenth faster"
    SLOWER = "the same slower"
    QUIT = "the end"


@dataclass(frozen=True, slots=True)
class Playing:
    """How a bag is played.

    Attributes:
        topics: only these absolute names; None for all.
        rate: seconds of the bag per second of the wall clock.
        start: where to begin, s after the bag's start.
        duration: of the part that is played, s; None up to the end.
        loop: whether to begin again at the end.
        paused: whether to begin paused.
        clock_rate: ticks of ``/clock``, Hz of wall time, in addition to one at every message; the
            bag's own clock is then not played. None for no clock.
        names: new names of topics, by their absolute names in the bag.
        profiles: quality of service to offer instead, by the names in the bag.
    """

    topics: Collection[str] | None = None
    rate: float = 1.0
    start: float = 0.0
    duration: float | None = None
    loop: bool = False
    paused: bool = False
    clock_rate: float | None = None
    names: Mapping[str, str] = field(default_factory=dict)
    profiles: Mapping[str, Profile] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            UsageError: one is out of range.
        """
        numbers = {"rate": self.rate, "clock rate": self.clock_rate, "duration": self.duration}
        for name, value in numbers.items():
            if value is not None and not 0 < value < math.inf:
                raise UsageError(f"{name} is {value}; expected a positive number")


@dataclass(slots=True)
class Pace:
    """The relation of log times to wall times; it can be paused, and its rate changed.

    All times are measured from one pair of a log time and a wall time, so delays do not add up.

    Attributes:
        bag: a log time, ns.
        wall: the wall time at which it is due, ns.
        rate: seconds of the bag per second of the wall clock.
        paused: whether the bag's time stands still.
    """

    bag: int
    wall: int
    rate: float = 1.0
    paused: bool = False

    def due(self, log_time: int) -> int | None:
        """Wall time of ``log_time``, ns; None while paused."""
        return None if self.paused else self.wall + round((log_time - self.bag) / self.rate)

    def at(self, wall: int) -> int:
        """Log time at a ``wall`` time, ns; not before ``bag``."""
        return (
            self.bag if self.paused else self.bag + max(round((wall - self.wall) * self.rate), 0)
        )

    def jump(self, log_time: int, wall: int) -> None:
        """Make ``log_time`` due at ``wall``, both ns."""
        self.bag, self.wall = log_time, wall

    def toggle_pause(self, wall: int, latest: int) -> None:
        """Pause, or go on.

        Args:
            wall: now, ns.
            latest: log time of the next message, ns, which may be overdue and is played first.
        """
        self.jump(min(self.at(wall), latest), wall)
        self.paused = not self.paused

    def scale_rate(self, wall: int, latest: int, factor: float) -> None:
        """Go on ``factor`` times as fast; other arguments as for :meth:`toggle_pause`."""
        self.jump(min(self.at(wall), latest), wall)
        self.rate *= factor


@dataclass(slots=True)
class Ticks:
    """Wall times of the regular ticks of ``/clock``, each computed from the first one.

    Attributes:
        rate: Hz.
        begin: the first tick, ns.
        count: number of past ticks.
    """

    rate: float
    begin: int
    count: int = 0

    @property
    def next(self) -> int:
        """Wall time of the next tick, ns."""
        return self.begin + round(self.count * NS_PER_S / self.rate)


@final
class ReadAhead:
    """Reads messages ahead in a thread, and passes them on once."""

    def __init__(self, messages: Iterable[RawMessage]) -> None:
        """Begin to read, and wait for the first message."""
        self._ahead: queue.Queue[RawMessage | Exception | None] = queue.Queue(_READ_AHEAD)
        self._closed = threading.Event()
        self._thread = threading.Thread(
            target=self._read, args=(messages,), name="read ahead", daemon=True
        )
        self._thread.start()
        self._first = self._ahead.get()

    def __iter__(self) -> Iterator[RawMessage]:
        """The messages.

        Raises:
            BagError: reading failed, at the message where it did.
        """
        item = self._first
        while item is not None:
            if isinstance(item, Exception):
                raise item
            yield item
            item = self._ahead.get()

    def close(self) -> None:
        """Stop reading; closing twice does no harm."""
        self._closed.set()
        self._thread.join()

    def _put(self, item: RawMessage | Exception | None) -> None:
        while not self._closed.is_set():
            with suppress(queue.Full):
                self._ahead.put(item, timeout=_PATIENCE)
                break

    def _read(self, messages: Iterable[RawMessage]) -> None:
        """In the thread: read all messages, unless closed."""
        try:
            for message in messages:
                self._put(message)
                if self._closed.is_set():
                    return
            self._put(None)
        except Exception as error:  # noqa: BLE001 (raised by __iter__)
            self._put(error)
