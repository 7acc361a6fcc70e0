# SPDX-License-Identifier: Apache-2.0
"""The messages of an MCAP file that may be damaged, from its beginning, without index or footer.

The package ``mcap`` parses records and chunks; this module continues after broken ones.
"""

from collections.abc import Iterator
from io import BytesIO
from typing import BinaryIO, TypeAlias

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import CRCValidationError, breakup_chunk, read_magic
from mcap.summary import Summary

_OPCODES = range(1, 0x10)
"""Record types of this version of the format."""
_FRAME = 9
"""Bytes of the opcode and the length before each record."""

McapMessage: TypeAlias = tuple[Schema, Channel, Message]
"""A message with its type and its topic."""


def summary_of(file: BinaryIO) -> Summary | None:
    """Returns the index at the end of an MCAP file; None if the index is missing or damaged."""
    file.seek(0)
    try:
        return make_reader(file).get_summary()
    except Exception:  # noqa: BLE001 (the library raises anything for a damaged file)
        return None


class McapFile:
    """An MCAP file that may be damaged, to be read once.

    Attributes:
        at: bytes read so far.
        losses: one line for each part that could not be read.
    """

    def __init__(self, file: BinaryIO) -> None:
        """Read ``file``, from its beginning."""
        self._file = file
        self._size = file.seek(0, 2)
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._chunks: list[int] = []
        self.at = 0
        self.losses: list[str] = []

    def messages(self) -> Iterator[McapMessage]:
        """Yields the messages chunk after chunk, within a chunk in the order of log times."""
        if (summary := summary_of(self._file)) is not None:
            self._chunks = [each.chunk_start_offset for each in summary.chunk_indexes]
            self._schemas.update(summary.schemas)
            self._channels.update(summary.channels)
        self._file.seek(0)
        try:
            read_magic(ReadDataStream(self._file))
        except Exception:  # noqa: BLE001 (the library raises anything)
            self.losses.append("does not begin as an MCAP file")
            return
        self.at = self._file.tell()
        while (frame := self._frame()) is not None:
            opcode, length = frame
            if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                return
            record = self._record(opcode, length)
            if isinstance(record, Chunk):
                yield from self._chunk(record, is_whole=self._end(length) <= self._size)
            elif record is not None:
                yield from self._noted([record])
            self.at = self._end(length)
            self._file.seek(self.at)
            if self.at > self._size:
                self.losses.append(f"was cut short at byte {self._size}")
                return

    def _end(self, length: int) -> int:
        """Returns the place behind the record at ``at``."""
        return self.at + _FRAME + length

    def _frame(self) -> tuple[int, int] | None:
        """Returns type and length of the next record; None at the end of the readable part."""
        while True:
            stream = ReadDataStream(self._file)
            try:
                opcode, length = stream.read1(), stream.read8()
            except Exception:  # noqa: BLE001 (the library raises anything)
                self.losses.append(f"was cut short at byte {self._size}")
                return None
            if opcode in _OPCODES and self._end(length) <= self._size:
                return opcode, length
            later = min((each for each in self._chunks if each > self.at), default=None)
            if later is None and opcode == Opcode.CHUNK:
                return opcode, length
            if later is None:
                self.losses.append(f"is cut short or damaged at byte {self.at}")
                return None
            self.losses.append(f"is damaged from byte {self.at} to {later}")
            self.at = later
            self._file.seek(later)

    def _record(self, opcode: int, length: int) -> McapRecord | None:
        """Returns a schema, channel, message or chunk; None for any other record."""
        stream = ReadDataStream(BytesIO(self._file.read(min(length, self._size))))
        record: McapRecord | None = None
        try:
            if opcode == Opcode.MESSAGE:
                record = Message.read(stream, length)
            elif opcode == Opcode.SCHEMA:
                record = Schema.read(stream)
            elif opcode == Opcode.CHANNEL:
                record = Channel.read(stream)
            elif opcode == Opcode.CHUNK:
                record = Chunk.read(stream)
        except Exception as error:  # noqa: BLE001 (the library raises anything)
            self.losses.append(f"the record at byte {self.at} is damaged ({error})")
        return record

    def _chunk(self, chunk: Chunk, *, is_whole: bool) -> Iterator[McapMessage]:
        """Yields the messages of a chunk; of a chunk that was cut short, the whole messages."""
        if not is_whole:
            records = self._records_of_part(chunk)
        else:
            try:
                records = breakup_chunk(chunk, validate_crc=True)
            except CRCValidationError:
                self.losses.append(f"the chunk at byte {self.at} does not match its checksum")
                return
            except Exception as error:  # noqa: BLE001 (decompressors raise anything)
                self.losses.append(f"the chunk at byte {self.at} is damaged ({error})")
                records = self._records_of_part(chunk)
        yield from sorted(self._noted(records), key=lambda each: each[2].log_time)

    def _records_of_part(self, chunk: Chunk) -> list[McapRecord]:
        """Returns the whole records of a chunk that was cut short or is damaged."""
        data, records = chunk.data, list[McapRecord]()
        try:
            if chunk.compression == "zstd":
                data = zstandard.ZstdDecompressor().decompressobj().decompress(data)
            elif chunk.compression == "lz4":
                data = lz4.frame.LZ4FrameDecompressor().decompress(data)
        except Exception as error:  # noqa: BLE001 (decompressors raise anything)
            self.losses.append(f"the chunk at byte {self.at} cannot be decompressed ({error})")
            return records
        place = 0
        while place + _FRAME <= len(data):
            length = int.from_bytes(data[place + 1 : place + _FRAME], "little")
            end = place + _FRAME + length
            if end > len(data):
                break
            part = Chunk("", data[place:end], 0, 0, 0, end - place)
            try:
                records += breakup_chunk(part)
            except Exception:  # noqa: BLE001 (the library raises anything)
                self.losses.append(f"the chunk at byte {self.at} is damaged at its byte {place}")
                break
            place = end
        return records

    def _noted(self, records: list[McapRecord]) -> Iterator[McapMessage]:
        """Yields the messages among ``records``; notes the types and topics."""
        for record in records:
            if isinstance(record, Schema):
                self._schemas[record.id] = record
            elif isinstance(record, Channel):
                self._channels[record.id] = record
            elif isinstance(record, Message):
                channel = self._channels.get(record.channel_id)
                schema = None if channel is None else self._schemas.get(channel.schema_id)
                if channel is not None and schema is not None:
                    yield schema, channel, record
                    continue
                line = f"a message at byte {self.at} has no topic"
                if channel is not None:
                    line = f"{channel.topic}: messages without a schema, whose type is unknown"
                if line not in self.losses[-1:]:
                    self.losses.append(line)
