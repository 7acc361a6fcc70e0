# SPDX-License-Identifier: Apache-2.0
"""The layout of MCAP files (https://mcap.dev/spec): records, chunks, the index.

A record is an opcode, a length and as many bytes.
"""

import struct
from typing import BinaryIO

import lz4.frame
import zstandard
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.summary import Summary

MAGIC = b"\x89MCAP0\r\n"
"""How a file begins."""
FRAME = struct.Struct("<BQ")
"""Opcode and length of a record."""
MESSAGE = struct.Struct("<HIQQ")
"""Channel, sequence, log and publish time of a message, before its bytes."""
LOGGED = struct.Struct("<BQHIQ")
"""``FRAME`` and ``MESSAGE`` at once, up to the log time: chunks are read faster."""
MESSAGE_OPCODE = int(Opcode.MESSAGE)  # an int compares faster than the enumeration
CHUNK = struct.Struct("<QQQI")
"""First and last log time, uncompressed size, checksum of a chunk, before its records."""


def summary_of(file: BinaryIO) -> Summary | None:
    """The index at the end of an MCAP file; None if it is missing or cannot be read."""
    file.seek(0)
    try:
        return make_reader(file).get_summary()
    except Exception:  # noqa: BLE001 (anything, in a damaged file)
        return None


def uncompressed(data: bytes, compression: str) -> bytes:
    """The records of a chunk; as many as there are if ``data`` is cut short.

    Raises:
        ValueError: no such compression.
        Exception: the decompressor's own, for broken data.
    """
    if compression == "zstd":
        return bytes(zstandard.ZstdDecompressor().decompressobj().decompress(data))
    if compression == "lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data))
    if compression:
        raise ValueError(f"unknown compression {compression}")
    return data
