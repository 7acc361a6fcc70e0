# SPDX-License-Identifier: Apache-2.0
"""Chunks of MCAP files without their compression, of a bounded size."""

from dataclasses import replace
from io import BytesIO

import zstandard
from lz4.frame import LZ4FrameDecompressor
from mcap.records import Chunk
from rosbags.rosbag2 import ReaderError, storage_mcap

MOST_BYTES = 2**30
"""Largest chunk that is decompressed. Recorders end one after some megabytes."""


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
        return bytes(zstandard.ZstdDecompressor().stream_reader(BytesIO(data)).read(size + 1))
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


def bound_rosbags() -> None:
    """Have the library ``rosbags`` decompress chunks by :func:`decompressed`."""
    storage_mcap.DECOMPRESSORS.update(
        zstd=lambda data, size: decompressed(data, "zstd", size),
        lz4=lambda data, size: decompressed(data, "lz4", size),
    )
