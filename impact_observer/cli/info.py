"""Say what a bag holds: topics, impacts, model, observers."""

import argparse
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Literal, cast

if TYPE_CHECKING:
    from impact_observer.events import ImpactEvent, Kind
    from impact_observer.io import BagReader

_WIDTH = 140
"""Columns where there is no terminal."""
_WINDOW = 20_000
"""Events that are put in order together: those of any bag but a very long one."""


@dataclass(frozen=True, slots=True)
class TopicSummary:
    """A topic of a bag.

    Attributes:
        name: the absolute name.
        type: the message type.
        count: messages.
        rate: mean rate over the whole bag, Hz; None where there are fewer than two messages.
        reliable: whether a lost message was sent again; None when the bag does not say.
        transient_local: whether late subscribers received earlier messages; None likewise.
        depth: messages kept for them, 0 for all; None likewise.
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
        model: name, and version, seed, integrator and sensor's troubles that made the bag; None
            when not carried.
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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    parser.add_argument("bag", metavar="BAG", type=Path, help="a bag's folder, or a bare file")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")


def run(args: argparse.Namespace) -> int:
    """Run the subcommand."""
    return info(args.bag, json=args.json)


def info(bag: Path, *, json: bool = False) -> int:
    """Print what a bag holds.

    Args:
        bag: the bag.
        json: whether to print JSON instead of text.

    Returns:
        0.

    Raises:
        UsageError: there is no bag.
        BagError: the bag is damaged.
    """
    summary = summarize(bag)
    if json:
        from json import dumps

        print(dumps(asdict(summary), indent=2))
    else:
        _print(summary)
    return 0


def summarize(bag: Path) -> BagSummary:
    """What a bag holds.

    Raises:
        UsageError: there is no bag.
        BagError: the bag is damaged, or one of our topics has an invalid message.
    """
    from impact_observer.errors import BagError

    try:
        return _summarized(bag)
    except BagError as error:
        if "impact-observer check" in str(error):
            raise
        command = f"impact-observer check {quote(str(bag))}"
        raise BagError(f"{error}; `{command}` tells what can be read") from error


def _summarized(bag: Path) -> BagSummary:
    """The same, where errors do not say yet what to do."""
    from impact_observer.io import BagReader
    from impact_observer.stamps import seconds_between

    with BagReader(bag) as reader:
        impacts, closings, episodes = _impacts(reader)
        return BagSummary(
            path=str(bag),
            storage=reader.storage,
            size=reader.size,
            chunks=_chunks(bag),
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


def _topics(reader: "BagReader") -> list[TopicSummary]:
    """The topics of a bag, as its index tells: no message is read."""
    from impact_observer.stamps import seconds_between

    length = seconds_between(reader.start, reader.end)
    summaries = []
    for topic in reader.topics.values():
        quality = topic.quality
        summaries.append(
            TopicSummary(
                name=topic.name,
                type=topic.type,
                count=topic.count,
                rate=(topic.count - 1) / length if length > 0 and topic.count > 1 else None,
                reliable=quality.reliable if quality else None,
                transient_local=quality.transient_local if quality else None,
                depth=quality.depth if quality else None,
            )
        )
    return summaries


def _chunks(bag: Path) -> dict[str, object] | None:
    """What the indices of MCAP files say of their chunks, all files together."""
    from impact_observer.check.mcap_records import facts

    files = sorted(bag.glob("*.mcap")) if bag.is_dir() else [bag]
    found = []
    for file in files:
        if file.suffix == ".mcap":
            with file.open("rb") as stream:
                found.append(facts(stream))
    known = [each for each in found if each is not None]
    if not known:
        return None
    return {
        "count": sum(each.chunks for each in known),
        "compression": " and ".join(sorted({each.compression for each in known})),
        "compressed": sum(each.compressed for each in known),
        "uncompressed": sum(each.uncompressed for each in known),
    }


def _impacts(reader: "BagReader") -> tuple[dict[str, int], dict[str, int], int]:
    """Impacts and closings of each contact, and the number of episodes, over all topics."""
    from impact_observer.events import Kind
    from impact_observer.io.interfaces import IMPACT_EVENT

    counts: Counter[str] = Counter()
    closings: Counter[str] = Counter()
    episodes: set[tuple[str, int]] = set()

    def noted(name: str) -> "Iterator[ImpactEvent]":
        for event in reader.events(name):
            episodes.add((name, event.episode))
            yield event

    for topic in reader.topics.values():
        if topic.type == IMPACT_EVENT:
            for contact, kind in _hits(noted(topic.name)):
                counts[contact] += 1
                closings[contact] += kind is Kind.CLOSE
    return dict(sorted(counts.items())), dict(sorted((+closings).items())), len(episodes)


def _hits(events: "Iterable[ImpactEvent]") -> "Iterator[tuple[str, Kind]]":
    """Contacts and kinds of impacts and closings as they act, in constant memory.

    Events are put in order ``_WINDOW`` at a time; those of one stamp are never parted.
    """
    from impact_observer.observer.event_order import impacts_of

    def key(event: "ImpactEvent") -> tuple[int, int, int]:
        return event.epoch, event.episode, event.stamp

    waiting: list[ImpactEvent] = []
    for event in events:
        waiting.append(event)
        if len(waiting) >= 2 * _WINDOW:
            waiting.sort(key=key)
            cut = _WINDOW
            while cut < len(waiting) and key(waiting[cut]) == key(waiting[cut - 1]):
                cut += 1
            yield from (hit[1:] for hit in impacts_of(waiting[:cut]))
            del waiting[:cut]
    yield from (hit[1:] for hit in impacts_of(waiting))


def _model(reader: "BagReader") -> dict[str, object] | None:
    """Name and origin of the model that the bag carries; or why it cannot be read."""
    from impact_observer.errors import BagError, ModelError
    from impact_observer.model import parse_model

    try:
        if (text := reader.model_text()) is None:
            return None
        model = parse_model(text, "model")
    except (BagError, ModelError) as error:
        return {"error": str(error)}
    keys = ("version", "seed", "integrator", "sensor")
    version, seed, how, sensor = (model.provenance.get(key) for key in keys)
    return {
        "name": model.system.name,
        "version": None if version is None else str(version),
        "seed": seed if isinstance(seed, int) else None,
        "integrator": None if how is None else str(how),
        "sensor": {str(k): v if isinstance(v, int | float) else str(v) for k, v in sensor.items()}
        if isinstance(sensor, Mapping)
        else None,
    }


def _law(reader: "BagReader", prefix: str) -> str:
    """The law that an observer published with its first state; empty when it did not."""
    from impact_observer.io.messages import EstimateMessage

    if (topic := f"{prefix}/state") not in reader.topics:
        return ""
    _, message = next(reader.messages(topic), (0, None))
    return "" if message is None else cast("EstimateMessage", message).law


def _print(summary: BagSummary) -> None:
    """Print a summary as text."""
    from rich.console import Console
    from rich.table import Table

    from impact_observer.check.findings import times
    from impact_observer.stamps import text

    width = None if sys.stdout.isatty() else _WIDTH
    console = Console(highlight=False, markup=False, emoji=False, width=width)
    facts = Table.grid(padding=(0, 2))
    facts.add_column(no_wrap=True)
    facts.add_column(overflow="fold")
    facts.add_row("bag", f"{summary.path} ({summary.storage}, {_bytes(summary.size)})")
    if summary.chunks:
        facts.add_row("chunks", _packed(summary.chunks))
    if summary.messages:
        facts.add_row("time", f"{text(summary.start)} to {text(summary.end)} s")
    facts.add_row("duration", f"{summary.duration:.6g} s, {times(summary.messages, 'message')}")
    if summary.model:
        facts.add_row("model", _said(summary.model))
        if isinstance(troubles := summary.model.get("sensor"), Mapping):
            facts.add_row("sensor", ", ".join(f"{key} {troubles[key]}" for key in troubles))
    if summary.episodes:
        lasting = {name: f" ({n} of them lasting)" for name, n in summary.closings.items()}
        each = ", ".join(f"{n} at {c}{lasting.get(c, '')}" for c, n in summary.impacts.items())
        facts.add_row("impacts", f"{each or 'none'}; episodes: {summary.episodes}")
    for prefix, law in summary.observers.items():
        facts.add_row("observer", f"{prefix}: {law or 'law not recorded'}")
    console.print(facts)

    table = Table(box=None, padding=(0, 2, 0, 0), header_style="bold")
    for header in ("topic", "type", "count", "Hz", "quality"):
        side: Literal["left", "right"] = "right" if header in ("count", "Hz") else "left"
        table.add_column(header, justify=side, overflow="fold")
    for topic in summary.topics:
        rate = "" if topic.rate is None else f"{topic.rate:.4g}"
        short = topic.type.replace("/msg/", "/")
        table.add_row(topic.name, short, str(topic.count), rate, _quality(topic))
    console.print()
    console.print(table)


def _packed(chunks: Mapping[str, object]) -> str:
    """Chunks in words."""
    count, kind = chunks["count"], chunks["compression"]
    stored, whole = (_bytes(cast("int", chunks[key])) for key in ("compressed", "uncompressed"))
    size = whole if kind == "none" else f"{whole} in {stored}"
    kind = "not compressed" if kind == "none" else kind
    return f"{count}, {kind}, {size}"


def _said(model: Mapping[str, object]) -> str:
    """A model's origin in words."""
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


def _bytes(size: int) -> str:
    """A number of bytes with a decimal unit."""
    if size < 1000:
        return f"{size} B"
    value, unit = (size / 1e6, "MB") if size >= 1_000_000 else (size / 1e3, "kB")
    return f"{value:.1f} {unit}"
