"""Samples of live forces and grounds in messages and in bags."""

from collections.abc import Iterator
from typing import NamedTuple

from impact_observer.io import interfaces
from impact_observer.io.messages import AnyMessage, MessageError, read_stamp
from impact_observer.io.reader import BagReader
from impact_observer.model import System
from impact_observer.model.live_signals import LiveSignals, connected

LIVE_TOPICS = (interfaces.FORCING, interfaces.GROUND_MOTION)


class LiveSample(NamedTuple):
    """A sample of an input or of a ground.

    Attributes:
        name: of the input or ground.
        stamp: when it holds, ns.
        value: N, or m.
        rate: m/s of a ground; 0 of an input.
    """

    name: str
    stamp: int
    value: float
    rate: float


def read_samples(message: AnyMessage, *, moves: bool) -> list[LiveSample]:
    """The samples in a ``sensor_msgs/JointState``: of forces, or with ``moves`` of grounds.

    Raises:
        MessageError: a stamp that is none, or numbers that are not as many as names.
    """
    stamp = read_stamp("JointState.header.stamp", message.header.stamp)
    fields = ("position", "velocity") if moves else ("effort",)
    for each in fields:
        if len(getattr(message, each)) != len(message.name):
            raise MessageError(
                f"JointState.{each}: {len(getattr(message, each))} numbers for"
                f" {len(message.name)} names; expected one each"
            )
    rates = message.velocity if moves else [0.0] * len(message.name)
    values = getattr(message, fields[0])
    return [
        LiveSample(str(name), stamp, float(value), float(rate))
        for name, value, rate in zip(message.name, values, rates, strict=True)
    ]


def give(live: LiveSignals, message: AnyMessage, *, moves: bool) -> Iterator[str]:
    """Add the samples of a message; in words why some cannot be used."""
    try:
        samples = read_samples(message, moves=moves)
    except MessageError as error:
        yield str(error)
        return
    for name, stamp, value, rate in samples:
        add = live.add_motion(name, stamp, value, rate) if moves else live.add(name, stamp, value)
        if add:
            yield add


def give_recorded(reader: BagReader, live: LiveSignals | None) -> Iterator[str]:
    """Add all samples of a bag; in words why some cannot be used.

    Raises:
        BagError: the bag is damaged.
    """
    for each in LIVE_TOPICS if live is not None else ():
        topic = reader.find(each)
        if topic is None or live is None:
            continue
        decode = reader.decoder(topic)
        for raw in reader.raw([topic]):
            yield from give(live, decode(raw.data), moves=each is interfaces.GROUND_MOTION)


def with_recorded(reader: BagReader, system: System, epoch: int) -> System:
    """The ``system`` with the live forces and grounds of a bag, where it has such.

    Raises:
        BagError: the bag is damaged.
    """
    found, live = connected(system)
    if live is not None:
        for _ in give_recorded(reader, live):
            pass  # observe warns of samples that cannot be used
        live.follow(epoch)
    return found
