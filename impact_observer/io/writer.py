# SPDX-License-Identifier: Apache-2.0
"""Writing a bag: an MCAP directory that ``ros2 bag`` reads, by the library ``mcap``."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from io import StringIO
from pathlib import Path
from typing import Any, final

from mcap.writer import CompressionType, Writer
from rosbags.rosbag2.metadata import dump_qos_v9
from ruamel.yaml import YAML

from impact_observer import __version__
from impact_observer.errors import BagError, UsageError
from impact_observer.io.interfaces import Quality, interface, usual_quality
from impact_observer.io.typestores import add_definition, new_typestore
from impact_observer.output_files import check_output, check_outputs

_CHUNK = 2**16
"""Bytes in a chunk, which is what one flipped bit costs."""
_NO_MESSAGE = 2**63 - 1
"""Starting time that rosbag2 writes for a bag without messages, ns."""


def bag_file(path: Path) -> str:
    """The name of the one MCAP file in the bag ``path``, as ``ros2 bag reindex`` wants it."""
    return f"{path.name}_0.mcap"


def check_free(path: Path) -> None:
    """Check that a bag can be made at ``path``.

    Raises:
        UsageError: something is there already, its parent is no folder, or the name is too long
            or no UTF-8.
    """
    check_outputs([(path, ())])
    check_output(path.with_name(bag_file(path)), ())  # the longest name in the bag


@final
class BagWriter:
    """A bag, open for writing; a context manager, whose end closes the bag.

    If the process is killed or the machine loses power, the disk has every message that was
    written before the last :meth:`flush`, or in a chunk that was full. Every method raises
    BagError if the disk is full or gone.

    Attributes:
        path: the bag.
        message_count: messages written so far.
    """

    def __init__(self, path: Path | str, folder: Path | None = None) -> None:
        """Make the bag's folder.

        Args:
            path: the bag.
            folder: where the files are written until the caller moves the folder to ``path``;
                None for ``path``.

        Raises:
            UsageError: something is at ``path`` already, or its parent is no folder. Then nothing
                is created.
        """
        self.path, self.message_count = Path(path), 0
        check_free(self.path)
        self._folder = folder or self.path
        self._store = new_typestore()
        self._topics: dict[str, dict[str, Any]] = {}  # as metadata.yaml has them
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._start, self._end = _NO_MESSAGE, 0
        self._is_open = True
        with self._one_line():
            self._folder.mkdir(mode=0o755)
            self._file = (self._folder / bag_file(self.path)).open("xb")
            self._writer = Writer(
                self._file,
                chunk_size=_CHUNK,
                compression=CompressionType.NONE,
                enable_crcs=True,
                enable_data_crcs=True,
            )
            self._writer.start("ros2", f"impact_observer {__version__}")

    def __enter__(self) -> "BagWriter":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Write the last chunk, the index and the metadata; closing twice does no harm."""
        if not self._is_open:
            return
        self._is_open = False
        about = self._metadata()
        with self._one_line(), self._file:
            self._writer.flush()  # type: ignore[no-untyped-call]
            self._writer.add_metadata("rosbag2", {"serialized_metadata": _yaml(about).strip()})
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._synchronize()
            text = _yaml({"rosbag2_bagfile_information": about})
            (self._folder / "metadata.yaml").write_text(text, encoding="utf-8")

    def _metadata(self) -> dict[str, object]:
        """What ``metadata.yaml`` says of the bag: version 9, that of Jazzy."""
        length = max(self._end - self._start, 0)

        def extent() -> dict[str, object]:  # no value twice: YAML would refer to the first
            return {
                "message_count": self.message_count,
                "duration": {"nanoseconds": length},
                "starting_time": {"nanoseconds_since_epoch": self._start},
            }

        return {
            "version": 9,
            "storage_identifier": "mcap",
            "relative_file_paths": [bag_file(self.path)],
            **extent(),
            "topics_with_message_count": [*self._topics.values()],
            "compression_format": "",
            "compression_mode": "",
            "files": [{"path": bag_file(self.path), **extent()}],
            "custom_data": None,
            "ros_distro": "rosbags",
        }

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
        if definition:
            add_definition(self._store, definition, type_name)
        if type_name not in self._store.fielddefs:
            raise UsageError(f"{self.path}: {topic} is {type_name}; give its definition too")
        offered = dump_qos_v9([(quality or usual_quality(topic)).offered()])
        type_hash = self._store.hash_rihs01(type_name)
        in_file = {"offered_qos_profiles": _yaml(offered).strip(), "topic_type_hash": type_hash}
        with self._one_line():
            if type_name not in self._schemas:
                text, _ = self._store.generate_msgdef(type_name, ros_version=2)
                encoding = "ros2idl" if text.startswith("=" * 80 + "\nIDL: ") else "ros2msg"
                number = self._writer.register_schema(type_name, encoding, text.encode())
                self._schemas[type_name] = number
            self._channels[topic] = self._writer.register_channel(
                topic, "cdr", self._schemas[type_name], in_file
            )
        about = {
            "name": topic,
            "type": type_name,
            "serialization_format": "cdr",
            "offered_qos_profiles": offered,
            "type_description_hash": type_hash,
        }
        self._topics[topic] = {"topic_metadata": about, "message_count": 0}

    def write(self, topic: str, log_time: int, message: object) -> None:
        """Write a message of :func:`~impact_observer.io.messages.bag_messages`.

        Raises:
            UsageError: as of :meth:`write_raw`, or the message is of another type.
        """
        self.write_raw(topic, log_time, self.serialized(topic, message))

    def serialized(self, topic: str, message: object) -> bytes:
        """The bytes of a message, as :meth:`write_raw` takes them; errors as of :meth:`write`."""
        type_name = self._topic(topic)["topic_metadata"]["type"]
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
        """
        about = self._topic(topic)
        if log_time < 0:
            raise UsageError(f"{self.path}: {topic} at log time {log_time} ns; expected 0 or more")
        with self._one_line():
            self._writer.add_message(self._channels[topic], log_time, data, publish_time=log_time)
        self._start, self._end = min(self._start, log_time), max(self._end, log_time)
        self.message_count += 1
        about["message_count"] += 1

    def _topic(self, topic: str) -> dict[str, Any]:
        """Returns a topic; a topic of this package that is not declared yet is declared."""
        if not self._is_open:
            raise UsageError(f"{self.path}: is closed; nothing more can be written")
        if topic not in self._topics:
            self.declare(topic)
        return self._topics[topic]

    def flush(self) -> None:
        """Close the chunk in progress; return when the disk has all messages so far."""
        with self._one_line():
            self._writer.flush()  # type: ignore[no-untyped-call]
            self._synchronize()

    def _synchronize(self) -> None:
        """Wait until the disk has what was written."""
        self._file.flush()
        os.fsync(self._file.fileno())

    @contextmanager
    def _one_line(self) -> Iterator[None]:
        """Within the block, an error of the disk is a BagError."""
        try:
            yield
        except OSError as error:
            reason = getattr(error, "strerror", None) or error
            raise BagError(f"{self.path}: cannot be written: {reason}") from error


def _yaml(value: object) -> str:
    """A value as YAML in block style."""
    stream, yaml = StringIO(), YAML(typ="safe")
    yaml.default_flow_style = False
    yaml.dump(value, stream)
    return stream.getvalue()
