# SPDX-License-Identifier: Apache-2.0
"""The messages of an MCAP file that may be damaged, from its beginning.

The package ``mcap`` parses records and chunks; this module continues after broken ones. An index
that is whole says where the chunks are and what was in those that are broken.
"""

from collections.abc import Iterator
from io import BytesIO
from typing import BinaryIO, TypeAlias

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, ChunkIndex, McapRecord, Message, Schema
from mcap.stream_reader import CRCValidationError, breakup_chunk, read_magic
from mcap.summary import Summary

from impact_observer.draw.reports import counted
from impact_observer.io.decompression import decompressed, plain
from impact_observer.io.mcap_checksums import index_is_damaged
from impact_observer.stamps import seconds_between, text

_OPCODES = range(1, 0x10)
"""Record types of this version of the format."""
_IN_CHUNKS = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)
"""Those that a chunk may have."""
_FRAME = 9
"""Bytes of the opcode and the length before each record."""

McapMessage: TypeAlias = tuple[Schema, Channel, Message]
"""A message with its type and its topic."""


def summary_of(file: BinaryIO) -> Summary | None:
    """Returns the index at the end of an MCAP file; None if the index is missing or damaged."""
    if index_is_damaged(file):
        return None
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
        self._chunks: dict[int, ChunkIndex] = {}
        self.at = 0
        self.losses: list[str] = []

    def messages(self) -> Iterator[McapMessage]:
        """Yields the messages chunk after chunk, within a chunk in the order of log times."""
        if (summary := summary_of(self._file)) is not None:
            self._chunks = {each.chunk_start_offset: each for each in summary.chunk_indexes}
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
        """Returns type and length of the next record; None at the end of the readable part.

        Where the index has a chunk, the index is used. No record reaches into a later chunk.
        """
        while True:
            if (known := self._chunks.get(self.at)) is not None:
                self._file.seek(self.at + _FRAME)
                return Opcode.CHUNK, known.chunk_length - _FRAME
            stream = ReadDataStream(self._file)
            try:
                opcode, length = stream.read1(), stream.read8()
            except Exception:  # noqa: BLE001 (the library raises anything)
                self.losses.append(f"was cut short at byte {self._size}")
                return None
            later = min((each for each in self._chunks if each > self.at), default=None)
            is_early = later is not None and opcode in (Opcode.DATA_END, Opcode.FOOTER)
            fits = self._end(length) <= (self._size if later is None else later)
            if opcode in _OPCODES and fits and not is_early:
                return opcode, length
            if later is None and opcode == Opcode.CHUNK:
                return opcode, length
            if later is None:
                self.losses.append(f"is cut short or damaged at byte {self.at}")
                return None
            self.losses.append(f"is damaged from byte {self.at} to {later}")
            self.at = later

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
            what = f"is damaged ({error})"
            if opcode == Opcode.CHUNK:
                self._lose_chunk(what)
            else:
                self.losses.append(f"the record at byte {self.at} {what}")
        return record

    def _chunk(self, chunk: Chunk, *, is_whole: bool) -> Iterator[McapMessage]:
        """Yields the messages of a chunk; of a chunk that was cut short, the whole messages."""
        records: list[McapRecord] | None = None
        has_checksum = chunk.uncompressed_crc != 0
        if is_whole or has_checksum:
            try:
                records = breakup_chunk(plain(chunk), validate_crc=True)
            except CRCValidationError:
                if is_whole:
                    self._lose_chunk("does not match its checksum", chunk)
                    return
            except Exception as error:  # noqa: BLE001 (decompressors raise anything)
                if is_whole and has_checksum:
                    self._lose_chunk(f"is damaged ({error})", chunk)
                    return
                if is_whole:
                    self.losses.append(f"the chunk at byte {self.at} is damaged ({error})")
        if records is None:
            records = self._records_of_part(chunk)
        yield from sorted(
            self._noted(records, checked=has_checksum), key=lambda each: each[2].log_time
        )

    def _lose_chunk(self, what: str, chunk: Chunk | None = None) -> None:
        """Note that a chunk is left out, and how much that is, as far as known."""
        known = self._chunks.get(self.at)
        messages = "an unknown number of messages"
        if known is not None and known.message_index_length:
            # https://mcap.dev/spec: 15 bytes of an index of a channel, and 16 for each message
            entries = known.message_index_length - 15 * len(known.message_index_offsets)
            messages = counted(entries // 16, "message")
        extent = ""
        if (times := known or chunk) is not None:
            first, last = times.message_start_time, times.message_end_time
            extent = f" in {seconds_between(first, last):.3g} s from {text(first)} s"
        line = f"the chunk at byte {self.at} {what}, and is left out: {messages}{extent}"
        self.losses.append(line)

    def _records_of_part(self, chunk: Chunk) -> list[McapRecord]:
        """Returns the whole records of a chunk that was cut short or is damaged."""
        data, records = chunk.data, list[McapRecord]()
        try:
            data = decompressed(data, chunk.compression, chunk.uncompressed_size)
        except Exception as error:  # noqa: BLE001 (decompressors raise anything)
            self.losses.append(f"the chunk at byte {self.at} cannot be decompressed ({error})")
            return records
        place, fault, whole = 0, False, max(chunk.uncompressed_size, len(data))
        while place < len(data) and not fault:
            length = int.from_bytes(data[place + 1 : place + _FRAME], "little")
            end = place + _FRAME + length
            fault = data[place] not in _IN_CHUNKS or (len(data) - place >= _FRAME and end > whole)
            if fault or end > len(data):
                break
            part = Chunk("", data[place:end], 0, 0, 0, end - place)
            try:
                records += breakup_chunk(part)
            except Exception:  # noqa: BLE001 (the library raises anything)
                fault = True
            place = end
        if fault:  # bytes are missing, perhaps of the record before
            records = records[:-1]
            self.losses.append(f"the chunk at byte {self.at} is damaged near its byte {place}")
        if count := sum(isinstance(each, Message) for each in records):
            self.losses.append(
                f"{counted(count, 'message')} of the chunk at byte {self.at} cannot be checked, as"
                " the chunk is not whole"
            )
        return records

    def _noted(self, records: list[McapRecord], *, checked: bool = False) -> Iterator[McapMessage]:
        """Yields the messages among ``records``; notes the types and topics.

        Types and topics that no checksum has ``checked`` do not replace known ones.
        """
        for record in records:
            if isinstance(record, Schema):
                self._schemas[record.id] = (
                    record if checked else self._schemas.get(record.id, record)
                )
            elif isinstance(record, Channel):
                self._channels[record.id] = (
                    record if checked else self._channels.get(record.id, record)
                )
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
