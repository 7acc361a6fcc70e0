# SPDX-License-Identifier: Apache-2.0
"""The MCAP file of a bag that is written (https://mcap.dev/spec), by the library ``mcap``."""

import os
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TypeAlias

from mcap.writer import CompressionType, Writer

from impact_observer import __version__

Item: TypeAlias = tuple[int, int, bytes]
"""A message: the number of its channel, its log time (ns), its bytes."""
_CHUNK = 2**16
"""Bytes in a chunk, which is what one flipped bit costs."""


class McapOutput:
    """An MCAP file of profile ``ros2`` with checksums of chunks, data and index.

    Attributes:
        counts: messages of each channel.
        start: log time of the earliest message, ns; 0 without any.
        end: log time of the latest message, ns; 0 without any.
    """

    def __init__(self, path: Path, *, compressed: bool) -> None:
        """Begin the file at ``path``; ``compressed`` chunks are compressed by zstd.

        Raises:
            OSError: the file exists already, or cannot be made.
        """
        self.counts = Counter[int]()
        self.start = self.end = 0
        self._schemas: dict[str, int] = {}
        self._file = path.open("xb")
        kind = CompressionType.ZSTD if compressed else CompressionType.NONE
        self._writer = Writer(
            self._file,
            chunk_size=_CHUNK,
            compression=kind,
            enable_crcs=True,
            enable_data_crcs=True,
        )
        self._writer.start("ros2", f"impact_observer {__version__}")
        self._synchronize()

    def add_channel(
        self, topic: str, type_name: str, definition: str, metadata: Mapping[str, str]
    ) -> int:
        """Add a topic, and return the number of its channel.

        Args:
            topic: the absolute name.
            type_name: of its messages, which are serialized as CDR.
            definition: the text of the message type, as msg or IDL.
            metadata: of the channel.
        """
        if type_name not in self._schemas:
            encoding = "ros2idl" if definition.startswith("=" * 80 + "\nIDL: ") else "ros2msg"
            schema = self._writer.register_schema(type_name, encoding, definition.encode())
            self._schemas[type_name] = schema
        schema = self._schemas[type_name]
        return self._writer.register_channel(topic, "cdr", schema, dict(metadata))

    def write(self, items: Iterable[Item]) -> None:
        """Add messages in this order.

        Raises:
            OSError: the disk is full or gone.
        """
        for channel, log_time, data in items:
            self.start = min(self.start, log_time) if self.counts else log_time
            self.end = max(self.end, log_time)
            self.counts[channel] += 1
            self._writer.add_message(channel, log_time, data, publish_time=log_time)

    def flush(self) -> None:
        """End the chunk in progress, if it has a message; return when the disk has the file.

        Raises:
            OSError: the disk is full or gone.
        """
        self._writer.flush()  # type: ignore[no-untyped-call]
        self._synchronize()

    def finish(self, metadata: str) -> None:
        """Write the ``metadata`` of rosbag2 and the index; close the file.

        Raises:
            OSError: the disk is full or gone.
        """
        with self._file:
            self._writer.flush()  # type: ignore[no-untyped-call]
            self._writer.add_metadata("rosbag2", {"serialized_metadata": metadata})
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._synchronize()

    def _synchronize(self) -> None:
        """Wait until the disk has what was written."""
        self._file.flush()
        os.fsync(self._file.fileno())
