"""When each message of a bag is due: the timing of playing, without the publishing."""

import queue
import threading
from collections.abc import Generator, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

from impact_observer.bag.reader import RawMessage
from impact_observer.stamps import NS_PER_S

_READ_AHEAD = 5000
"""Messages read before their time: a bag is stored in chunks that take a while to open."""
_PATIENCE = 0.05
"""How often a reader that is ahead looks whether it is still wanted, s."""


@dataclass(frozen=True, slots=True)
class Schedule:
    """When a log time is due.

    Attributes:
        start: the log time that is due at once, ns.
        rate: seconds of the bag a second of the wall clock.
    """

    start: int
    rate: float = 1.0

    def due(self, log_time: int) -> int:
        """Wall time from the beginning to ``log_time``, ns."""
        return round((log_time - self.start) / self.rate)


class Step(NamedTuple):
    """Something to publish.

    Attributes:
        due: wall time from the beginning, ns.
        bag_time: what the simulated clock shows then, ns.
        message: the message; None when only the clock ticks.
    """

    due: int
    bag_time: int
    message: RawMessage | None


def steps(
    messages: Iterable[RawMessage], schedule: Schedule, clock_rate: float | None = None
) -> Iterator[Step]:
    """The steps of one pass through a bag, in order.

    Args:
        messages: ordered by log time, none before the schedule's start.
        schedule: when they are due.
        clock_rate: ticks of the clock between the messages, Hz of wall time; None for none.
            Tick ``k`` is due at ``k / clock_rate`` exactly, never summed up.
    """
    tick = 0
    for message in messages:
        due = schedule.due(message.log_time)
        while clock_rate and (at := round(tick * NS_PER_S / clock_rate)) <= due:
            bag_time = schedule.start + round(at * schedule.rate)
            if bag_time < message.log_time:
                yield Step(at, bag_time, None)
            tick += 1
        yield Step(due, message.log_time, message)


def read_ahead(messages: Iterable[RawMessage]) -> Generator[RawMessage, None, None]:
    """The same ``messages``, read in a thread so that each is there when it is due.

    Raises:
        BagError: reading failed, at the message where it did.
    """
    ahead: queue.Queue[RawMessage | Exception | None] = queue.Queue(_READ_AHEAD)
    given_up = threading.Event()

    def put(item: RawMessage | Exception | None) -> None:
        while not given_up.is_set():
            with suppress(queue.Full):
                ahead.put(item, timeout=_PATIENCE)
                break

    def read() -> None:
        try:
            for message in messages:
                put(message)
                if given_up.is_set():
                    return
            put(None)
        except Exception as error:  # noqa: BLE001 (raised where the messages are wanted)
            put(error)

    thread = threading.Thread(target=read, name="read ahead", daemon=True)
    thread.start()
    try:
        while (item := ahead.get()) is not None:
            if isinstance(item, Exception):
                raise item
            yield item
    finally:
        given_up.set()
        thread.join()
