"""A recording of sensors, made into one with impacts: the detector run on a bag."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from impact_observer import __version__
from impact_observer.detector import Detection, Detector, SensorCounts, Source
from impact_observer.detector.sensors import PATIENCE
from impact_observer.errors import BagError, ImpactObserverError
from impact_observer.io import interfaces
from impact_observer.io.messages import bag_messages
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import all_or_nothing, model_of
from impact_observer.io.writer import BagWriter
from impact_observer.model import Model

_OWN = (interfaces.IMPACTS.topic, interfaces.PLANT_MODEL.topic)


@dataclass(slots=True)
class Detected:
    """What a detector has made of a bag.

    Attributes:
        sources: the sensors that the bag has, complete.
        tallies: what became of each one's messages.
        events: how many events were written.
        trouble: what was not found or not carried along, a line each.
    """

    sources: list[Source]
    tallies: list[SensorCounts]
    events: int = 0
    trouble: list[str] = field(default_factory=list)


def detect_bag(
    reader: BagReader,
    sources: Sequence[Source],
    output: Path,
    *,
    model: Model | None = None,
    epoch: int = 0,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> Detected:
    """Write a bag with the impacts that sensors have recorded; all else is carried along.

    An event's log time is when it was known. Messages are streamed, so memory is constant.

    Args:
        reader: the bag to read.
        sources: the sensors, as declared.
        output: the bag to make.
        model: to put into it; None for the one that the bag carries, if it does.
        epoch: stamp of the forcing's ``t = 0``, ns; 0 for unknown.
        progress: told the messages read and how many there are.

    Raises:
        UsageError: a source does not fit the bag or the model, or something is at ``output``.
        BagError: no impact was found, or a bag cannot be read or written. Then no bag is left.
    """
    found, missing = _present(reader, sources)
    _check_contacts(reader, model, found)
    detector = Detector(found, epoch=epoch)
    result = Detected(detector.sources, detector.tallies, trouble=missing)
    with all_or_nothing(output) as writer:
        carried = _declared(reader, writer, model, result.trouble)
        _run(reader, writer, detector, carried=carried, progress=progress)
        result.events = sum(t.hits + t.lasting + t.openings for t in detector.tallies)
        short = [line for k in range(len(found)) if (line := detector.shortfall(k))]
        result.trouble += short
        if not any(tally.hits for tally in detector.tallies):
            raise BagError(f"{reader.path}: no impact found; {'; '.join(result.trouble)}")
    return result


def _present(reader: BagReader, sources: Sequence[Source]) -> tuple[list[Source], list[str]]:
    """The sources whose topic is in the bag, complete; and a line for each other one."""
    found, missing = [], []
    for source in sources:
        topic = f"/{source.topic.lstrip('/')}"
        info = reader.topics.get(topic)
        if info is None:
            missing.append(f"{source.contact}: no topic {topic}")
        else:
            found.append(replace(source, topic=topic).complete(info.type))
    if not found:
        raise BagError(
            f"{reader.path}: {'; '.join(missing)}; topics in the bag:"
            f" {', '.join(reader.topics) or 'none'}"
        )
    return found, missing


def _check_contacts(reader: BagReader, model: Model | None, sources: Sequence[Source]) -> None:
    """Raise where a sensor's contact is none of the model's, if one is known.

    Raises:
        UsageError: naming the contact and those of the model.
    """
    if model is None:
        if reader.model_text() is None:
            return
        model = model_of(reader)
    names = model.system.contact_names
    for source in sources:
        if source.contact not in names:
            raise source.wrong(
                "contact",
                f"{source.contact!r} is none of the model {model.system.name}; expected one of"
                f" {', '.join(names) or 'none'}",
            )


def _declared(
    reader: BagReader, writer: BagWriter, model: Model | None, trouble: list[str]
) -> set[str]:
    """Declare what goes into the new bag, and write the model; the topics to be carried along."""
    own = _OWN if model is not None else _OWN[:1]
    if interfaces.IMPACTS.topic in reader.topics:
        trouble.append(f"{interfaces.IMPACTS.topic} of the bag is left out for the one found")
    carried = set()
    for topic, info in reader.topics.items():
        if topic in own:
            continue
        try:
            writer.declare(
                topic, type_name=info.type, quality=info.quality, definition=info.definition
            )
            carried.add(topic)
        except ImpactObserverError as error:
            trouble.append(f"{topic} is not carried along: {error}")
    writer.declare(interfaces.IMPACTS.topic)
    if model is not None:
        text = model.text({"package": "impact_observer", "version": __version__})
        message = bag_messages().model(text)
        writer.write(interfaces.PLANT_MODEL.topic, reader.start, message)
    return carried


def _run(
    reader: BagReader,
    writer: BagWriter,
    detector: Detector,
    *,
    carried: set[str],
    progress: Callable[[int, int], None],
) -> None:
    """Every message of the bag through the detector, and into the new bag."""
    make = bag_messages()
    topics = {source.topic for source in detector.sources}
    decoders = {topic: reader.decoder(topic) for topic in topics}
    indices = {
        topic: [k for k, s in enumerate(detector.sources) if s.topic == topic] for topic in topics
    }

    def write(detections: list[Detection]) -> None:
        for at, event in detections:
            writer.write(interfaces.IMPACTS.topic, at, make.event(event))

    for done, raw in enumerate(reader.raw()):
        write(detector.advance(raw.log_time))
        if raw.topic in carried:
            writer.write_raw(*raw)
        if raw.topic in topics:
            message = decoders[raw.topic](raw.data)
            for index in indices[raw.topic]:
                write(detector.hear(index, message, raw.log_time))
        progress(done, reader.message_count)
    # After the end nothing more can come that was on its way.
    write(detector.advance(reader.end + PATIENCE))
