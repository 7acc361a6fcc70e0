# SPDX-License-Identifier: Apache-2.0
"""Chunks of MCAP files and messages without their compression, of a bounded size."""

from dataclasses import replace
from types import SimpleNamespace

from lz4.frame import LZ4FrameDecompressor
from mcap.records import Chunk
from rosbags.rosbag2 import ReaderError, reader, storage_mcap

zstd = vars(reader)["zstd"]
"""The library by which rosbags decompresses."""
MOST_BYTES = 2**30
"""Largest chunk or message that is decompressed. Recorders end a chunk after some megabytes."""


def decompressed(data: bytes, compression: str, size: int) -> bytes:
    """The bytes of a chunk, one more than ``size`` at most.

    Args:
        data: as they stand in the file.
        compression: ``zstd``, ``lz4`` or empty.
        size: bytes that the file declares.

    Raises:
        ReaderError: the file declares more than ``MOST_BYTES``.
    """
    if compression and size > MOST_BYTES:
        raise ReaderError(
            f"a chunk of {len(data)} bytes declares {size} bytes without its compression; expected"
            f" at most {MOST_BYTES}"
        )
    if compression == "zstd":
        return bytes(zstd.ZstdDecompressor().decompress(data, size + 1))
    if compression == "lz4":
        return bytes(LZ4FrameDecompressor().decompress(data, max_length=size + 1))
    return data


def plain(chunk: Chunk) -> Chunk:
    """A chunk without its compression.

    Raises:
        ReaderError: it declares too many bytes.
        ValueError: it has others than it declares, or another compression.
    """
    if chunk.compression not in ("", "zstd", "lz4"):
        raise ValueError(f"has the compression {chunk.compression!r}; expected zstd, lz4 or none")
    data = decompressed(chunk.data, chunk.compression, chunk.uncompressed_size)
    if chunk.compression and len(data) != chunk.uncompressed_size:
        raise ValueError(f"has other than its {chunk.uncompressed_size} bytes")
    return replace(chunk, compression="", data=data)


def decompressed_message(data: bytes) -> bytes:
    """The bytes of a message that rosbag2 has compressed by zstd.

    Raises:
        ReaderError: the message is damaged, or has more than ``MOST_BYTES``.
    """
    stream = zstd.ZstdDecompressor()
    try:
        found = bytes(stream.decompress(data, MOST_BYTES + 1))
    except zstd.ZstdError as error:
        raise ReaderError(f"the compression of a message is damaged: {error}") from error
    if len(found) > MOST_BYTES:
        raise ReaderError(
            f"a message of {len(data)} bytes has more than {MOST_BYTES} without its compression"
        )
    if not stream.eof:
        raise ReaderError(f"the compression of a message of {len(data)} bytes has no end")
    return found


def bound_rosbags() -> None:
    """Have the library ``rosbags`` decompress chunks and messages by the functions above."""
    bounded = SimpleNamespace(open=zstd.open, decompress=decompressed_message)
    vars(reader).update(zstd=bounded)
    storage_mcap.DECOMPRESSORS.update(
        zstd=lambda data, size: decompressed(data, "zstd", size),
        lz4=lambda data, size: decompressed(data, "lz4", size),
    )
