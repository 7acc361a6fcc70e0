"""The messages of an indexed MCAP file, chunk by chunk.

``rosbags`` reads each message in eight steps. Here the records of a chunk are gone through with
one each, and those of other topics are stepped over. The order is that of ``rosbags``: by log
time, then by place in the file. The layout is that of https://mcap.dev/spec.
"""

import heapq
import struct
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from operator import itemgetter
from pathlib import Path
from typing import BinaryIO, TypeAlias

import lz4.frame
import zstandard
from mcap.reader import make_reader
from mcap.records import ChunkIndex
from mcap.summary import Summary
from rosbags.rosbag2 import ReaderError

Message: TypeAlias = tuple[int, str, bytes]
"""Log time (ns), topic, bytes."""
_Load: TypeAlias = "Callable[[ChunkIndex], list[Message]]"

_FRAME = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQI")
"""First and last log time, uncompressed size, checksum of a chunk."""
_RECORD = struct.Struct("<BQHIQ")
"""Opcode and length of a record; of a message its channel, sequence and log time as well."""
_MESSAGE = 0x05
_COUNTED = 22
"""Bytes before a message that count into its record's length."""
_BEFORE = _FRAME.size + _COUNTED


def index_of(path: Path) -> Summary | None:
    """The index of an MCAP file; None where it has none that says where its messages are."""
    with path.open("rb") as file:
        try:
            summary = make_reader(file).get_summary()
        except Exception:  # noqa: BLE001 (whatever mcap trips over: rosbags shall say it)
            return None
    if summary is None or summary.statistics is None or not summary.chunk_indexes:
        return None
    told = all(chunk.message_index_offsets for chunk in summary.chunk_indexes)
    return summary if told else None


def messages(
    path: Path, index: Summary, wanted: Collection[tuple[str, str]], start: int = 0
) -> Iterator[list[Message]]:
    """The messages of some topics, in order, many at a time.

    Args:
        path: the file.
        index: of the file.
        wanted: topics with their types.
        start: only messages logged at or after this stamp, ns.

    Raises:
        ReaderError: a chunk is damaged.
    """
    topics: dict[int, str] = {}
    for number, channel in index.channels.items():
        schema = index.schemas.get(channel.schema_id)
        if schema is not None and (channel.topic, schema.name) in wanted:
            topics[number] = channel.topic
    chunks = [
        chunk
        for chunk in index.chunk_indexes
        if chunk.message_end_time >= start and topics.keys() & chunk.message_index_offsets.keys()
    ]
    with path.open("rb") as file:
        yield from _in_order(chunks, lambda chunk: _messages(_records(file, chunk), topics, start))


def _in_order(chunks: Iterable[ChunkIndex], load: _Load) -> Iterator[list[Message]]:
    """What is in ``chunks``; those that reach into each other are merged."""
    together: list[ChunkIndex] = []
    end = offset = -1
    for chunk in sorted(chunks, key=_place):
        begin = chunk.message_start_time
        if begin > end or (begin == end and chunk.chunk_start_offset > offset):
            yield from _merged(together, load)
            together, end, offset = [], -1, -1
        together.append(chunk)
        end = max(end, chunk.message_end_time)
        offset = max(offset, chunk.chunk_start_offset)
    yield from _merged(together, load)


def _place(chunk: ChunkIndex) -> tuple[int, int]:
    return chunk.message_start_time, chunk.chunk_start_offset


def _merged(chunks: Sequence[ChunkIndex], load: _Load) -> Iterator[list[Message]]:
    """What is in ``chunks``, none of which is loaded before its time."""
    if len(chunks) == 1:
        yield load(chunks[0])
        return

    def placed(chunk: ChunkIndex) -> Iterator[tuple[int, int, int, Message | None]]:
        yield chunk.message_start_time, chunk.chunk_start_offset, -1, None
        for k, message in enumerate(load(chunk)):
            yield message[0], chunk.chunk_start_offset, k, message

    for *_, message in heapq.merge(*map(placed, chunks)):
        if message is not None:
            yield [message]


def _messages(records: bytes, topics: dict[int, str], start: int) -> list[Message]:
    """The messages of some channels among ``records``, by log time."""
    found: list[Message] = []
    size, at = len(records), 0
    padded = records + bytes(_RECORD.size)  # the last one need not be a message
    unpack = _RECORD.unpack_from
    while at < size:
        opcode, length, channel, _, log_time = unpack(padded, at)
        end = at + _FRAME.size + length
        if opcode == _MESSAGE and channel in topics and log_time >= start:
            if length < _COUNTED:
                break
            found.append((log_time, topics[channel], records[at + _BEFORE : end]))
        at = end
    if at != size:
        raise ReaderError("A record reaches beyond the end of its chunk.")
    found.sort(key=itemgetter(0))
    return found


def _records(file: BinaryIO, chunk: ChunkIndex) -> bytes:
    """The records in a chunk, uncompressed."""
    file.seek(chunk.chunk_start_offset)
    data = file.read(chunk.chunk_length)
    begin = _FRAME.size + _CHUNK.size + 4 + len(chunk.compression) + 8
    if len(data) < chunk.chunk_length or begin + chunk.compressed_size > len(data):
        raise ReaderError(f"Truncated chunk at offset {chunk.chunk_start_offset}.")
    *_, size, checksum = _CHUNK.unpack_from(data, _FRAME.size)
    records = _uncompressed(data[begin : begin + chunk.compressed_size], chunk.compression, size)
    if len(records) != size:
        raise ReaderError(f"Chunk size mismatch: expected {size} bytes, got {len(records)}.")
    if checksum and zlib.crc32(records) != checksum:
        raise ReaderError("Chunk checksum mismatch.")
    return records


def _uncompressed(data: bytes, compression: str, size: int) -> bytes:
    if compression == "zstd":
        return bytes(zstandard.ZstdDecompressor().decompress(data, max_output_size=size))
    if compression == "lz4":
        return bytes(lz4.frame.decompress(data))
    if compression:
        raise ReaderError(f"Unsupported chunk compression {compression!r}.")
    return data
