# SPDX-License-Identifier: Apache-2.0
"""Samples of declared sensors in messages of any type, and in bags."""

import statistics
from collections import Counter
from collections.abc import Collection, Sequence
from typing import NamedTuple

from impact_observer.errors import UsageError
from impact_observer.io import interfaces
from impact_observer.io.messages import AnyMessage
from impact_observer.io.reader import BagReader
from impact_observer.message_fields import header_stamp, numbers_at
from impact_observer.model.measurement import Measurement
from impact_observer.model.system import LARGEST_STATE
from impact_observer.observer.samples import SensorSample
from impact_observer.plain_text import part_left_out
from impact_observer.stamps import NS_PER_S, from_seconds

_MOST_DELAY = 60.0
"""Largest difference of the delay of a sample from the median delay of its sensor, s."""
SENSOR_STATUS = "sensor "
"""Prefix of a sensor's name in the name of its diagnostic status."""
SILENT_RATE = 50.0
"""Rate of a sensor, Hz, beyond which the verdicts on its samples are not published."""


class SensorReader:
    """Reads the samples of one sensor, the ``index``-th, from the messages of its topic."""

    def __init__(self, measurement: Measurement, index: int, type_name: str) -> None:
        """A sensor on a topic with messages of the type ``type_name``.

        Raises:
            UsageError: by file and key, where a joint is wanted of other messages.
        """
        self.measurement, self.index = measurement, index
        self._delay = from_seconds(measurement.delay)
        if measurement.joint and type_name != interfaces.JOINT_STATE:
            problem = f"{measurement.topic} is {type_name}, which has no joints"
            expected = f"expected {interfaces.JOINT_STATE}, or field"
            raise measurement.wrong("joint", f"{problem}; {expected}")

    def sample(self, message: AnyMessage, received: int) -> SensorSample | None:
        """The sample in a message that was received at the time ``received``, ns.

        Returns:
            None if the message has no value of the joint: joints may share a topic.

        Raises:
            UsageError: by file and key: the message has no such field, or the field holds no
                single number, or the message has no stamp in a header.
        """
        given = self.measurement
        stamp = None if given.stamp == "receive" else header_stamp(message)
        if stamp is None:
            if given.stamp == "header":
                problem = f"header found, but a message of {given.topic} has no stamp in one"
                raise given.wrong("stamp", f"{problem}; expected receive")
            stamp = received
        if not given.joint:
            value = number_in(message, given)
        else:
            places = dict(zip(message.name, getattr(message, given.quantity), strict=False))
            if given.joint not in places:
                return None
            value = float(places[given.joint])
        return SensorSample(self.index, stamp - self._delay, value)


def number_in(message: AnyMessage, measurement: Measurement) -> float:
    """The number in the field of a sensor.

    Raises:
        UsageError: by file and key: the message has no such field, or other than one number in it.
    """
    try:
        values = numbers_at(message, measurement.path())
    except ValueError as error:
        raise measurement.wrong("field", f"{measurement.topic}: {error}") from None
    if len(values) != 1:
        problem = f"{measurement.field} found, {len(values)} numbers; name one of them"
        raise measurement.wrong("field", problem)
    return values[0]


def joint_topics(reader: BagReader, declared: Sequence[Measurement]) -> list[str]:
    """The topics of joints in a bag that may be of encoders: no states, and not ``declared``."""
    taken = {interfaces.absolute(each.topic) for each in declared}
    return [
        topic
        for topic, info in sorted(reader.topics.items())
        if info.type == interfaces.JOINT_STATE
        and topic not in taken
        and not any(each.fits(topic) for each in interfaces.INTERFACES)
    ]


class RecordedSamples(NamedTuple):
    """The samples of sensors in a bag by stamp, a line for each problem, and their topics.

    Verdicts are published on the samples of the sensors with the names ``published``.
    """

    samples: Sequence[SensorSample] = ()
    problems: Sequence[str] = ()
    topics: Sequence[str] = ()
    published: frozenset[str] = frozenset()


NO_SENSORS = RecordedSamples()


def samples_in(reader: BagReader, measurements: Sequence[Measurement]) -> RecordedSamples:
    """The samples of all sensors in a bag; a topic that is missing is a problem.

    Raises:
        UsageError: by file and key, where a field or a joint is not there; or no sensor is.
        BagError: the bag is damaged.
    """
    samples, problems, published = list[SensorSample](), list[str](), set[str]()
    by_topic: dict[str, list[SensorReader]] = {}
    for i, declared in enumerate(measurements):
        if (topic := interfaces.absolute(declared.topic)) in reader.topics:
            own = SensorReader(declared, i, reader.topics[topic].type)
            by_topic.setdefault(topic, []).append(own)
            continue
        found = (
            f"no {declared.topic} in {reader.path}; it has {', '.join(reader.topics) or 'none'}"
        )
        problems.append(str(declared.wrong("topic", found)))
    if measurements and not by_topic:
        raise UsageError(problems[0])
    for topic, readers in by_topic.items():
        messages = [*reader.messages(topic)]
        for each in readers:
            name = each.measurement.name
            kept, lost = _read(each, topic, messages)
            for why, count in (+lost).items():
                part = part_left_out(count, len(messages), f"messages on {topic}", why)
                problems.append(f"{name}: {part}")
            samples += kept
            if _rate([sample.stamp for sample in kept]) <= SILENT_RATE:
                published.add(name)
    samples.sort(key=lambda sample: (sample.stamp, sample.sensor))
    return RecordedSamples(samples, problems, [*by_topic], frozenset(published))


def _rate(stamps: Collection[int]) -> float:
    """The mean rate of samples, Hz; 0 for a single sample."""
    span = max(stamps, default=0) - min(stamps, default=0)
    return (len(stamps) - 1) * NS_PER_S / span if span else 0.0


def _read(
    each: SensorReader, topic: str, messages: Sequence[tuple[int, AnyMessage]]
) -> tuple[list[SensorSample], Counter[str]]:
    """The samples of a sensor in messages by time of recording, and why others are of no use.

    Samples whose delay from stamp to reception is not within a minute of the median are left out.
    """
    made, lost, given = list[tuple[int, SensorSample]](), Counter[str](), each.measurement
    for received, message in messages:
        sample = None
        try:
            sample = each.sample(message, received)
        except UsageError as error:
            if "[" not in (given.field or ""):  # else an array may be too short
                raise
            lost[str(error)] += 1
        if sample is not None:
            made.append((received - sample.stamp, sample))
    if messages and not made and given.joint:
        problem = f"no {given.quantity} of {given.joint!r} on {topic}"
        first = f"joints in its first message: {', '.join(messages[0][1].name) or 'none'}"
        remedy = f"{given.quantity} says which coordinate the joint measures"
        raise given.wrong("joint", f"{problem}; {first}; {remedy}")
    usual = statistics.median(delay for delay, _ in made) if made else 0
    most = _MOST_DELAY * NS_PER_S
    kept = [sample for delay, sample in made if abs(delay - usual) <= most]
    lost["stamped far from all others"] = len(made) - len(kept)
    lost["no finite number"] = sum(not abs(s.value) <= LARGEST_STATE for s in kept)
    return kept, lost
