"""What a bag holds: topics, impacts, model, observers."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from shlex import quote

from impact_observer.errors import BagError, ModelError
from impact_observer.events import ImpactEvent, Kind
from impact_observer.io.interfaces import IMPACT_EVENT
from impact_observer.io.mcap_layout import summary_of
from impact_observer.io.reader import BagReader
from impact_observer.model import parse_model
from impact_observer.observer.event_order import impacts_of
from impact_observer.stamps import seconds_between

_WINDOW = 20_000
"""Events that are sorted together: all of any bag but a very long one."""


@dataclass(frozen=True, slots=True)
class TopicSummary:
    """A topic of a bag.

    Attributes:
        name: the absolute name.
        type: the message type.
        count: messages.
        rate: mean rate over the whole bag, Hz; None where there are fewer than two messages.
        reliable: whether a lost message was sent again; None when the bag does not say.
        transient_local: whether late subscribers received earlier messages; None as above.
        depth: messages kept for them, 0 for all; None as above.
    """

    name: str
    type: str
    count: int
    rate: float | None
    reliable: bool | None
    transient_local: bool | None
    depth: int | None


@dataclass(frozen=True, slots=True)
class BagSummary:
    """What a bag holds.

    Attributes:
        path: the folder or file.
        storage: ``mcap`` or ``sqlite3``.
        size: bytes on disk.
        chunks: of MCAP files with an index, their number, kind of compression and bytes,
            compressed and not; else None.
        start: log time of the first message, ns; 0 when there is none.
        end: log time of the last message, ns; 0 when there is none.
        duration: from the first message to the last, s.
        messages: messages on all topics.
        topics: the topics, by name.
        impacts: impacts of each contact, by its name; a closing is one, what it supersedes none.
        closings: how often each contact stayed closed, by its name.
        episodes: runs of the sender between resets.
        model: name, and version, seed, integrator and sensor faults that made the bag; None
            when the bag has no model.
        observers: the law of each observer, by its prefix; empty when it published no state.
    """

    path: str
    storage: str
    size: int
    chunks: dict[str, object] | None
    start: int
    end: int
    duration: float
    messages: int
    topics: list[TopicSummary]
    impacts: dict[str, int]
    closings: dict[str, int]
    episodes: int
    model: dict[str, object] | None
    observers: dict[str, str]


def summarize(bag: Path) -> BagSummary:
    """What a bag holds.

    Raises:
        UsageError: there is no bag.
        BagError: the bag is damaged, or one of our topics has an invalid message.
    """
    try:
        with BagReader(bag) as reader:
            return _summary(reader)
    except BagError as error:
        if "`" in str(error):  # it names a command that helps
            raise
        command = f"impact-observer check {quote(str(bag))}"
        raise BagError(f"{error}; `{command}` says what can be read") from error


def _summary(reader: BagReader) -> BagSummary:
    impacts, closings, episodes = _impacts(reader)
    return BagSummary(
        path=str(reader.path),
        storage=reader.storage,
        size=reader.size,
        chunks=_chunks(reader.path),
        start=reader.start,
        end=reader.end,
        duration=seconds_between(reader.start, reader.end),
        messages=reader.message_count,
        topics=_topics(reader),
        impacts=impacts,
        closings=closings,
        episodes=episodes,
        model=_model(reader),
        observers={prefix: _law(reader, prefix) for prefix in reader.observers()},
    )


def _topics(reader: BagReader) -> list[TopicSummary]:
    """The topics by the bag's index: no message is read."""
    length = seconds_between(reader.start, reader.end)
    return [
        TopicSummary(
            name=topic.name,
            type=topic.type,
            count=topic.count,
            rate=(topic.count - 1) / length if length > 0 and topic.count > 1 else None,
            reliable=topic.quality.reliable if topic.quality else None,
            transient_local=topic.quality.transient_local if topic.quality else None,
            depth=topic.quality.depth if topic.quality else None,
        )
        for topic in reader.topics.values()
    ]


def _chunks(bag: Path) -> dict[str, object] | None:
    """The chunks of all MCAP files, by their indexes; None without any."""
    chunks = []
    for file in sorted(bag.glob("*.mcap")) if bag.is_dir() else [bag]:
        if file.suffix == ".mcap":
            with file.open("rb") as stream:
                index = summary_of(stream)
            chunks += index.chunk_indexes if index is not None else []
    if not chunks:
        return None
    return {
        "count": len(chunks),
        "compression": " and ".join(sorted({each.compression or "none" for each in chunks})),
        "compressed": sum(each.compressed_size for each in chunks),
        "uncompressed": sum(each.uncompressed_size for each in chunks),
    }


def _impacts(reader: BagReader) -> tuple[dict[str, int], dict[str, int], int]:
    """Impacts and closings of each contact, and the number of episodes, over all topics."""
    counts: Counter[str] = Counter()
    closings: Counter[str] = Counter()
    episodes: set[tuple[str, int]] = set()

    def events(topic: str) -> Iterator[ImpactEvent]:
        for event in reader.events(topic):
            episodes.add((topic, event.episode))
            yield event

    for topic in reader.topics.values():
        if topic.type == IMPACT_EVENT:
            for contact, kind in _impacts_in_order(events(topic.name)):
                counts[contact] += 1
                closings[contact] += kind is Kind.CLOSE
    return dict(sorted(counts.items())), dict(sorted((+closings).items())), len(episodes)


def _impacts_in_order(events: Iterable[ImpactEvent]) -> Iterator[tuple[str, Kind]]:
    """Contacts and kinds of the impacts and closings that count, in constant memory.

    ``_WINDOW`` events are sorted at a time; those of one stamp stay together.
    """

    def key(event: ImpactEvent) -> tuple[int, int, int]:
        return event.epoch, event.episode, event.stamp

    waiting: list[ImpactEvent] = []
    for event in events:
        waiting.append(event)
        if len(waiting) >= 2 * _WINDOW:
            waiting.sort(key=key)
            cut = _WINDOW
            while cut < len(waiting) and key(waiting[cut]) == key(waiting[cut - 1]):
                cut += 1
            yield from (impact[1:] for impact in impacts_of(waiting[:cut]))
            del waiting[:cut]
    yield from (impact[1:] for impact in impacts_of(waiting))


def _model(reader: BagReader) -> dict[str, object] | None:
    """Name and origin of the model in the bag; or why it cannot be read."""
    try:
        if (text := reader.model_text()) is None:
            return None
        model = parse_model(text, "model")
    except (BagError, ModelError) as error:
        return {"error": str(error)}
    keys = ("version", "seed", "integrator", "sensor")
    version, seed, integrator, sensor = (model.provenance.get(key) for key in keys)
    return {
        "name": model.system.name,
        "version": None if version is None else str(version),
        "seed": seed if isinstance(seed, int) else None,
        "integrator": None if integrator is None else str(integrator),
        "sensor": {str(k): v if isinstance(v, int | float) else str(v) for k, v in sensor.items()}
        if isinstance(sensor, Mapping)
        else None,
    }


def _law(reader: BagReader, prefix: str) -> str:
    """The law in an observer's first state; empty when it published none."""
    if (topic := f"{prefix}/state") not in reader.topics:
        return ""
    _, message = next(reader.messages(topic), (0, None))
    return "" if message is None else message.law
