"""Reading the messages of an indexed MCAP file, chunk by chunk.

This is faster than ``rosbags``, which reads each message in eight steps: here one step is enough.
The order is that of ``rosbags``: by log time, then by position in the file.
"""

import heapq
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from operator import itemgetter
from pathlib import Path
from typing import BinaryIO, TypeAlias

from mcap.records import ChunkIndex
from mcap.summary import Summary
from rosbags.rosbag2 import ReaderError

from impact_observer.io.mcap_layout import (
    CHUNK,
    COMPRESSIONS,
    FRAME,
    FRAMED_MESSAGE,
    LOGGED,
    MESSAGE,
    MESSAGE_OPCODE,
    summary_of,
    uncompressed,
)

Message: TypeAlias = tuple[int, str, bytes]
"""Log time (ns), topic, bytes."""
_Load: TypeAlias = "Callable[[ChunkIndex], list[Message]]"


def index_of(path: Path) -> Summary | None:
    """The index of an MCAP file; None if it has none, or one without positions of messages."""
    with path.open("rb") as file:
        summary = summary_of(file)  # if it cannot be read, rosbags reports why
    if summary is None or summary.statistics is None or not summary.chunk_indexes:
        return None
    complete = all(chunk.message_index_offsets for chunk in summary.chunk_indexes)
    return summary if complete else None


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
    """The messages of ``chunks``; chunks that overlap in time are merged."""
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
    """The messages of ``chunks``, each of which is loaded when its first message is due."""
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
    """The messages of some channels in ``records``, by log time."""
    found: list[Message] = []
    size, at = len(records), 0
    padded = records + bytes(LOGGED.size)  # the last record may be shorter than a message
    unpack, frame, before = LOGGED.unpack_from, FRAME.size, FRAMED_MESSAGE.size
    while at < size:
        opcode, length, channel, _, log_time = unpack(padded, at)
        end = at + frame + length
        if opcode == MESSAGE_OPCODE and channel in topics and log_time >= start:
            if length < MESSAGE.size:
                break
            found.append((log_time, topics[channel], records[at + before : end]))
        at = end
    if at != size:
        raise ReaderError("A record reaches beyond the end of its chunk.")
    found.sort(key=itemgetter(0))
    return found


def _records(file: BinaryIO, chunk: ChunkIndex) -> bytes:
    """The records in a chunk, uncompressed."""
    file.seek(chunk.chunk_start_offset)
    data = file.read(chunk.chunk_length)
    begin = FRAME.size + CHUNK.size + 4 + len(chunk.compression) + 8
    if len(data) < chunk.chunk_length or begin + chunk.compressed_size > len(data):
        raise ReaderError(f"Truncated chunk at offset {chunk.chunk_start_offset}.")
    *_, size, checksum = CHUNK.unpack_from(data, FRAME.size)
    if chunk.compression not in COMPRESSIONS:
        raise ReaderError(f"Unsupported chunk compression {chunk.compression!r}.")
    records = uncompressed(data[begin : begin + chunk.compressed_size], chunk.compression, size)
    if len(records) != size:
        raise ReaderError(f"Chunk size mismatch: expected {size} bytes, got {len(records)}.")
    if checksum and zlib.crc32(records) != checksum:
        raise ReaderError("Chunk checksum mismatch.")
    return records
