"""What can still be read of a bag that is damaged, and a new bag of it.

Files are read from their beginning, without index, footer or ``metadata.yaml``. What cannot be
told to be right is left out: a chunk whose checksum does not match, a message that has no end.
"""

import re
import shutil
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeAlias, final

import zstandard
from rosbags.interfaces import Qos
from rosbags.rosbag2.metadata import parse_qos

from impact_observer.check.mcap_records import Channel, McapFile, Message
from impact_observer.check.sqlite_pages import Pages, Row
from impact_observer.errors import BagError, ImpactObserverError, UsageError
from impact_observer.io.interfaces import Quality, usual_quality
from impact_observer.io.reader import RawMessage, TopicInfo
from impact_observer.io.recordings import all_or_nothing
from impact_observer.stamps import text

_SUFFIXES = (".mcap", ".db3")
_COMPRESSED = ".zstd"
_ZSTD = b"\x28\xb5\x2f\xfd"
"""How compressed data begins; no serialized message does."""
_LATEST = 2**63
Told: TypeAlias = Callable[[int, int], None]
"""Told the bytes read and how many there are."""


@final
class Salvage:
    """A bag that may be damaged, to be read once from beginning to end.

    Attributes:
        path: the folder or file.
        topics: what has been met so far, by absolute name, without counts.
        counts: messages of each topic so far.
        last: log time of the last message of each topic so far, ns.
        losses: what could not be read, a line each.
    """

    def __init__(self, path: Path) -> None:
        """Prepare to read the bag at ``path``.

        Raises:
            UsageError: there is nothing at ``path``.
        """
        if not path.exists():
            raise UsageError(f"{path}: does not exist; expected a bag's folder or file")
        self.path = path
        self.topics: dict[str, TopicInfo] = {}
        self.counts: Counter[str] = Counter()
        self.last: dict[str, int] = {}
        self.losses: list[str] = []
        inside = [*path.iterdir()] if path.is_dir() else [path]
        self.files = sorted((each for each in inside if _is_storage(each)), key=_natural)

    def raw(self, progress: Told = lambda _done, _all: None) -> Iterator[RawMessage]:
        """The messages in the order of the files."""
        whole, before = sum(file.stat().st_size for file in self.files), 0
        for file in self.files:
            done = before

            def told(at: int, done: int = done) -> None:
                progress(min(done + at, whole), whole)

            try:
                yield from self._file(file, told)
            except OSError as error:
                self._lose(f"{file.name}: {error.strerror or error}")
            before += file.stat().st_size

    def _file(self, file: Path, told: Callable[[int], None]) -> Iterator[RawMessage]:
        """The messages of one file, decompressed first where it is compressed as a whole."""
        with ExitStack() as stack:
            opened = file
            if file.suffix == _COMPRESSED:
                folder = Path(stack.enter_context(TemporaryDirectory()))
                opened = folder / file.stem
                self._decompress(file, opened)
            read = self._mcap if opened.suffix == ".mcap" else self._sqlite
            yield from read(opened, told)

    def _decompress(self, file: Path, target: Path) -> None:
        """As much of ``file`` as can be decompressed."""
        with file.open("rb") as source, target.open("wb") as plain:
            try:
                with zstandard.ZstdDecompressor().stream_reader(source) as stream:
                    shutil.copyfileobj(stream, plain)
            except (zstandard.ZstdError, EOFError) as error:
                self.losses.append(f"{file.name}: its compression is damaged ({error})")

    def _mcap(self, file: Path, told: Callable[[int], None]) -> Iterator[RawMessage]:
        """The messages of an MCAP file, in the order of its chunks."""
        with file.open("rb") as stream:
            records = McapFile(stream)
            for item in records.messages():
                told(records.at)
                if (topic := self._channel(item)) is not None:
                    yield from self._told(topic, item.log_time, item.data)
        self.losses += [f"{file.name}: {loss}" for loss in records.losses]

    def _channel(self, message: Message) -> str | None:
        """The topic of a message; None where it cannot be one of this bag."""
        if not 0 <= message.log_time < _LATEST:
            return None
        channel = message.channel
        info = self.topics.get(channel.topic)
        if info is None:
            definition = channel.definition
            self._know(channel.topic, channel.type, _qualities(channel), definition)
        elif info.type != channel.type:
            self._lose(f"{channel.topic}: messages of a second type, {channel.type}")
            return None
        return channel.topic

    def _sqlite(self, file: Path, told: Callable[[int], None]) -> Iterator[RawMessage]:
        """The messages of a database, topics being known before any of them."""
        with file.open("rb") as stream:
            try:
                pages = Pages(stream)
            except ValueError:
                self._lose(f"{file.name}: does not begin as an sqlite3 file")
                return
            known = self._declarations(pages)
            pages.lost = read = highest = 0
            for row in pages.rows():
                told(stream.tell())
                message = _message(row)
                if message is None or message[0] not in known:
                    continue
                read, highest = read + 1, max(highest, row.number)
                yield from self._told(known[message[0]], *message[1:])
            if (missing := pages.promised - pages.count) > 0:
                self._lose(f"{file.name}: was cut short, {missing} of {pages.promised} pages")
            # A recorder only adds rows, so their numbers have no gaps.
            if (missing := max(highest - read, pages.lost)) > 0:
                self._lose(f"{file.name}: {missing} messages before the last one are broken")

    def _declarations(self, pages: Pages) -> dict[int, str]:
        """The topics of a database by their number."""
        topics: dict[int, str] = {}
        found: list[tuple[str, str, str]] = []
        definitions: dict[str, str] = {}
        for number, values in pages.rows():
            match values:
                case (None, str(name), str(kind), "cdr", *more) if name.startswith("/"):
                    topics[number] = name
                    found.append((name, kind, str(more[0]) if more else ""))
                case (None, str(kind), "ros2msg" | "ros2idl", str(definition), _):
                    definitions[kind] = definition
        for name, kind, profiles in found:
            self._know(name, kind, _parsed(profiles), definitions.get(kind, ""))
        return topics

    def _know(self, topic: str, kind: str, offers: list[Qos], definition: str) -> None:
        """Note a topic, unless it is known from an earlier file."""
        depth = usual_quality(topic).depth
        quality = (
            Quality.common(Quality.recorded(qos, depth) for qos in offers) if offers else None
        )
        self.topics.setdefault(topic, TopicInfo(topic, kind, 0, quality, definition))

    def _told(self, topic: str, log_time: int, data: bytes) -> Iterator[RawMessage]:
        """A message, counted, decompressed where each one was compressed; none if it is broken."""
        if data[:4] == _ZSTD:
            try:
                data = zstandard.ZstdDecompressor().decompressobj().decompress(data)
            except zstandard.ZstdError:
                self._lose(f"{topic}: messages whose compression is damaged")
                return
        self.counts[topic] += 1
        self.last[topic] = log_time
        yield RawMessage(topic, log_time, data)

    def _lose(self, line: str) -> None:
        """Note a loss, once."""
        if line not in self.losses:
            self.losses.append(line)


def salvage(
    source: Salvage, output: Path, *, progress: Told = lambda _done, _all: None
) -> list[str]:
    """Write a new bag of what can be read of a damaged one.

    Args:
        source: not read yet.
        output: the bag to make.
        progress: told the bytes read and how many there are.

    Returns:
        What was left out, a line each.

    Raises:
        UsageError: something is at ``output`` already, or its parent is no folder.
        BagError: nothing can be read, or the new bag cannot be written. Then no bag is left.
    """
    left_out: dict[str, str] = {}
    with all_or_nothing(output) as writer:
        declared: set[str] = set()
        for raw in source.raw(progress):
            if raw.topic in left_out:
                continue
            if raw.topic not in declared:
                info = source.topics[raw.topic]
                try:
                    writer.declare(
                        raw.topic,
                        type_name=info.type,
                        quality=info.quality,
                        definition=info.definition,
                    )
                except ImpactObserverError as error:
                    left_out[raw.topic] = f"{raw.topic} is left out: {error}"
                    continue
                declared.add(raw.topic)
            writer.write_raw(*raw)
        if not writer.message_count:
            raise BagError(f"{source.path}: nothing can be read; {summary(source)}")
    return [*source.losses, *left_out.values()]


def summary(source: Salvage) -> str:
    """How much was read, and until when, in words."""
    if not source.files:
        return "there is no .mcap or .db3 file"
    if not source.counts:
        return "; ".join(source.losses) or "there is no message"
    return f"{source.counts.total()} messages, up to {text(max(source.last.values()))} s"


def _message(row: Row) -> tuple[int, int, bytes] | None:
    """Topic's number, log time and data, if a row is a message."""
    match row.values:
        case (None, int(topic), int(log_time), bytes(data)) if 0 <= log_time < _LATEST:
            return topic, log_time, data
    return None


def _qualities(channel: Channel) -> list[Qos]:
    return _parsed(channel.metadata.get("offered_qos_profiles", ""))


def _parsed(profiles: str) -> list[Qos]:
    """Qualities of service; none where they are damaged."""
    try:
        return list(parse_qos(profiles))
    except Exception:  # noqa: BLE001 (whatever rosbags trips over: a bag can do without them)
        return []


def _is_storage(file: Path) -> bool:
    """Whether a file is one of a bag, compressed or not."""
    inner = Path(file.stem) if file.suffix == _COMPRESSED else file
    return inner.suffix in _SUFFIXES and file.is_file()


def _natural(file: Path) -> list[int | str]:
    """For sorting: ``bag_10`` comes after ``bag_9``."""
    return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", file.name)]
