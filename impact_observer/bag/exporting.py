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

from impact_observer.analysis.comparison import SETTLED, heard_of
from impact_observer.analysis.mismatch import Impact
from impact_observer.analysis.pairing import Pairing, Series
from impact_observer.analysis.tally import Curve, Rows, Tally
from impact_observer.bag import interfaces
from impact_observer.bag.columns import JointStates, ObserverStates
from impact_observer.bag.naming import first_block, first_stamp, named_states, states_of
from impact_observer.bag.reader import BLOCK, BagReader
from impact_observer.bag.recordings import events_in
from impact_observer.errors import BagError, UsageError
from impact_observer.events import ImpactEvent
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
    differing = {topic: _Differing(reader, topic, system, events) for topic in chosen}
    rows: Counter[str] = Counter()
    done, total = 0, sum(reader.topics[topic].count for topic in (truth, *chosen))

    def write(*, last: bool = False) -> None:
        for topic, each in differing.items():
            for found in each.settled(last=last):
                numbers = {"V": found.V, **_columns(("dq", "du"), system.coordinates, found.error)}
                sink.write(Block(zero, found.stamps, {"topic": topic, "law": each.law}, numbers))
                rows[topic] += found.stamps.size

    for topic, block in reader.blocks([truth, *chosen], system.coordinates):
        for own, each in differing.items():
            each.add(block, is_truth=topic == truth, is_own=topic == own)
        write()
        done += block.stamps.size
        progress(done, total)
    write(last=True)
    if not rows:
        ranges = next(iter(differing.values())).pairing.ranges()
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


class _Sieve(Curve):
    """Takes the rows that a tally counts, and keeps them until they are asked for."""

    def __init__(self) -> None:
        super().__init__(0)
        self.fresh: list[Rows] = []

    def add(self, rows: Rows) -> None:
        """Keep rows."""
        self.fresh.append(rows)


class _Differing:
    """One estimate against the truth while both go by.

    Attributes:
        law: of the estimate; its observer's name where it does not say.
        pairing: takes the blocks of both.
    """

    def __init__(
        self, reader: BagReader, topic: str, system: System, events: Sequence[ImpactEvent]
    ) -> None:
        """Compare the estimates on ``topic``; ``events`` are all of the bag."""
        prefix = topic.rpartition("/")[0]
        self.law = prefix.rpartition("/")[2]
        self.pairing = Pairing()
        verdicts = f"{prefix}/verdicts"
        told = reader.verdicts(verdicts) if verdicts in reader.topics else None
        heard = heard_of(events, told)
        index = {name: c for c, name in enumerate(system.contact_names)}
        impacts = [Impact(stamp, index[name]) for stamp, name in heard.impacts if name in index]
        self._tally = Tally(system, heard.told, impacts, SETTLED)
        self._tally.curve = self._sieve = _Sieve()

    def add(self, block: JointStates, *, is_truth: bool, is_own: bool) -> None:
        """Add states of the truth or of the estimate."""
        if not (is_truth or is_own):
            return
        last_event = block.last_event if isinstance(block, ObserverStates) else None
        series = Series(block.stamps, np.hstack([block.q, block.u]), last_event)
        if is_truth:
            self.pairing.truth.add(series)
        else:
            self.pairing.estimates.add(series)
            self.law = getattr(block, "law", "") or self.law

    def settled(self, *, last: bool) -> list[Rows]:
        """The rows of which nothing more can come."""
        self._tally.add(self.pairing.settled(done=last), done=last)
        fresh, self._sieve.fresh = self._sieve.fresh, []
        return fresh


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
    events = () if topic is None else reader.events(topic)
    return next((event.epoch for event in events if event.epoch), otherwise)
