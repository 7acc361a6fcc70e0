# SPDX-License-Identifier: Apache-2.0
"""The messages of an MCAP file that may be damaged, from its beginning, without index or footer.

The package ``mcap`` parses the records; this module goes on after broken ones.
"""

import zlib
from collections.abc import Iterator
from io import BytesIO
from typing import BinaryIO, TypeAlias

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Message, Schema

from impact_observer.io.mcap_layout import CHUNK, FRAME, MAGIC, summary_of, uncompressed

_OPCODES = range(1, 0x10)
"""Record types of this version of the format."""
_READ = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK)

McapMessage: TypeAlias = tuple[Schema, Channel, Message]
"""A message with its type and its topic."""


class McapFile:
    """An MCAP file that may be damaged, to be read once.

    Attributes:
        at: bytes read so far.
        losses: what could not be read, a line each.
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
        """The messages, chunk after chunk, those of a chunk in the order of their log times."""
        self._file.seek(0)
        if self._file.read(len(MAGIC)) != MAGIC:
            self.losses.append("does not begin as an MCAP file")
            return
        if (summary := summary_of(self._file)) is not None:
            self._chunks = [each.chunk_start_offset for each in summary.chunk_indexes]
            self._schemas.update(summary.schemas)
            self._channels.update(summary.channels)
        self.at = len(MAGIC)
        self._file.seek(self.at)
        while (frame := self._frame()) is not None:
            opcode, length = frame
            if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                return
            begin = self.at + FRAME.size
            body = self._file.read(min(length, self._size)) if opcode in _READ else b""
            if opcode == Opcode.CHUNK:
                yield from self._chunk(body, length)
            else:
                yield from self._records(FRAME.pack(opcode, len(body)) + body)
            self.at = begin + length
            self._file.seek(self.at)
            if self.at > self._size:
                self.losses.append(f"was cut short at byte {self._size}")
                return

    def _frame(self) -> tuple[int, int] | None:
        """Type and length of the next record; None at the end of what can be read."""
        while True:
            head = self._file.read(FRAME.size)
            if len(head) < FRAME.size:
                self.losses.append(f"was cut short at byte {self._size}")
                return None
            opcode, length = FRAME.unpack(head)
            if opcode in _OPCODES and self.at + FRAME.size + length <= self._size:
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

    def _chunk(self, body: bytes, length: int) -> Iterator[McapMessage]:
        """The messages of a chunk, of one that was cut short as many as are whole."""
        try:
            *_, size, checksum = CHUNK.unpack_from(body)
            stream = ReadDataStream(BytesIO(body[CHUNK.size :]))
            compression, stored = stream.read_prefixed_string(), stream.read8()
            data = uncompressed(body[CHUNK.size + stream.count :][:stored], compression)
        except Exception as error:  # noqa: BLE001 (decompressors raise anything)
            self.losses.append(f"the chunk at byte {self.at} cannot be decompressed ({error})")
            return
        is_whole = len(body) == length
        if is_whole and (len(data) != size or (checksum and zlib.crc32(data) != checksum)):
            self.losses.append(f"the chunk at byte {self.at} does not match its checksum")
            return
        yield from sorted(self._records(data), key=lambda each: each[2].log_time)

    def _records(self, data: bytes) -> Iterator[McapMessage]:
        """The messages among records, which may end early."""
        place = 0
        while place + FRAME.size <= len(data):
            opcode, length = FRAME.unpack_from(data, place)
            body = data[place + FRAME.size : place + FRAME.size + length]
            stream = ReadDataStream(BytesIO(body))
            try:
                if opcode not in _OPCODES:
                    raise ValueError
                if len(body) < length:
                    return
                if opcode == Opcode.MESSAGE:
                    message = Message.read(stream, length)
                    channel = self._channels[message.channel_id]
                    yield self._schemas[channel.schema_id], channel, message
                elif opcode == Opcode.SCHEMA:
                    schema = Schema.read(stream)
                    self._schemas[schema.id] = schema
                elif opcode == Opcode.CHANNEL:
                    channel = Channel.read(stream)
                    self._channels[channel.id] = channel
            except Exception:  # noqa: BLE001 (mcap raises anything)
                self.losses.append(f"the chunk at byte {self.at} is damaged at its byte {place}")
                return
            place += FRAME.size + length
