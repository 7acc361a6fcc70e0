# SPDX-License-Identifier: Apache-2.0
"""The stamp at which the time of a bag is zero, and the reading of a part of a bag."""

from collections.abc import Callable, Collection, Sequence
from functools import partial
from typing import NamedTuple

from impact_observer.errors import UnfitBagError, UsageError
from impact_observer.events import ImpactEvent
from impact_observer.io import interfaces
from impact_observer.io.live_inputs import first_pulse
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import epoch_of
from impact_observer.model import System
from impact_observer.model.measurement import Measurement
from impact_observer.model.robot_description import RobotDescription
from impact_observer.observer.samples import SensorSample
from impact_observer.stamps import MAX_STAMP, from_seconds, seconds_between, text

EPOCH, FIRST_IMPACT, FIRST_STATE = "the epoch", "the first impact", "the first state"
"""Instants at which the time of a bag may be zero, in words."""
FILE_ZERO = "the file's time 0"
"""That of a file which is no bag."""
FIRST_SAMPLE = "the first sample"
"""Where a motion begins if nothing says the epoch, and samples come before the first impact."""
FIRST_MESSAGE = "the first message of the sensors"
"""The zero of time of a bag of sensors without an epoch, in which impacts are not found yet."""


class TimeZero(NamedTuple):
    """The instant at which the time of a bag is zero: its stamp, ns, and words such as ``EPOCH``.

    The note is a line on what is taken for the epoch, where nothing says it; else empty.
    """

    stamp: int
    instant: str = EPOCH
    note: str = ""

    @property
    def axis(self) -> str:
        """The label of an axis of time."""
        return f"time since {self.instant} [s]"


def time_zero(reader: BagReader, epoch: int | None = None) -> TimeZero:
    """The epoch of a bag; without an epoch the first impact, without impacts the first state.

    A part of a bag has the zero of the whole bag. An ``epoch`` (ns) of the caller comes first.

    Raises:
        BagError: the bag is damaged, or has neither epoch nor impacts nor states.
    """
    if epoch:
        return TimeZero(epoch)
    with reader.whole_bag():
        topic = reader.find(interfaces.IMPACTS)
        events = [] if topic is None else [*reader.events(topic)]
        if known := epoch_of(events) or first_pulse(reader):
            return TimeZero(known)
        if events:
            return TimeZero(min(each.stamp for each in events), FIRST_IMPACT)
        if first := reader.first_state(reader.state_topics()):
            return TimeZero(first.stamp, FIRST_STATE)
    raise UnfitBagError(f"{reader.path}: has no time zero; expected an epoch, impacts or states")


def sensor_zero(reader: BagReader, topics: Collection[str], epoch: int = 0) -> TimeZero:
    """The ``epoch`` (ns), else the first pulse of a drive, else the first of all messages."""
    with reader.whole_bag():
        if known := epoch or first_pulse(reader):
            return TimeZero(known)
        return TimeZero(min(reader.all_stamps(topics), default=0), FIRST_MESSAGE)


def assumed_epoch(
    system: System | RobotDescription,
    events: Sequence[ImpactEvent],
    samples: Sequence[SensorSample],
    epoch: int,
) -> TimeZero:
    """What is taken for the epoch: the first of the ``samples`` that come before all ``events``.

    Where nothing depends on time, the epoch is only the instant of the initial state, and any
    instant will do. The stamp is 0 where an epoch is known (``epoch``, ns, or by the events), and
    where no sample comes before the first impact.
    """
    if epoch or epoch_of(events) or not events:
        return TimeZero(0)
    first = min(each.stamp for each in events)
    note = f"no epoch, so time zero is the first impact, {text(first)} s"
    early = sum(each.stamp < first for each in samples)
    if not early or system.depends_on_time:
        return TimeZero(0, FIRST_IMPACT, note)
    start = max(samples[0].stamp, 1)
    samples_before = f"{early} of {len(samples)} samples come before it"
    holds = f"the initial state holds at the first of them, {text(start)} s"
    return TimeZero(start, FIRST_SAMPLE, f"{note}; {samples_before}, and {holds}")


class BagPart(NamedTuple):
    """The part of a bag, or of a signal, that a command reads: first and last stamp, ns.

    ``is_late`` says whether something was recorded before the part.
    """

    low: int
    high: int
    words: str
    is_late: bool = False

    @classmethod
    def between(cls, zero: TimeZero, start: float | None, duration: float | None) -> "BagPart":
        """The part from ``start`` s after ``zero``, ``duration`` s long; None for an open end."""
        most = seconds_between(0, MAX_STAMP)
        begin = min(zero.stamp + from_seconds(min(start or 0.0, most)), MAX_STAMP)
        low, high = 0 if start is None else begin, MAX_STAMP
        if duration is not None:
            high = min(begin + from_seconds(min(duration, most)), MAX_STAMP)
        since = "the beginning" if start is None else f"{start:.9g} s"
        until = "the end" if duration is None else f"{seconds_between(zero.stamp, high):.9g} s"
        return cls(low, high, f"{since} to {until} after {zero.instant}, {text(zero.stamp)} s")


def read_part(
    reader: BagReader,
    start: float | None,
    duration: float | None,
    topics: Collection[str],
    *,
    tell: Callable[[str], object] = lambda _line: None,
    zero: Callable[[BagReader], TimeZero] = time_zero,
    received: Collection[str] = (),
) -> BagPart | None:
    """Have only a part of a bag read from now on, by stamps.

    The stamp is that of the header; of a message without one, the time of its recording. The
    model, and what drives the rig live, is read whole.

    Args:
        reader: the bag.
        start: of the part, s after ``zero``; None for all before it, too.
        duration: of the part, s; None for all.
        topics: absolute names, on one of which the part must have a message; none for any part.
        tell: called with a line that names the part, if it is not the whole bag.
        zero: gives time zero.
        received: topics of which the time of recording counts, whatever their headers say.

    Returns:
        The part; None for the whole bag, where neither start nor duration is given.

    Raises:
        UsageError: the part has no message on the topics.
        BagError: the bag is damaged, or has no time zero.
    """
    if start is None and duration is None:
        return None
    part = BagPart.between(zero(reader), start, duration)
    reader.read_between(part.low, part.high, received)
    least, most, is_late = MAX_STAMP, 0, False
    with reader.whole_bag():
        for stamp in reader.all_stamps(topics):
            if part.low <= stamp <= part.high:
                tell(f"part: {part.words}")
                return part._replace(is_late=is_late)
            is_late |= stamp < part.low
            least, most = min(least, stamp), max(most, stamp)
    if not topics:
        return part
    there = f"its stamps are {text(least)} to {text(most)} s" if most else "it is empty"
    raise UsageError(
        f"{reader.path}: nothing on {' and '.join(topics)} from {part.words}; {there}; choose"
        " another part with --start and --duration"
    )


def topic_of_impacts(reader: BagReader) -> list[str]:
    """The topic of the impacts of a bag, if there is one."""
    return [topic] if (topic := reader.find(interfaces.IMPACTS)) is not None else []


def read_impacts_part(
    reader: BagReader,
    start: float | None,
    duration: float | None,
    epoch: int,
    measurements: Sequence[Measurement],
    *,
    tell: Callable[[str], object],
) -> None:
    """``read_part`` of a bag, with its ``epoch`` (ns), for an observer; it must have an impact."""
    read_part(
        reader,
        start,
        duration,
        topic_of_impacts(reader),
        tell=tell,
        zero=partial(time_zero, epoch=epoch),
        received=[interfaces.absolute(m.topic) for m in measurements if m.stamp == "receive"],
    )
