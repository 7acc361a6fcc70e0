# SPDX-License-Identifier: Apache-2.0
"""Recovery of a damaged bag: reads the messages before the damage, and makes a new bag of them.

MCAP files are read from their beginning, without index, footer or ``metadata.yaml``. A chunk whose
checksum does not match is left out, and so is a message without an end. sqlite3 files are read as
far as sqlite3 reads them.
"""

import re
import shutil
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeAlias, final

import zstandard
from rosbags.rosbag2 import ReaderError
from rosbags.rosbag2.metadata import parse_qos

from impact_observer.check.mcap_records import McapFile, McapMessage
from impact_observer.errors import BagError, ImpactObserverError, UnfitBagError, UsageError
from impact_observer.input_files import open_input
from impact_observer.io.bag_topics import TopicInfo, recover_command
from impact_observer.io.decompression import decompressed_message
from impact_observer.io.foreign_files import ROS_2, foreign_file, foreign_messages
from impact_observer.io.interfaces import Quality, absolute, usual_quality
from impact_observer.io.reader import BagReader, RawMessage
from impact_observer.io.recordings import all_or_nothing
from impact_observer.stamps import text

_STORAGE = re.compile(r".*\.(mcap|db3)(\.zstd)?")
_ZSTD = b"\x28\xb5\x2f\xfd"
"""First bytes of compressed data; no serialized message begins with them."""
_LATEST = 2**63
Progress: TypeAlias = Callable[[int, int], None]
"""Called with the bytes read and the number of all bytes."""
_Read: TypeAlias = Iterator[tuple[int, RawMessage]]
"""Messages, each with the bytes read so far."""


@final
class Salvage:
    """A bag that may be damaged, to be read once from beginning to end.

    Attributes:
        path: the folder or file.
        files: the storage files, in order.
        topics: the topics found so far, by absolute name, without counts.
        counts: messages of each topic so far.
        last: log time of the last message of each topic so far, ns.
        losses: one line for each unreadable part.
    """

    def __init__(self, path: Path) -> None:
        """Prepare to read the bag at ``path``.

        Raises:
            UsageError: ``path`` does not exist.
            BagError: ``path`` has no message of ROS 2.
        """
        if not path.exists():
            raise UsageError(f"{path}: does not exist; expected a bag's folder or file")
        if (foreign := foreign_file(path) or foreign_messages(path)) is not None:
            raise UnfitBagError(f"{path}: {foreign}")
        self.path = path
        self.topics: dict[str, TopicInfo] = {}
        self.counts: Counter[str] = Counter()
        self.last: dict[str, int] = {}
        self.losses: list[str] = []
        inside = path.iterdir() if path.is_dir() else [path]
        files = [each for each in inside if _STORAGE.fullmatch(each.name) and each.is_file()]
        self.files = sorted(files, key=_file_order)

    def raw(self, progress: Progress = lambda _done, _total: None) -> Iterator[RawMessage]:
        """The messages in the order of the files."""
        total, done = sum(file.stat().st_size for file in self.files), 0
        for file in self.files:
            try:
                for read, stored in self._file(file):
                    progress(min(done + read, total), total)
                    if (message := self._decompressed(stored)) is not None:
                        self.counts[message.topic] += 1
                        self.last[message.topic] = message.log_time
                        yield message
            except OSError as error:
                self._lose(f"{file.name}: {error.strerror or error}")
            done += file.stat().st_size

    def _file(self, file: Path) -> _Read:
        """The messages of a file; a compressed file is decompressed first."""
        with TemporaryDirectory() as folder:
            plain = file
            if file.suffix == ".zstd":
                plain = Path(folder) / file.stem
                with open_input(file) as source, plain.open("wb") as target:
                    try:
                        with zstandard.ZstdDecompressor().stream_reader(source) as stream:
                            shutil.copyfileobj(stream, target)
                    except (zstandard.ZstdError, EOFError) as error:
                        self._lose(f"{file.name}: its compression is damaged ({error})")
            read = self._mcap if plain.suffix == ".mcap" else self._sqlite
            yield from read(file, plain)

    def _decompressed(self, raw: RawMessage) -> RawMessage | None:
        """A message, decompressed if necessary; None if the message is broken."""
        if raw.data[:4] != _ZSTD:
            return raw
        try:
            data = decompressed_message(raw.data)
        except ReaderError:
            self._lose(f"{raw.topic}: messages whose compression is damaged or too large")
            return None
        return RawMessage(raw.topic, raw.log_time, data)

    def _mcap(self, file: Path, plain: Path) -> _Read:
        with open_input(plain) as stream:
            records = McapFile(stream)
            for each in records.messages():
                if self._has_topic(each):
                    _, channel, message = each
                    topic = absolute(channel.topic)
                    yield records.at, RawMessage(topic, message.log_time, message.data)
        self.losses += [f"{file.name}: {loss}" for loss in records.losses]

    def _has_topic(self, stored: McapMessage) -> bool:
        """Note the topic of a message; False if the bag cannot have such a message."""
        schema, channel, message = stored
        topic = absolute(channel.topic)
        if not 0 <= message.log_time < _LATEST:
            self._lose(f"{topic}: messages with a log time that no bag can have")
            return False
        if channel.message_encoding != ROS_2:
            self._lose(f"{topic}: {channel.message_encoding} messages, which are not of ROS 2")
            return False
        if (info := self.topics.get(topic)) is None:
            quality = _quality(topic, channel.metadata.get("offered_qos_profiles", ""))
            definition = schema.data.decode(errors="replace")
            self.topics[topic] = TopicInfo(topic, schema.name, 0, quality, definition)
        elif info.type != schema.name:
            self._lose(f"{topic}: messages of a second type, {schema.name}")
            return False
        return True

    def _sqlite(self, file: Path, plain: Path) -> _Read:
        try:
            with BagReader(plain) as reader:
                for topic, info in reader.topics.items():
                    self.topics.setdefault(topic, replace(info, count=0))
                for done, raw in enumerate(reader.raw(lose=self._lose)):
                    yield plain.stat().st_size * done // reader.message_count, raw
        except BagError:
            compressed = f"`zstd -d {file}`, then " if file != plain else ""
            command = recover_command(file.with_suffix("") if compressed else file)
            self._lose(
                f"{file.name}: damaged as an sqlite3 file; {compressed}`{command}` writes what is"
                " left to a new file"
            )

    def _lose(self, line: str) -> None:
        """Note a loss, once."""
        if line not in self.losses:
            self.losses.append(line)


def salvage(
    source: Salvage, output: Path, *, progress: Progress = lambda _done, _total: None
) -> list[str]:
    """Write a new bag of the readable messages of a damaged bag.

    Args:
        source: not read yet.
        output: the bag to make.
        progress: called with the bytes read and the number of all bytes.

    Returns:
        A line for each omission.

    Raises:
        UsageError: something is at ``output`` already, or its parent is no folder.
        BagError: nothing can be read, or the new bag cannot be written. Then no bag is left.
    """
    left_out: dict[str, str] = {}
    declared: set[str] = set()
    with all_or_nothing(output) as writer:
        for raw in source.raw(progress):
            if raw.topic not in declared and raw.topic not in left_out:
                info = source.topics[raw.topic]
                try:
                    writer.declare(
                        raw.topic,
                        type_name=info.type,
                        quality=info.quality,
                        definition=info.definition,
                    )
                    declared.add(raw.topic)
                except ImpactObserverError as error:
                    left_out[raw.topic] = f"{raw.topic} is left out: {error}"
            if raw.topic in declared:
                writer.write_raw(*raw)
        if not writer.message_count:
            raise BagError(f"{source.path}: nothing can be read; {summary(source)}")
    return [*source.losses, *left_out.values()]


def summary(source: Salvage) -> str:
    """Number of recovered messages and time of the last, in words."""
    if not source.files:
        return "there is no .mcap or .db3 file"
    if not source.counts:
        return "; ".join(source.losses) or "there is no message"
    return f"{source.counts.total()} messages, up to {text(max(source.last.values()))} s"


def _quality(topic: str, profiles: str) -> Quality | None:
    """The quality of service of a topic; None if the quality is missing or damaged."""
    try:
        offers = list(parse_qos(profiles))
    except Exception:  # noqa: BLE001 (rosbags raises anything; a bag is readable without them)
        return None
    depth = usual_quality(topic).depth
    qualities = [Quality.recorded(qos, depth) for qos in offers]
    return Quality.common(qualities) if qualities else None


def _file_order(file: Path) -> list[int | str]:
    """Sorting key of a file of a bag: ``bag_10`` comes after ``bag_9``."""
    return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", file.name)]
