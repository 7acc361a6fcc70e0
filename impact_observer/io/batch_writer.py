"""Messages into an MCAP file, many at a time.

``rosbags`` makes the record of each message from seven small writes. Here those of many messages
are joined at once and handed to its open chunk, so that the file is the same in every byte.
"""

from bisect import bisect_right
from collections import Counter
from collections.abc import Sequence
from itertools import accumulate, chain, repeat
from typing import Any, TypeAlias

from rosbags.interfaces import Connection
from rosbags.rosbag2 import Writer

from impact_observer.io.mcap_layout import FRAMED_MESSAGE, MESSAGE, MESSAGE_OPCODE

Item: TypeAlias = tuple[Connection, int, bytes]
"""A message: its topic, its log time (ns), its bytes."""

_FULL = 2**20
"""Bytes with which ``rosbags`` closes a chunk."""
_OF_STORAGE = ("channel_stats", "close_chunk", "message_start_time", "message_end_time")
_OF_CHUNK = ("bio", "msgs", "message_start_time", "message_end_time")
_OF_WRITER = ("counts", "min_timestamp", "max_timestamp")


def write_together(writer: Writer, items: Sequence[Item]) -> None:
    """What ``writer.write`` does for one message, for many.

    Args:
        writer: open, of an MCAP file.
        items: in the order in which they are to be written.
    """
    if not _is_known(writer):
        for item in items:
            writer.write(*item)
        return
    while items:
        items = items[_take(writer, items) :]


def _is_known(writer: Writer) -> bool:
    """Whether this version of ``rosbags`` keeps its open chunk as we know it."""
    storage = writer.storage
    chunk = getattr(storage, "chunk", None)
    wanted = ((writer, _OF_WRITER), (storage, _OF_STORAGE), (chunk, _OF_CHUNK))
    return all(hasattr(each, name) for each, names in wanted for name in names)


def _take(writer: Writer, items: Sequence[Item]) -> int:
    """Add as many messages as come into the open chunk; how many these are."""
    storage: Any = writer.storage
    chunk = storage.chunk
    connections, times, data = zip(*items, strict=True)
    sizes = [len(each) for each in data]
    ends = [*accumulate((size + FRAMED_MESSAGE.size for size in sizes), initial=chunk.bio.tell())]
    # The message with which it is full is the last one in it.
    count = min(bisect_right(ends, _FULL, lo=1), len(items))
    numbers, times = [each.id for each in connections[:count]], times[:count]
    lengths = [size + MESSAGE.size for size in sizes]
    heads = map(
        FRAMED_MESSAGE.pack, repeat(MESSAGE_OPCODE), lengths, numbers, repeat(0), times, times
    )
    chunk.bio.write(b"".join(chain.from_iterable(zip(heads, data, strict=False))))
    for number, place in zip(numbers, zip(times, ends, strict=False), strict=False):
        chunk.msgs[number].append(place)
    _note(writer, numbers, min(times), max(times))
    if ends[count] > _FULL:
        storage.close_chunk()
    return count


def _note(writer: Writer, numbers: Sequence[int], first: int, last: int) -> None:
    """What the index and the metadata will say of more messages."""
    storage: Any = writer.storage
    for each in (storage, storage.chunk):
        each.message_start_time = min(first, each.message_start_time)
        each.message_end_time = max(last, each.message_end_time)
    writer.min_timestamp = min(first, writer.min_timestamp)
    writer.max_timestamp = max(last, writer.max_timestamp)
    for number, count in Counter(numbers).items():
        storage.channel_stats[number] += count
        writer.counts[number] += count
