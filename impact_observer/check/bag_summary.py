# SPDX-License-Identifier: Apache-2.0
"""Contents of a bag: topics, impacts, model, observers."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rich.filesize import decimal

from impact_observer.draw.reports import TextTable, counted, print_facts, print_table
from impact_observer.errors import BagError, ModelError
from impact_observer.events import ImpactEvent, Kind
from impact_observer.io.reader import BagReader
from impact_observer.model import parse_model
from impact_observer.observer.event_order import impacts_of
from impact_observer.plain_text import say
from impact_observer.stamps import seconds_between, text


def summary_of(reader: BagReader, events: Sequence[ImpactEvent]) -> dict[str, Any]:
    """The contents of a bag, as ``--json`` prints them.

    Stamps are in ns, ``duration`` is in s and the ``rate`` of a topic in Hz. A closing counts as
    an impact, and an impact that a closing replaces does not count.
    """
    kinds = [(contact, kind) for _, contact, kind in impacts_of(events)]
    length = seconds_between(reader.start, reader.end)
    return {
        "path": str(reader.path),
        "storage": reader.storage,
        "size": reader.size,
        "start": reader.start,
        "end": reader.end,
        "duration": length,
        "messages": reader.message_count,
        "topics": [
            {
                "name": topic.name,
                "type": topic.type,
                "count": topic.count,
                "rate": (topic.count - 1) / length if length > 0 and topic.count > 1 else None,
                "reliable": topic.quality.reliable if topic.quality else None,
                "transient_local": topic.quality.transient_local if topic.quality else None,
                "depth": topic.quality.depth if topic.quality else None,
            }
            for topic in reader.topics.values()
        ],
        "impacts": dict(sorted(Counter(contact for contact, _ in kinds).items())),
        "closings": dict(sorted(Counter(c for c, kind in kinds if kind is Kind.CLOSE).items())),
        "episodes": len({event.episode for event in events}),
        "model": _model(reader),
        "observers": {prefix: _law(reader, prefix) for prefix in reader.observers()},
    }


def _model(reader: BagReader) -> dict[str, object] | None:
    """Name and origin of the model in the bag, or an error if the model cannot be read."""
    try:
        if (source := reader.model_text()) is None:
            return None
        model = parse_model(source, "model")
    except (BagError, ModelError) as error:
        return {"error": str(error)}
    known, drawn = model.provenance, "true_parameters"
    keys = ("version", "seed", "sensor", *([drawn] if drawn in known else []))
    return {"name": model.subject.name} | {key: known.get(key) for key in keys}


def _law(reader: BagReader, prefix: str) -> str:
    """The law in an observer's first state; empty without a state."""
    if (topic := f"{prefix}/state") not in reader.topics:
        return ""
    _, message = next(reader.messages(topic), (0, None))
    return "" if message is None else message.law


def print_summary(summary: Mapping[str, Any]) -> None:
    """Print one line for each fact, and a table of topics."""
    print_facts(_facts(summary))
    say("")
    rows = [
        (
            topic["name"],
            topic["type"].replace("/msg/", "/"),
            str(topic["count"]),
            "" if topic["rate"] is None else f"{topic['rate']:.4g}",
            _quality(topic),
        )
        for topic in summary["topics"]
    ]
    headings = ("topic", "type", "count", "Hz", "quality")
    print_table(TextTable(headings, rows, words=("type", "quality")))


def _facts(summary: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Name and value of each fact on the bag as a whole."""
    yield "bag", f"{summary['path']} ({summary['storage']}, {decimal(summary['size'])})"
    if summary["messages"]:
        yield "time", f"{text(summary['start'])} to {text(summary['end'])} s"
    yield "duration", f"{summary['duration']:.6g} s, {counted(summary['messages'], 'message')}"
    if model := summary["model"]:
        yield "model", _origin(model)
        if isinstance(faults := model.get("sensor"), Mapping):
            yield "sensor", ", ".join(f"{name} {value}" for name, value in faults.items())
        if isinstance(drawn := model.get("true_parameters"), Mapping):
            yield "drawn", ", ".join(f"{name} {value:.6g}" for name, value in drawn.items())
    if summary["episodes"]:
        persistent = {
            name: f" ({n} of them persistent)" for name, n in summary["closings"].items()
        }
        each = ", ".join(
            f"{n} at {c}{persistent.get(c, '')}" for c, n in summary["impacts"].items()
        )
        yield "impacts", f"{each or 'none'}; episodes: {summary['episodes']}"
    for prefix, law in summary["observers"].items():
        yield "observer", f"{prefix}: {law or 'law not recorded'}"


def _origin(model: Mapping[str, object]) -> str:
    """Name, version and seed of the model in a bag."""
    if "error" in model:
        return f"cannot be read: {model['error']}"
    origin = [f"{key} {model[key]}" for key in ("version", "seed") if model[key] is not None]
    return ", ".join([str(model["name"]), *origin])


def _quality(topic: Mapping[str, Any]) -> str:
    """A topic's quality of service in words."""
    if topic["depth"] is None:
        return "not recorded"
    reliable = "reliable" if topic["reliable"] else "best effort"
    durable = "transient local" if topic["transient_local"] else "volatile"
    kept = f"last {topic['depth']}" if topic["depth"] else "all"
    return f"{reliable}, {durable}, {kept}"
