"""A bag's summary as text: one line a fact, and a table of topics."""

import sys
from collections.abc import Iterator, Mapping
from typing import Literal, cast

from rich.console import Console
from rich.filesize import decimal
from rich.table import Table

from impact_observer.check.bag_summary import BagSummary, TopicSummary
from impact_observer.check.findings import times
from impact_observer.stamps import text

_WIDTH = 140
"""Columns where there is no terminal."""


def print_summary(summary: BagSummary) -> None:
    """Print a summary as text."""
    width = None if sys.stdout.isatty() else _WIDTH
    console = Console(highlight=False, markup=False, emoji=False, width=width)
    facts = Table.grid(padding=(0, 2))
    facts.add_column(no_wrap=True)
    facts.add_column(overflow="fold")
    for fact in _facts(summary):
        facts.add_row(*fact)
    console.print(facts)
    topics = Table(box=None, padding=(0, 2, 0, 0), header_style="bold")
    for header in ("topic", "type", "count", "Hz", "quality"):
        side: Literal["left", "right"] = "right" if header in ("count", "Hz") else "left"
        topics.add_column(header, justify=side, overflow="fold")
    for topic in summary.topics:
        rate = "" if topic.rate is None else f"{topic.rate:.4g}"
        short = topic.type.replace("/msg/", "/")
        topics.add_row(topic.name, short, str(topic.count), rate, _quality(topic))
    console.print()
    console.print(topics)


def _facts(summary: BagSummary) -> Iterator[tuple[str, str]]:
    """Name and value of each fact on the bag as a whole."""
    yield "bag", f"{summary.path} ({summary.storage}, {decimal(summary.size)})"
    if summary.chunks:
        yield "chunks", _chunks(summary.chunks)
    if summary.messages:
        yield "time", f"{text(summary.start)} to {text(summary.end)} s"
    yield "duration", f"{summary.duration:.6g} s, {times(summary.messages, 'message')}"
    if summary.model:
        yield "model", _origin(summary.model)
        if isinstance(faults := summary.model.get("sensor"), Mapping):
            yield "sensor", ", ".join(f"{name} {value}" for name, value in faults.items())
    if summary.episodes:
        lasting = {name: f" ({n} of them lasting)" for name, n in summary.closings.items()}
        each = ", ".join(f"{n} at {c}{lasting.get(c, '')}" for c, n in summary.impacts.items())
        yield "impacts", f"{each or 'none'}; episodes: {summary.episodes}"
    for prefix, law in summary.observers.items():
        yield "observer", f"{prefix}: {law or 'law not recorded'}"


def _chunks(chunks: Mapping[str, object]) -> str:
    stored, plain = (decimal(cast("int", chunks[key])) for key in ("compressed", "uncompressed"))
    if chunks["compression"] == "none":
        return f"{chunks['count']}, not compressed, {plain}"
    return f"{chunks['count']}, {chunks['compression']}, {plain} in {stored}"


def _origin(model: Mapping[str, object]) -> str:
    """A model's name, and what made the bag."""
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
