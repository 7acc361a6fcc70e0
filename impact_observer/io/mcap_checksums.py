# SPDX-License-Identifier: Apache-2.0
"""The checksums of an MCAP file beside those of its chunks: of the index, and of all before it.

The library ``mcap`` reads neither; https://mcap.dev/spec has the layout.
"""

import struct
from pathlib import Path
from typing import BinaryIO
from zlib import crc32

from mcap.reader import make_reader

from impact_observer.io.foreign_files import bag_files

_FOOTER, _DATA_END = struct.Struct("<BQQQI8s"), struct.Struct("<BQI")
_CHUNK_CHECKSUM = 9 + 24
"""Where the checksum of a chunk is, from the beginning of its record."""
_BLOCK = 2**20


def mcap_files(bag: Path) -> list[Path]:
    """The MCAP files of a bag that are not compressed as a whole: its folder's, or the bag."""
    return [each for each in bag_files(bag) if each.suffix == ".mcap"]


def index_is_damaged(file: BinaryIO) -> bool:
    """Whether the index of an MCAP file has a checksum that does not match.

    A file that was cut short has no index, and so no checksum.
    """
    size = file.seek(0, 2)
    if size < _FOOTER.size:
        return False
    file.seek(size - _FOOTER.size)
    opcode, length, summary, _, checksum, _ = _FOOTER.unpack(file.read())
    if (opcode, length) != (0x02, 20) or checksum == 0:
        return False
    begin, end = summary or size - _FOOTER.size, size - 12
    return begin > end or _checksum(file, begin, end) != checksum


def data_are_damaged(file: BinaryIO) -> bool:
    """Whether what is before the index of a whole MCAP file does not match its checksum.

    The messages have checksums of their own, by chunks.
    """
    size = file.seek(0, 2)
    file.seek(max(size - _FOOTER.size, 0))
    if len(footer := file.read()) < _FOOTER.size:
        return False
    begin = (_FOOTER.unpack(footer)[2] or size - _FOOTER.size) - _DATA_END.size
    if not 0 < begin < size:
        return True
    file.seek(begin)
    opcode, length, checksum = _DATA_END.unpack(file.read(_DATA_END.size))
    if (opcode, length) != (0x0F, 4):
        return True
    return bool(checksum) and _checksum(file, 0, begin) != checksum


def chunks_without_checksum(file: BinaryIO) -> tuple[int, int]:
    """Number of chunks in the index of a whole MCAP file, and how many have no checksum."""
    file.seek(0)
    summary = make_reader(file).get_summary()
    chunks = [] if summary is None else summary.chunk_indexes
    unchecked = 0
    for each in chunks:
        file.seek(each.chunk_start_offset + _CHUNK_CHECKSUM)
        unchecked += file.read(4) == bytes(4)
    return len(chunks), unchecked


def _checksum(file: BinaryIO, begin: int, end: int) -> int:
    """The CRC-32 of the bytes from ``begin`` to ``end``."""
    file.seek(begin)
    checksum, left = 0, end - begin
    while left > 0 and (data := file.read(min(left, _BLOCK))):
        checksum, left = crc32(data, checksum), left - len(data)
    return checksum
