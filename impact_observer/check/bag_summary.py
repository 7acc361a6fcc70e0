# SPDX-License-Identifier: Apache-2.0
"""Contents of a bag: topics, impacts, model, observers."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from rich.filesize import decimal

from impact_observer.draw.reports import TextTable, counted, print_facts, print_table
from impact_observer.errors import BagError, ModelError
from impact_observer.events import ImpactEvent, Kind
from impact_observer.io.interfaces import IMPACT_EVENT
from impact_observer.io.reader import BagReader
from impact_observer.model import parse_model
from impact_observer.observer.event_order import impacts_of
from impact_observer.plain_text import say
from impact_observer.stamps import seconds_between, text

WINDOW = 20_000
"""Events that are sorted together; only a very long bag has more events."""


@dataclass(frozen=True, slots=True)
class TopicSummary:
    """A topic of a bag.

    Attributes:
        name: the absolute name.
        type: the message type.
        count: messages.
        rate: mean rate over the whole bag, Hz; None for fewer than two messages.
        reliable: whether a lost message was sent again; None when the bag does not say.
        transient_local: whether late subscribers received earlier messages; None as above.
        depth: messages kept for late subscribers, 0 for all; None as above.
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
    """The contents of a bag.

    Attributes:
        path: the folder or file.
        storage: ``mcap`` or ``sqlite3``.
        size: bytes on disk.
        start: log time of the first message, ns; 0 when there is none.
        end: log time of the last message, ns; 0 when there is none.
        duration: from the first message to the last, s.
        messages: messages on all topics.
        topics: the topics, by name.
        impacts: number of impacts by contact; a closing counts as an impact, and an impact that
            a closing supersedes does not count.
        closings: number of persistent contacts by contact.
        episodes: runs of the sender between resets.
        model: name, and version, seed, integrator, sensor faults and drawn parameters that made
            the bag; None when the bag has no model.
        observers: the law of each observer, by its prefix; empty for an observer without a state.
    """

    path: str
    storage: str
    size: int
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
    """Summarize the contents of a bag.

    Raises:
        UsageError: ``bag`` does not exist.
        BagError: the bag is damaged, or one of our topics has an invalid message.
    """
    impacts: Counter[str] = Counter()
    closings: Counter[str] = Counter()
    episodes: set[tuple[str, int]] = set()

    def noted(events: Iterable[ImpactEvent], topic: str) -> Iterator[ImpactEvent]:
        for event in events:
            episodes.add((topic, event.episode))
            yield event

    with BagReader(bag) as reader:
        for topic in reader.topics.values():
            if topic.type == IMPACT_EVENT:
                events = noted(reader.events(topic.name), topic.name)
                for contact, kind in impacts_in_order(events):
                    impacts[contact] += 1
                    closings[contact] += kind is Kind.CLOSE
        return BagSummary(
            path=str(reader.path),
            storage=reader.storage,
            size=reader.size,
            start=reader.start,
            end=reader.end,
            duration=seconds_between(reader.start, reader.end),
            messages=reader.message_count,
            topics=_topics(reader),
            impacts=dict(sorted(impacts.items())),
            closings=dict(sorted((+closings).items())),
            episodes=len(episodes),
            model=_model(reader),
            observers={prefix: _law(reader, prefix) for prefix in reader.observers()},
        )


def impacts_in_order(events: Iterable[ImpactEvent]) -> Iterator[tuple[str, Kind]]:
    """Contacts and kinds of the impacts and closings that count, in constant memory.

    ``WINDOW`` events are sorted at a time; events of one stamp stay together.
    """

    def key(event: ImpactEvent) -> tuple[int, int, int]:
        return event.epoch, event.episode, event.stamp

    waiting: list[ImpactEvent] = []
    for event in events:
        waiting.append(event)
        if len(waiting) >= 2 * WINDOW:
            waiting.sort(key=key)
            cut = WINDOW
            while cut < len(waiting) and key(waiting[cut]) == key(waiting[cut - 1]):
                cut += 1
            yield from (impact[1:] for impact in impacts_of(waiting[:cut]))
            del waiting[:cut]
    yield from (impact[1:] for impact in impacts_of(waiting))


def _topics(reader: BagReader) -> list[TopicSummary]:
    """The topics of a bag by its index, without reading a message."""
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


def _model(reader: BagReader) -> dict[str, object] | None:
    """Name and origin of the model in the bag, or an error if the model cannot be read."""
    try:
        if (source := reader.model_text()) is None:
            return None
        model = parse_model(source, "model")
    except (BagError, ModelError) as error:
        return {"error": str(error)}
    known, drawn = model.provenance, "true_parameters"
    keys = ("version", "seed", "integrator", "sensor", *([drawn] if drawn in known else []))
    return {"name": model.subject.name} | {key: known.get(key) for key in keys}


def _law(reader: BagReader, prefix: str) -> str:
    """The law in an observer's first state; empty without a state."""
    if (topic := f"{prefix}/state") not in reader.topics:
        return ""
    _, message = next(reader.messages(topic), (0, None))
    return "" if message is None else message.law


def print_summary(summary: BagSummary) -> None:
    """Print one line for each fact, and a table of topics."""
    print_facts(_facts(summary))
    say("")
    headings = ("topic", "type", "count", "Hz", "quality")
    rows = [
        (
            topic.name,
            topic.type.replace("/msg/", "/"),
            str(topic.count),
            "" if topic.rate is None else f"{topic.rate:.4g}",
            _quality(topic),
        )
        for topic in summary.topics
    ]
    print_table(TextTable(headings, rows, words=("type", "quality")))


def _facts(summary: BagSummary) -> Iterator[tuple[str, str]]:
    """Name and value of each fact on the bag as a whole."""
    yield "bag", f"{summary.path} ({summary.storage}, {decimal(summary.size)})"
    if summary.messages:
        yield "time", f"{text(summary.start)} to {text(summary.end)} s"
    yield "duration", f"{summary.duration:.6g} s, {counted(summary.messages, 'message')}"
    if summary.model:
        yield "model", _origin(summary.model)
        if isinstance(faults := summary.model.get("sensor"), Mapping):
            yield "sensor", ", ".join(f"{name} {value}" for name, value in faults.items())
        if isinstance(drawn := summary.model.get("true_parameters"), Mapping):
            yield "drawn", ", ".join(f"{name} {value:.6g}" for name, value in drawn.items())
    if summary.episodes:
        persistent = {name: f" ({n} of them persistent)" for name, n in summary.closings.items()}
        each = ", ".join(f"{n} at {c}{persistent.get(c, '')}" for c, n in summary.impacts.items())
        yield "impacts", f"{each or 'none'}; episodes: {summary.episodes}"
    for prefix, law in summary.observers.items():
        yield "observer", f"{prefix}: {law or 'law not recorded'}"


def _origin(model: Mapping[str, object]) -> str:
    """Name, version, seed and integrator of the model in a bag."""
    if "error" in model:
        return f"cannot be read: {model['error']}"
    origin = [f"{key} {model[key]}" for key in ("version", "seed") if model[key] is not None]
    how = [str(model["integrator"])] if model["integrator"] is not None else []
    return ", ".join([str(model["name"]), *origin, *how])


def _quality(topic: TopicSummary) -> str:
    """A topic's quality of service in words."""
    if topic.depth is None:
        return "not recorded"
    reliable = "reliable" if topic.reliable else "best effort"
    durable = "transient local" if topic.transient_local else "volatile"
    return f"{reliable}, {durable}, {f'last {topic.depth}' if topic.depth else 'all'}"
