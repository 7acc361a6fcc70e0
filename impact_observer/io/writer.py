# SPDX-License-Identifier: Apache-2.0
"""Writing a bag: an MCAP directory that ``ros2 bag`` reads."""

import math
import os
import shutil
import threading
from collections import deque
from collections.abc import Callable, Collection
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar, final

from impact_observer.errors import BagError, UsageError
from impact_observer.io.bag_metadata import Topic, metadata, quality_text
from impact_observer.io.interfaces import Quality, interface, usual_quality
from impact_observer.io.mcap_output import Item, McapOutput
from impact_observer.io.reader import BagReader
from impact_observer.io.typestores import add_definition, new_typestore
from impact_observer.output_files import check_name, unwritable

_BATCH = 1024
_BATCH_BYTES = 2**20
"""Messages, or bytes of them, that are written together."""
_Result = TypeVar("_Result")
FLUSH = 0.5
"""Default of the longest time until a message is on the disk, s."""
LONGEST_FLUSH = 1.0
"""The longest that can be asked for, s."""


def bag_file(path: Path) -> str:
    """The name of the one MCAP file in the bag ``path``, as ``ros2 bag reindex`` wants it."""
    return f"{path.name}_0.mcap"


def check_free(path: Path) -> None:
    """Check that a bag can be made at ``path``.

    Raises:
        UsageError: something is there already, its parent is no folder, or the name is too long
            or no UTF-8.
    """
    check_name(path)
    try:
        path.lstat()
        raise UsageError(f"{path}: exists already; remove it or choose another name")
    except (FileNotFoundError, NotADirectoryError):
        _check_length(path)
    except OSError as error:
        raise unwritable(path, error) from None
    if not path.absolute().parent.is_dir():
        raise UsageError(f"{path}: no folder {path.parent}; make it first")


def _check_length(path: Path) -> None:
    """Raise UsageError if the name of the file in the bag ``path`` is too long."""
    try:
        path.with_name(bag_file(path)).lstat()
    except (FileNotFoundError, NotADirectoryError):
        pass
    except OSError as error:
        raise unwritable(path, error) from None


@final
class BagWriter:
    """A bag, open for writing; a context manager.

    However its block ends, the bag is closed and complete: a thread of its own writes the file,
    where no ``KeyboardInterrupt`` can cut a record short. If the process is killed or the machine
    loses power, the disk has every message that was written ``flush`` seconds before: a chunk of
    the file ends after at most that time, also if no further message comes.

    Attributes:
        path: the folder that is written.
        message_count: messages written so far.
    """

    def __init__(
        self, path: Path | str, *, compressed: bool = False, flush: float = FLUSH
    ) -> None:
        """Make the bag's folder at ``path``.

        Args:
            path: the folder.
            compressed: whether the chunks of the MCAP file are compressed, by zstd.
            flush: longest time until a message is on the disk, s, besides what the disk takes.

        Raises:
            UsageError: something is at ``path`` already, its parent is no folder, or ``flush`` is
                not in (0, ``LONGEST_FLUSH``]. Then nothing is created.
        """
        self.path = Path(path)
        check_free(self.path)
        if not (math.isfinite(flush) and 0 < flush <= LONGEST_FLUSH):
            raise UsageError(
                f"flush is {flush:g}; expected more than 0, at most {LONGEST_FLUSH:g} s"
            )
        self.message_count = 0
        self._store = new_typestore()
        self._topics: dict[str, Topic] = {}
        self._pending: deque[Item] = deque()
        self._pending_bytes = 0
        self._unflushed = False
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="bag")
        self._made = False
        self._closing = threading.Event()
        self._failure: OSError | None = None
        self._open = True
        try:
            self._file = self._run(lambda: self._make_file(compressed))
            threading.Thread(target=self._flush_every, args=(flush,), daemon=True).start()
        except BaseException:
            self._closing.set()
            self._thread.shutdown()
            if self._made:
                shutil.rmtree(self.path, ignore_errors=True)
            raise

    def __enter__(self) -> "BagWriter":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Write the pending messages, the index and the metadata; closing twice does no harm.

        Raises:
            BagError: the disk is full or gone.
        """
        if not self._open:
            return
        try:
            self._run(self._finish)
        except KeyboardInterrupt:  # a signal raises it once
            self._run(self._finish)
            raise
        finally:
            self._open = False
            self._thread.shutdown()

    def declare(
        self,
        topic: str,
        *,
        type_name: str | None = None,
        quality: Quality | None = None,
        definition: str = "",
    ) -> None:
        """Declare the type and quality of service of a topic; our own need not be declared.

        Args:
            topic: the absolute name.
            type_name: the message type; None for that of the interface table.
            quality: the quality of service offered; None for that of the interface table.
            definition: the text of a message type that ROS 2 Jazzy and we do not define.

        Raises:
            UsageError: the topic is in the bag already, or its type is unknown.
            BagError: the definition is not valid, or there is another one of the same type.
        """
        if topic in self._topics:
            raise UsageError(f"{self.path}: {topic} is declared twice; declare it once")
        known = interface(topic)
        if (type_name := type_name or (known.type if known else None)) is None:
            raise UsageError(f"{self.path}: {topic} is no topic of this package; name its type")
        if definition and add_definition(self._store, definition, type_name):
            raise BagError(
                f"{self.path}: {topic} brings another definition of {type_name}; "
                "a bag can hold one only"
            )
        if type_name not in self._store.fielddefs:
            raise UsageError(f"{self.path}: {topic} is {type_name}; give its definition too")
        offered = quality or usual_quality(topic)
        text, _ = self._store.generate_msgdef(type_name, ros_version=2)
        type_hash = self._store.hash_rihs01(type_name)
        about = {"offered_qos_profiles": quality_text(offered), "topic_type_hash": type_hash}
        channel = self._run(lambda: self._file.add_channel(topic, type_name, text, about))
        self._topics[topic] = Topic(channel, topic, type_name, type_hash, offered)

    def write(self, topic: str, log_time: int, message: object) -> None:
        """Write a message of :func:`~impact_observer.io.messages.bag_messages`.

        Args:
            topic: the absolute name; if it is one of ours, it need not be declared.
            log_time: when it is recorded, ns.
            message: a message of the topic's type.

        Raises:
            UsageError: the topic is not declared, or the message is of another type.
            BagError: the disk is full or gone.
        """
        self.write_raw(topic, log_time, self.serialized(topic, message))

    def serialized(self, topic: str, message: object) -> bytes:
        """The bytes of a message, as :meth:`write_raw` takes them.

        Raises:
            UsageError: as of :meth:`write`.
        """
        type_name = self._topic(topic).type
        if (given := getattr(message, "__msgtype__", type(message).__name__)) != type_name:
            raise UsageError(f"{self.path}: {topic} is {type_name}; not {given}")
        return bytes(self._store.serialize_cdr(message, type_name))

    def write_raw(self, topic: str, log_time: int, data: bytes) -> None:
        """Write a serialized message (CDR).

        Args:
            topic: the absolute name; if it is one of ours, it need not be declared.
            log_time: when it is recorded, ns.
            data: the message of the topic's type, serialized.

        Raises:
            UsageError: the topic is not declared, or the log time is before 0.
            BagError: the disk is full or gone.
        """
        channel = self._topic(topic).channel
        if log_time < 0:
            raise UsageError(f"{self.path}: {topic} at log time {log_time} ns; expected 0 or more")
        self._pending.append((channel, log_time, data))
        self.message_count += 1
        self._pending_bytes += len(data)
        enough = len(self._pending) >= _BATCH or self._pending_bytes >= _BATCH_BYTES
        if enough or self._failure is not None:
            self._pending_bytes = 0
            self._run(self._write_pending)

    def _topic(self, topic: str) -> Topic:
        """Returns a topic; a topic of this package that is not declared yet is declared."""
        if not self._open or topic not in self._topics:
            self._check_open()
            self.declare(topic)
        return self._topics[topic]

    def _check_open(self) -> None:
        """Raise UsageError if the bag is closed."""
        if not self._open:
            raise UsageError(f"{self.path}: is closed; nothing more can be written")

    def _make_file(self, compressed: bool) -> McapOutput:
        """In the thread: make the folder and begin the file."""
        self.path.mkdir(mode=0o755)
        self._made = True
        file = McapOutput(self.path / bag_file(self.path), compressed=compressed)
        _synchronize(self.path)
        _synchronize(self.path.absolute().parent)
        return file

    def flush(self) -> None:
        """Return when the disk has every message that was written so far.

        Raises:
            UsageError: the bag is closed.
            BagError: the disk is full or gone.
        """
        self._check_open()
        self._run(self._flush)

    def _flush_every(self, period: float) -> None:
        """In a thread of its own: flush every ``period`` seconds until the bag is closed."""
        try:
            while not self._closing.wait(period):
                self._thread.submit(self._flush).result()
        except OSError as error:
            self._failure = error  # for the next message
        except RuntimeError:
            return  # the bag, or Python itself, is being closed

    def _flush(self) -> None:
        """In the thread: write the messages that wait, and wait until the disk has them.

        A flush that was submitted before the end and runs after the end finds the file closed.
        """
        if not self._closing.is_set() and (self._pending or self._unflushed):
            self._write_pending()
            self._file.flush()
            self._unflushed = False

    def _write_pending(self) -> None:
        """In the thread: write the messages that wait."""
        if self._failure is not None:
            raise self._failure
        self._unflushed = True
        self._file.write([self._pending.popleft() for _ in range(len(self._pending))])

    def _finish(self) -> None:
        """In the thread: write the rest, then index and metadata, once."""
        if self._closing.is_set():
            return
        self._closing.set()
        try:
            self._write_pending()
        finally:
            whole, inner = metadata(bag_file(self.path), self._file, self._topics.values())
            self._file.finish(inner)
            with (self.path / "metadata.yaml").open("x", encoding="utf-8") as file:
                file.write(whole)
                file.flush()
                os.fsync(file.fileno())
            _synchronize(self.path)

    def _run(self, job: Callable[[], _Result]) -> _Result:
        """Run ``job`` in the thread that owns the files, and wait for it."""
        try:
            return self._thread.submit(job).result()
        except OSError as error:
            reason = getattr(error, "strerror", None) or error
            raise BagError(f"{self.path}: cannot be written: {reason}") from error


def _synchronize(folder: Path) -> None:
    """Have the disk take the names in a folder."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def copy_topics(
    reader: BagReader, writer: BagWriter, topics: Collection[str] | None = None
) -> int:
    """Copy topics: serialized messages, log times, types and quality of service.

    Args:
        reader: the bag to copy from.
        writer: the bag to copy to; its topics are declared.
        topics: only these absolute names; None for all.

    Returns:
        The number of messages copied.

    Raises:
        UsageError: ``writer`` has one of the topics already.
        BagError: a topic is missing, or one of the bags cannot be read or written.
    """
    messages = reader.raw(topics)
    for topic in reader.topics if topics is None else topics:
        info = reader.topics[topic]
        writer.declare(
            topic, type_name=info.type, quality=info.quality, definition=info.definition
        )
    before = writer.message_count
    for message in messages:
        writer.write_raw(*message)
    return writer.message_count - before
