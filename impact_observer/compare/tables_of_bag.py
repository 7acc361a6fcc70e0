"""What a bag says, as a table: states, errors or events, streamed block by block."""

import csv
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from impact_observer.compare.bag_comparison import RecordedEstimate
from impact_observer.compare.comparison import Comparing
from impact_observer.compare.tally import ErrorRows
from impact_observer.errors import BagError, UsageError
from impact_observer.io import interfaces
from impact_observer.io.reader import BLOCK, BagReader
from impact_observer.io.recordings import epoch_of, events_in, outcomes_in
from impact_observer.io.topic_names import first_block, first_stamp, named_states, states_of
from impact_observer.model import System
from impact_observer.stamps import text
from impact_observer.states import Stamps

Numbers: TypeAlias = NDArray[np.float64] | NDArray[np.int64]
Told: TypeAlias = Callable[[int, int], None]
"""Told the messages read and how many there are."""
SUFFIXES = (".csv", ".parquet")


def _silent(_done: int, _all: int) -> None:
    """Tell nobody."""


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Rows of a table.

    Attributes:
        epoch: stamp of ``t = 0``, ns.
        stamps: ns, shape (rows,).
        texts: columns of words; one word for all rows, or one a row.
        numbers: columns of numbers, shape (rows,).
    """

    epoch: int
    stamps: Stamps
    texts: Mapping[str, str | Sequence[str]]
    numbers: Mapping[str, Numbers] = field(default_factory=dict)

    def words(self, name: str) -> Sequence[str]:
        """A column of words, one a row."""
        column = self.texts[name]
        return [column] * self.stamps.size if isinstance(column, str) else column


class Sink(Protocol):
    """Where rows go; every block has the same columns."""

    def write(self, block: Block) -> None:
        """Add rows."""

    def close(self) -> None:
        """Finish the file."""


class CsvSink:
    """A CSV file; numbers are written so that they are read back bit by bit."""

    def __init__(self, path: Path) -> None:
        """Make the file.

        Raises:
            OSError: it cannot be made.
        """
        self._file = path.open("w", encoding="utf-8", newline="")
        self._writer = csv.writer(self._file, lineterminator="\n")
        self._begun = False

    def write(self, block: Block) -> None:
        """Add rows, below a header."""
        if not self._begun:
            self._writer.writerow([*block.texts, "stamp_ns", "time_s", *block.numbers])
            self._begun = True
        stamps = block.stamps.tolist()
        self._writer.writerows(
            zip(
                *(block.words(name) for name in block.texts),
                stamps,
                (text(stamp - block.epoch) for stamp in stamps),
                *(column.tolist() for column in block.numbers.values()),
                strict=True,
            )
        )

    def close(self) -> None:
        """Finish the file."""
        self._file.close()


@contextmanager
def finished(path: Path, make: Callable[[Path], Sink]) -> Iterator[Sink]:
    """A file that is at ``path`` only when all has come into it; one that was there is replaced.

    Raises:
        UsageError: it cannot be made.
        BagError: the disk is full or gone.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise UsageError(f"{path}: expected a file's name that ends with {' or '.join(SUFFIXES)}")
    part = path.with_name(f".{path.name}.part")
    try:
        sink = make(part)
    except OSError as error:
        raise UsageError(f"{path}: cannot be made: {error.strerror or error}") from None
    try:
        yield sink
        sink.close()
        part.replace(path)
    except OSError as error:
        raise BagError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        with suppress(OSError):
            sink.close()
        with suppress(OSError):
            part.unlink()


def export_states(
    reader: BagReader,
    sink: Sink,
    topics: Collection[str] | None = None,
    *,
    epoch: int | None = None,
    progress: Told = _silent,
) -> Counter[str]:
    """Write the states of the truth and of each estimate, in the order of the bag.

    Args:
        reader: the bag.
        sink: where to.
        topics: topics of states, or observers' prefixes; None for the truth and all observers.
        epoch: stamp of ``t = 0``, ns; None for that of the events, else the first stamp.
        progress: told how far it is.

    Returns:
        Rows of each topic.

    Raises:
        UsageError: a topic is not in the bag.
        BagError: there are no states, topics have different coordinates, or the bag is damaged.
    """
    chosen = _state_topics(reader, topics)
    first = first_block(reader, chosen)
    if first is None:
        raise BagError(f"{reader.path}: has no states; topics: {', '.join(reader.topics)}")
    zero = _epoch(reader, int(first.stamps[0])) if epoch is None else epoch
    rows: Counter[str] = Counter()
    total = sum(reader.topics[topic].count for topic in chosen)
    for topic, block in reader.blocks(chosen, first.names):
        if block.stamps.size:
            numbers = _columns(("q", "u"), block.names, np.hstack([block.q, block.u]))
            sink.write(Block(zero, block.stamps, {"topic": topic}, numbers))
            rows[topic] += block.stamps.size
            progress(rows.total(), total)
    return rows


def export_errors(
    reader: BagReader,
    sink: Sink,
    system: System,
    topics: Collection[str] | None = None,
    *,
    epoch: int | None = None,
    progress: Told = _silent,
) -> Counter[str]:
    """Write what estimates differ from the truth, and V, at the stamps that both have.

    Left out is what ``compare`` leaves out: estimates that had not heard of their events, and
    samples between the jumps of truth and estimate.

    Args:
        reader: the bag.
        sink: where to.
        system: gives M and K for V, and the coordinates.
        topics: of estimates, or observers' prefixes; None for all observers.
        epoch: stamp of ``t = 0``, ns; None for that of the events, else the first stamp.
        progress: told how far it is.

    Returns:
        Rows of each topic.

    Raises:
        UsageError: a topic is not in the bag.
        BagError: there is no truth, no estimate, or nothing in common between them.
    """
    truth = reader.truth_topic()
    if truth is None:
        raise BagError(f"{reader.path}: has no truth ({interfaces.PLANT_JOINT_STATES.topic})")
    chosen = [topic for topic in _state_topics(reader, topics) if topic != truth]
    if not chosen:
        raise BagError(f"{reader.path}: has no estimates; make them with observe")
    zero = _epoch(reader, first_stamp(reader, [truth]) or 0) if epoch is None else epoch
    events = events_in(reader) if reader.find(interfaces.IMPACTS) else []
    fresh: dict[str, list[ErrorRows]] = {topic: [] for topic in chosen}
    recorded = [
        RecordedEstimate(
            topic,
            Comparing(system, outcomes_in(reader, topic, events), keep=fresh[topic].append),
            law=topic.split("/")[-2],
        )
        for topic in chosen
    ]
    rows: Counter[str] = Counter()
    done, total = 0, sum(reader.topics[topic].count for topic in (truth, *chosen))

    def write() -> None:
        for each in recorded:
            for found in fresh[each.topic]:
                numbers = {"V": found.V, **_columns(("dq", "du"), system.coordinates, found.error)}
                texts = {"topic": each.topic, "law": each.law}
                sink.write(Block(zero, found.stamps, texts, numbers))
                rows[each.topic] += found.stamps.size
            fresh[each.topic].clear()

    for topic, block in reader.blocks([truth, *chosen], system.coordinates):
        for each in recorded:
            each.add(topic, block, truth)
            each.comparing.proceed()
        write()
        done += block.stamps.size
        progress(done, total)
    for each in recorded:
        each.comparing.finish()
    write()
    if not rows:
        ranges = recorded[0].comparing.pairing.ranges()
        raise BagError(f"{reader.path}: truth and estimates have nothing in common: {ranges}")
    return rows


def export_events(
    reader: BagReader,
    sink: Sink,
    *,
    epoch: int | None = None,
    progress: Told = _silent,
) -> Counter[str]:
    """Write the events, a row for each contact that switches; ``import`` reads them again.

    Args:
        reader: the bag.
        sink: where to.
        epoch: stamp of ``t = 0``, ns; None for that of the events, else the first stamp.
        progress: told how far it is.

    Returns:
        Rows of the topic.

    Raises:
        BagError: there are no events, or the bag is damaged.
    """
    events = events_in(reader)
    if not events:
        raise BagError(f"{reader.path}: has no events to export")
    zero = _epoch(reader, events[0].stamp) if epoch is None else epoch
    flat = [(event, switch) for event in events for switch in event.switches]
    for begin in range(0, len(flat), BLOCK):
        part = flat[begin : begin + BLOCK]
        texts = {
            "contact": [switch.contact for _, switch in part],
            "kind": [switch.kind.name.lower() for _, switch in part],
        }
        numbers = {
            "sequence": np.array([event.sequence for event, _ in part], dtype=np.int64),
            "episode": np.array([event.episode for event, _ in part], dtype=np.int64),
        }
        stamps = np.array([event.stamp for event, _ in part], dtype=np.int64)
        sink.write(Block(zero, stamps, texts, numbers))
        progress(begin + len(part), len(flat))
    return Counter({reader.find(interfaces.IMPACTS) or "": len(flat)})


def _columns(
    kinds: tuple[str, str], names: Sequence[str], x: NDArray[np.float64]
) -> dict[str, Numbers]:
    """Columns of coordinates and velocities, such as ``q_x1`` and ``u_x1``."""
    heads = [f"{kind}_{name}" for kind in kinds for name in names]
    return dict(zip(heads, x.T, strict=True))


def _state_topics(reader: BagReader, named: Collection[str] | None) -> list[str]:
    """Topics of states: those named, else the truth and those of every observer."""
    if named is None:
        truth = reader.truth_topic()
        return [
            *([truth] if truth else []),
            *(states_of(reader, prefix) for prefix in reader.observers()),
        ]
    return [*dict.fromkeys(named_states(reader, name) for name in named)]


def _epoch(reader: BagReader, otherwise: int) -> int:
    """The stamp of ``t = 0`` that the events say, ns."""
    topic = reader.find(interfaces.IMPACTS)
    return epoch_of(() if topic is None else reader.events(topic)) or otherwise
