# SPDX-License-Identifier: Apache-2.0
"""Writing an MCAP file, many messages at a time (https://mcap.dev/spec).

The records other than messages are those of the library ``mcap``. Its writer, like that of
``rosbags``, makes each message from several small writes, which would take a third of the time of
``observe``; here the messages of a batch are joined at once.
"""

import os
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from impact_observer import __version__
from impact_observer.io.mcap_layout import FRAME, MAGIC, MESSAGE, MESSAGE_OPCODE

Item: TypeAlias = tuple[int, int, bytes]
"""A message: the number of its channel, its log time (ns), its bytes."""
_CHUNK_SIZE = 2**20
"""A chunk ends with the message that makes it larger than this, in bytes."""


class McapWriter:
    """An MCAP file of profile ``ros2``, open for writing.

    Attributes:
        counts: messages of each channel in the chunks that have ended.
        start: log time of their earliest message, ns; 0 without any.
        end: log time of their latest message, ns; 0 without any.
    """

    def __init__(self, path: Path, *, compressed: bool) -> None:
        """Begin the file at ``path``; chunks are compressed by zstd if asked for.

        Raises:
            OSError: the file cannot be made.
        """
        self.counts = Counter[int]()
        self.start = self.end = 0
        self._compressed = compressed
        self._schemas: dict[str, Schema] = {}
        self._channels: list[Channel] = []
        self._chunk_indexes: list[ChunkIndex] = []
        self._chunk = bytearray()
        self._places: defaultdict[int, list[tuple[int, int]]] = defaultdict(list)
        self._file = path.open("xb")
        self._file.write(MAGIC)
        self._write(Header("ros2", f"impact_observer {__version__}"))

    def add_channel(
        self, topic: str, type_name: str, definition: str, metadata: Mapping[str, str]
    ) -> int:
        """Add a topic; the number of its channel.

        Args:
            topic: the absolute name.
            type_name: of its messages, which are serialized as CDR.
            definition: the text of the message type, as msg or IDL.
            metadata: of the channel.
        """
        if type_name not in self._schemas:
            encoding = "ros2idl" if definition.startswith("=" * 80 + "\nIDL: ") else "ros2msg"
            number = len(self._schemas) + 1
            schema = Schema(id=number, data=definition.encode(), encoding=encoding, name=type_name)
            self._schemas[type_name] = schema
            self._chunk += _bytes_of(schema)
        channel = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding="cdr",
            metadata=dict(metadata),
            schema_id=self._schemas[type_name].id,
        )
        self._channels.append(channel)
        self._chunk += _bytes_of(channel)
        return channel.id

    def write(self, items: Iterable[Item]) -> None:
        """Add messages, in this order.

        Raises:
            OSError: the disk is full or gone.
        """
        for channel, log_time, data in items:
            self._places[channel].append((log_time, len(self._chunk)))
            self._chunk += FRAME.pack(MESSAGE_OPCODE, MESSAGE.size + len(data))
            self._chunk += MESSAGE.pack(channel, 0, log_time, log_time)
            self._chunk += data
            if len(self._chunk) > _CHUNK_SIZE:
                self.end_chunk()

    def flush(self) -> None:
        """End the chunk if it has a message, and have the disk take all that is written.

        Raises:
            OSError: the disk is full or gone.
        """
        if self._places:
            self.end_chunk()
            self.synchronize()

    def synchronize(self) -> None:
        """Have the disk take the bytes that were written.

        Raises:
            OSError: the disk is full or gone.
        """
        self._file.flush()
        os.fsync(self._file.fileno())

    def finish(self, metadata: str) -> None:
        """Write what is left, the ``metadata`` of rosbag2 and the index; close the file.

        Raises:
            OSError: the disk is full or gone.
        """
        with self._file:
            self.end_chunk()
            begin = self._file.tell()
            self._write(Metadata("rosbag2", {"serialized_metadata": metadata}))
            index = MetadataIndex(begin, self._file.tell() - begin, "rosbag2")
            self._write(DataEnd(0))
            self._write_summary(index)
            self._file.write(MAGIC)
            self.synchronize()

    def _write(self, record: McapRecord) -> None:
        self._file.write(_bytes_of(record))

    def end_chunk(self) -> None:
        """Write the open chunk, if it has a record, and the indexes of its messages.

        Raises:
            OSError: the disk is full or gone.
        """
        if not self._chunk:
            return
        times = [time for places in self._places.values() for time, _ in places]
        first, last = min(times, default=0), max(times, default=0)
        if times:
            self.start = min(self.start, first) if self.counts else first
            self.end = max(self.end, last)
            self.counts.update({channel: len(places) for channel, places in self._places.items()})
        records = bytes(self._chunk)
        compression = "zstd" if self._compressed else ""
        data = zstandard.ZstdCompressor().compress(records) if self._compressed else records
        begin = self._file.tell()
        self._write(
            Chunk(
                compression=compression,
                data=data,
                message_end_time=last,
                message_start_time=first,
                uncompressed_crc=0,
                uncompressed_size=len(records),
            )
        )
        end, offsets = self._file.tell(), dict[int, int]()
        for channel, places in self._places.items():
            offsets[channel] = self._file.tell()
            self._write(MessageIndex(channel_id=channel, records=places))
        self._chunk_indexes.append(
            ChunkIndex(
                chunk_length=end - begin,
                chunk_start_offset=begin,
                compression=compression,
                compressed_size=len(data),
                message_end_time=last,
                message_index_length=self._file.tell() - end,
                message_index_offsets=offsets,
                message_start_time=first,
                uncompressed_size=len(records),
            )
        )
        self._chunk.clear()
        self._places.clear()

    def _write_summary(self, metadata_index: MetadataIndex) -> None:
        """Write what a reader needs to find its way, and where it begins."""
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts={each.id: self.counts[each.id] for each in self._channels},
            chunk_count=len(self._chunk_indexes),
            message_count=self.counts.total(),
            message_end_time=self.end,
            message_start_time=self.start,
            metadata_count=1,
            schema_count=len(self._schemas),
        )
        groups: tuple[tuple[Opcode, Sequence[McapRecord]], ...] = (
            (Opcode.SCHEMA, [*self._schemas.values()]),
            (Opcode.CHANNEL, self._channels),
            (Opcode.CHUNK_INDEX, self._chunk_indexes),
            (Opcode.METADATA_INDEX, [metadata_index]),
            (Opcode.STATISTICS, [statistics]),
        )
        offsets = []
        summary_start = self._file.tell()
        for opcode, records in groups:
            begin = self._file.tell()
            for record in records:
                self._write(record)
            if records:
                offsets.append(SummaryOffset(opcode, begin, self._file.tell() - begin))
        offset_start = self._file.tell()
        for offset in offsets:
            self._write(offset)
        self._write(Footer(summary_start, offset_start, summary_crc=0))


def _bytes_of(record: McapRecord) -> bytes:
    """A record as it stands in a file."""
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]
