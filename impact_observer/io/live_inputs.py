# SPDX-License-Identifier: Apache-2.0
"""Samples of live forces, and the pulse that is the epoch, in messages and in bags."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from typing import NamedTuple

from impact_observer.events import ImpactEvent
from impact_observer.io import interfaces
from impact_observer.io.messages import AnyMessage, MessageError, read_stamp
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import epoch_of
from impact_observer.model import System
from impact_observer.model.live_signals import LiveSignals, connected
from impact_observer.plain_text import part_left_out

LIVE_TOPICS = (interfaces.FORCING,)
_DEPTH = 2000
"""Messages with efforts that may wait: those of 2 s at 1 kHz."""


class LiveSample(NamedTuple):
    """A sample of an input.

    Attributes:
        name: of the input.
        stamp: time of validity, ns.
        value: N.
    """

    name: str
    stamp: int
    value: float


def read_samples(message: AnyMessage) -> list[LiveSample]:
    """The samples of forces in a ``sensor_msgs/JointState``.

    Raises:
        MessageError: a stamp that is none, or numbers that are not as many as names.
    """
    stamp = read_stamp("JointState.header.stamp", message.header.stamp)
    if len(message.effort) != len(message.name):
        raise MessageError(
            f"JointState.effort: {len(message.effort)} numbers for {len(message.name)} names;"
            " expected one each"
        )
    return [
        LiveSample(str(name), stamp, float(value))
        for name, value in zip(message.name, message.effort, strict=True)
    ]


def read_pulse(message: AnyMessage) -> int:
    """The stamp of a ``std_msgs/Header``, at which the phase of the drive is zero, ns.

    Raises:
        MessageError: it is not after 0.
    """
    return read_stamp("Header.stamp", message.stamp)


def give(live: LiveSignals, interface: interfaces.Interface, message: AnyMessage) -> Iterator[str]:
    """Add what is in a message; in words why some cannot be used.

    Of another topic than the ``LIVE_TOPICS``, which has efforts of joints, others are left out.
    """
    try:
        problems = [
            live.add_force(*each)
            for each in read_samples(message)
            if interface in LIVE_TOPICS or each.name in live.inputs
        ]
    except MessageError as error:
        problems = [str(error)]
    yield from filter(None, problems)


def give_recorded(reader: BagReader, live: LiveSignals | None) -> Iterator[str]:
    """Add all samples of a bag; a line for each reason why some were left out, with their count.

    Raises:
        BagError: the bag is damaged.
    """
    for each in LIVE_TOPICS if live is not None else ():
        topic = reader.find(each)
        if topic is None or live is None:
            continue
        lost = Counter[str]()
        for _, message in reader.messages(topic):
            lost.update({*give(live, each, message)})
        for why, count in lost.items():
            what = f"messages on {topic} wholly or partly"
            yield part_left_out(count, reader.topics[topic].count, what, why)


def efforts_on(topic: str) -> interfaces.Interface:
    """A ``topic`` with efforts of a robot's joints, as drivers publish them."""
    quality = interfaces.Quality(reliable=False, depth=_DEPTH)
    return interfaces.Interface(topic, interfaces.JOINT_STATE, quality)


def give_efforts(reader: BagReader, live: LiveSignals, topic: str) -> Iterator[str]:
    """Add the efforts of a robot's joints on a ``topic`` of a bag; lines as ``give_recorded``.

    Raises:
        BagError: the bag is damaged.
    """
    efforts, lost = efforts_on(topic), Counter[str]()
    if (name := efforts.topic) not in reader.topics:
        yield f"no efforts on {name}, where the model has them: they count as zero"
        return
    for _, message in reader.messages(name):
        lost.update({*give(live, efforts, message)})
    for why, count in lost.items():
        what = f"messages on {name} wholly or partly"
        yield part_left_out(count, reader.topics[name].count, what, why)


def first_pulse(reader: BagReader, topic: str | None = None) -> int:
    """The stamp of the first pulse of a drive in a bag, ns; 0 without a pulse.

    Args:
        reader: of the bag.
        topic: of the pulses; None for ``phase_reference``.

    Raises:
        BagError: the bag is damaged.
    """
    topic = topic or reader.find(interfaces.PHASE_REFERENCE)
    for _, message in () if topic is None else reader.messages(topic):
        with suppress(MessageError):
            return read_pulse(message)
    return 0


def epoch_in(reader: BagReader, events: Iterable[ImpactEvent]) -> int:
    """The epoch in the ``events`` of a bag, else the stamp of the first pulse, ns; else 0.

    Raises:
        BagError: the bag is damaged.
    """
    return epoch_of(events) or first_pulse(reader)


def with_recorded(
    reader: BagReader,
    system: System,
    epoch: int,
    warn: Callable[[str], object] = lambda _: None,
) -> System:
    """The ``system`` with the live forces that a bag has.

    Args:
        reader: the bag.
        system: of the rig.
        epoch: stamp of ``t = 0``, ns.
        warn: called with a line for each reason why samples were left out.

    Raises:
        BagError: the bag is damaged.
    """
    system, live = connected(system)
    if live is not None:
        for line in give_recorded(reader, live):
            warn(line)
        live.follow(epoch)
    return system
