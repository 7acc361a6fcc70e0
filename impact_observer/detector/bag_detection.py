# SPDX-License-Identifier: Apache-2.0
"""Runs the detector on a bag of sensor messages, and writes a bag with events."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from impact_observer import __version__
from impact_observer.detector import Detection, Detector, SensorCounts, Source
from impact_observer.detector.sensors import MAX_DELAY, SignalTrace
from impact_observer.errors import BagError, UnfitBagError, UsageError
from impact_observer.io import interfaces
from impact_observer.io.bag_part import BagPart, TimeZero, read_part, sensor_zero
from impact_observer.io.live_inputs import first_pulse
from impact_observer.io.messages import bag_messages
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import all_or_nothing, carried_topics, model_of
from impact_observer.io.writer import BagWriter
from impact_observer.model import Model
from impact_observer.stamps import text

_OWN = (interfaces.IMPACTS.topic, interfaces.PLANT_MODEL.topic)


@dataclass(slots=True)
class BagDetection:
    """The result of detection on a bag or a signal.

    Attributes:
        sources: the sensors that are in the bag, complete.
        counts: of each one.
        traces: signals of the sources, if they were to be kept.
        problems: topics without a message or not copied, a line each.
        part: the part that was read; None for all.
        doubts: what was left out, and an epoch that lacks, a line each.
        rows: number of rows of a signal; 0 of a bag.
        seconds: from the first row to the last one, s.
        zero: the time zero of the traces, as of a part; None without them.
    """

    sources: list[Source]
    counts: list[SensorCounts]
    traces: list[SignalTrace]
    problems: list[str]
    part: BagPart | None
    doubts: list[str] = field(default_factory=list)
    rows: int = 0
    seconds: float = 0.0
    zero: TimeZero | None = None

    @property
    def events(self) -> int:
        """How many events were written."""
        return sum(each.impacts + each.closings + each.openings for each in self.counts)


@contextmanager
def detecting(
    path: Path,
    detector: Detector,
    output: Path,
    problems: list[str],
    *,
    part: BagPart | None,
    model: Model | None,
) -> Iterator[tuple[BagWriter, BagDetection]]:
    """A writer of a new bag of the impacts in ``path``, and the result, which ends complete.

    Raises:
        BagError: no impact was found. Then no bag is left.
    """
    result = BagDetection(detector.sources, detector.counts, detector.traces, problems, part)
    with all_or_nothing(output) as writer:
        yield writer, result
        if model is not None and model.subject.depends_on_time and not detector.epoch:
            result.doubts.append(
                f"no epoch, and the forcing of {model.subject.name} depends on time: an observer"
                " needs it; give --epoch in the time of the stamps (the first event has"
                f" {text(detector.first_event)}), or record the pulses of the drive on"
                f" {interfaces.PHASE_REFERENCE.topic}"
            )
        for k, source in enumerate(detector.sources):
            result.doubts += detector.left_out(k)
            if why := detector.no_impact(k):
                problems.append(f"{source.contact}: {why}")
        if not any(counts.impacts for counts in detector.counts):
            raise BagError(f"{path}: no impact found; {'; '.join(problems + result.doubts)}")


def detect_bag(
    reader: BagReader,
    sources: Sequence[Source],
    output: Path,
    *,
    model: Model | None = None,
    epoch: int = 0,
    pulses: str | None = None,
    start: float | None = None,
    duration: float | None = None,
    traced: bool = False,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> BagDetection:
    """Write a bag with the impacts detected in another one; all other topics are copied.

    The log time of an event is the time of its decision. Memory is constant. Where a part is read
    that has a past, the events are numbered from 2, so that an observer takes the state at the
    first of them for unknown, and does not think that nothing has happened since the epoch.

    Args:
        reader: the bag to read.
        sources: the sensors, as declared.
        output: the bag to make.
        model: the model of the new bag; None for the model of the bag that is read, if any.
        epoch: stamp of the forcing's ``t = 0``, ns. With 0 the first pulse of a drive is the
            epoch; without a pulse the epoch is unknown.
        pulses: topic of the index pulses of a drive; they are copied to ``phase_reference`` too.
            None for ``phase_reference`` itself.
        start: of the part that is read, s after the epoch, or without one after the first message
            of the sensors; None for the beginning of the bag.
        duration: of the part, s; None for all.
        traced: whether to keep the signals, for a picture.
        progress: called with the messages read and how many there are.

    Raises:
        UsageError: a source or the pulses do not fit the bag or the model, or something is at
            ``output``.
        BagError: no impact was found, or a bag cannot be read or written. Then no bag is left.
    """
    types = {topic: info.type for topic, info in reader.topics.items()}
    declared, problems = present(reader.path, types, sources)
    known = model
    if model is not None or reader.model_text() is not None:
        known = model or model_of(reader)
        check_contacts(known, declared)
    topics = [*dict.fromkeys(source.topic for source in declared)]
    pulses = None if pulses is None else _checked_pulses(reader, pulses)
    epoch = epoch or first_pulse(reader, pulses)
    zero = partial(sensor_zero, topics=topics, epoch=epoch)
    received = [source.topic for source in declared if source.stamp == "receive"]
    part = read_part(reader, start, duration, topics, zero=zero, received=received)
    joins_late = part is not None and part.is_late
    detector = Detector(declared, epoch=epoch, traced=traced, joins_late=joins_late)
    made = detecting(reader.path, detector, output, problems, part=part, model=known)
    with made as (writer, result):
        result.zero = zero(reader) if traced else None
        copied = _declared(reader, writer, model, problems)
        if pulses is not None:
            writer.declare(interfaces.PHASE_REFERENCE.topic)
        _run(reader, writer, detector, copied=copied, pulses=pulses, progress=progress)
    return result


def present(
    path: Path, types: Mapping[str, str], sources: Sequence[Source]
) -> tuple[list[Source], list[str]]:
    """Returns the complete sources whose topic is present, and a line for each other source.

    The ``types`` are those of the messages by topic, in the bag or signal at ``path``.

    Raises:
        UsageError: a source does not fit its topic.
        BagError: no topic of a source is present.
    """
    complete, missing = [], []
    for source in sources:
        topic = interfaces.absolute(source.topic)
        if topic in types:
            complete.append(replace(source, topic=topic).complete(types[topic]))
        else:
            missing.append(f"{source.contact}: no topic {topic}")
    if not complete:
        raise UnfitBagError(
            f"{path}: {'; '.join(missing)}; topics in it: {', '.join(types) or 'none'}"
        )
    return complete, missing


def _checked_pulses(reader: BagReader, topic: str) -> str | None:
    """The absolute name of the topic of a drive's pulses; None for ``phase_reference`` itself.

    Raises:
        UsageError: the bag has no such topic, or a type that is none of pulses, or has pulses on
            ``phase_reference`` too.
    """
    name, own = interfaces.absolute(topic), interfaces.PHASE_REFERENCE
    if name not in reader.topics:
        raise UsageError(f"pulses: no topic {name}; topics in it: {', '.join(reader.topics)}")
    if (found := reader.topics[name].type) != own.type:
        raise UsageError(f"pulses: {name} has {found}; expected {own.type}")
    if name == own.topic:
        return None
    if own.topic in reader.topics:
        raise UsageError(f"pulses: {name} given, but there is {own.topic}, too; leave one out")
    return name


def check_contacts(model: Model, sources: Sequence[Source]) -> None:
    """Check the contacts of the sensors against a model.

    Raises:
        UsageError: the model has no contact of a sensor's name.
    """
    names = model.subject.contact_names
    for source in sources:
        if source.contact not in names:
            raise source.wrong(
                "contact",
                f"{source.contact!r} is none of the model {model.subject.name}; expected one of"
                f" {', '.join(names) or 'none'}",
            )


def write_model(writer: BagWriter, model: Model, stamp: int) -> None:
    """Put a model into a bag, at its first log time (ns)."""
    text = model.text({"package": "impact_observer", "version": __version__})
    writer.write(interfaces.PLANT_MODEL.topic, stamp, bag_messages().model(text))


def write_events(writer: BagWriter, detections: Sequence[Detection]) -> None:
    """Write the events that a detector has decided."""
    for decided, event in detections:
        writer.write(interfaces.IMPACTS.topic, decided, bag_messages().event(event))


def _declared(
    reader: BagReader, writer: BagWriter, model: Model | None, problems: list[str]
) -> set[str]:
    """Declare the topics of the new bag and write the model; returns the topics to copy."""
    own = _OWN if model is not None else _OWN[:1]
    if (before := reader.topics.get(interfaces.IMPACTS.topic)) is not None:
        what = f"{before.count} messages on {before.name}"
        problems.append(f"{what} are left out for the impacts found")
    copied, left_out = carried_topics(reader, writer, own)
    problems += left_out
    writer.declare(interfaces.IMPACTS.topic)
    if model is not None:
        write_model(writer, model, reader.start)
    return {*copied}


def _run(
    reader: BagReader,
    writer: BagWriter,
    detector: Detector,
    *,
    copied: set[str],
    pulses: str | None,
    progress: Callable[[int, int], None],
) -> None:
    """Feed the detector with every message of the bag, and write the new bag."""
    topics = {source.topic for source in detector.sources}
    decoders = {topic: reader.decoder(topic) for topic in topics}
    indices = {
        topic: [k for k, s in enumerate(detector.sources) if s.topic == topic] for topic in topics
    }
    for done, raw in enumerate(reader.raw()):
        write_events(writer, detector.advance(raw.log_time))
        if raw.topic in copied:
            writer.write_raw(*raw)
        if raw.topic == pulses:
            writer.write_raw(*raw._replace(topic=interfaces.PHASE_REFERENCE.topic))
        if raw.topic in topics:
            message = decoders[raw.topic](raw.data)
            for index in indices[raw.topic]:
                write_events(writer, detector.feed(index, message, raw.log_time))
        progress(done, reader.message_count)
    # No message can be missing any more after the longest delay.
    write_events(writer, detector.advance(reader.end + MAX_DELAY))
