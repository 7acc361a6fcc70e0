# SPDX-License-Identifier: Apache-2.0
"""Samples of live forces, and the pulse that is the epoch, in messages and in bags."""

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress

from impact_observer.io import interfaces
from impact_observer.io.messages import MessageError, read_efforts, read_pulse
from impact_observer.io.reader import BagReader
from impact_observer.model import System
from impact_observer.model.live_signals import LiveSignals, connected
from impact_observer.plain_text import part_left_out

_DEPTH = 2000
"""Messages with efforts that may wait: those of 2 s at 1 kHz."""


def give_recorded(
    reader: BagReader,
    live: LiveSignals | None,
    interface: interfaces.Interface = interfaces.FORCING,
) -> Iterator[str]:
    """Add all samples of a bag; a line for each reason why some were left out, with their count.

    Without ``live``, of a model that has no inputs, nothing is read. Of another topic than
    ``FORCING``, which has efforts of joints, those of other joints are left out.

    Raises:
        BagError: the bag is damaged.
    """
    if live is None:
        return
    if (topic := reader.find(interface)) is None:
        if interface != interfaces.FORCING:
            yield f"no efforts on {interface.topic}, where the model has them: they count as zero"
        return
    lost = Counter[str]()
    for _, message in reader.messages(topic):
        try:
            problems = {
                live.add_force(*each)
                for each in read_efforts(message)
                if interface == interfaces.FORCING or each.name in live.inputs
            }
        except MessageError as error:
            problems = {str(error)}
        lost.update(filter(None, problems))
    for why, count in lost.items():
        what = f"messages on {topic} wholly or partly"
        yield part_left_out(count, reader.topics[topic].count, what, why)


def efforts_on(topic: str) -> interfaces.Interface:
    """A ``topic`` with efforts of a robot's joints, as drivers publish them."""
    quality = interfaces.Quality(reliable=False, depth=_DEPTH)
    return interfaces.Interface(topic, interfaces.JOINT_STATE, quality)


def first_pulse(reader: BagReader, topic: str | None = None) -> int:
    """The stamp of the first pulse of a drive in a bag, ns; 0 without a pulse.

    ``topic`` has the pulses; None for ``phase_reference``. Raises BagError for a damaged bag.
    """
    topic = topic or reader.find(interfaces.PHASE_REFERENCE)
    for _, message in () if topic is None else reader.messages(topic):
        with suppress(MessageError):
            return read_pulse(message)
    return 0


def with_recorded(
    reader: BagReader,
    system: System,
    epoch: int,
    warn: Callable[[str], object] = lambda _: None,
) -> System:
    """The ``system`` with the live forces that a bag has; its ``t = 0`` is at ``epoch``, ns.

    ``warn`` is called with a line for each reason why samples were left out.

    Raises:
        BagError: the bag is damaged.
    """
    system, live = connected(system)
    if live is not None:
        for line in give_recorded(reader, live):
            warn(line)
        live.follow(epoch)
    return system
