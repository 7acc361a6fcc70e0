# SPDX-License-Identifier: Apache-2.0
"""The header of a WAV file, compared with the file: recorders write its sizes at their end."""

import struct
from pathlib import Path
from typing import BinaryIO, NamedTuple

from impact_observer.errors import UsageError

_NO_SIZE = 0x7FFF0000
"""Sizes from here on, bytes, that a file does not have were never written: 0x7FFFFFFF and such."""
PCM, FLOAT, _EXTENSIBLE = 1, 3, 0xFFFE
_SIZES = {PCM: range(1, 9), FLOAT: (4, 8)}
"""Bytes of a sample of one channel."""
_FORMATS = {2: "ADPCM", 6: "A-law", 7: "mu-law", 0x11: "IMA ADPCM", 0x55: "MP3"}
"""Names of other formats of samples, by their number in the header."""
_OTHERS = {b"fLaC": "FLAC", b"OggS": "OGG", b"ID3": "MP3", b"\xff\xfb": "MP3", b"FORM": "AIFF"}
"""Names of other files by their first bytes."""
_MAGIC = (b"RIFF", b"RIFX", b"RF64", b"BW64")
_CONVERT = "`ffmpeg -i FILE NEW.wav` converts it"


class Wav(NamedTuple):
    """Where the samples of a WAV file are, and their format.

    Attributes:
        order: of bytes, ``<`` or ``>``.
        kind: ``PCM`` or ``FLOAT``.
        channels: at least 1.
        rate: frames a second, at least 1.
        frame: bytes of a frame.
        bits: of a sample.
        begin: place of the first frame in the file.
        frames: how many whole frames there are.
        remark: how many are missing; empty if none is.
    """

    order: str
    kind: int
    channels: int
    rate: int
    frame: int
    bits: int
    begin: int
    frames: int
    remark: str


def read_header(path: Path, stream: BinaryIO) -> Wav:
    """Where the samples of a WAV file are, however far its header is right.

    Args:
        path: named in errors.
        stream: of the file.

    Raises:
        UsageError: the file is no WAV, is cut inside its header, or has no frame that can be read.
    """
    file_size = stream.seek(0, 2)
    stream.seek(0)
    head = stream.read(12)
    if problem := _other_file(head):
        raise UsageError(f"{path}: {problem}")
    order = ">" if head.startswith(b"RIFX") else "<"
    parts = _parts(path, stream, order, file_size)
    kind, channels, rate, frame, bits = _format(path, parts.shape, order)
    there = file_size - parts.begin
    size, remark = parts.size, ""
    is_empty = size == 0 and not _is_chunk(stream, parts.begin, file_size)
    if there and (is_empty or (size > there and (_NO_SIZE <= size < 2**32 or size >= 2**63))):
        frames = there // frame
        remark = (
            f"its header has no size, as a recorder leaves it that was killed or wrote to a pipe:"
            f" all {frames} frames up to the end of the file are read"
        )
        remark += "; the last frame is cut, and left out" if there % frame else ""
    else:
        frames = min(size, there) // frame
        if frames < size // frame:
            remark = f"is cut: {missing(size // frame - frames, size // frame, rate)}"
    if not frames:
        problem = f"holds no frame: nothing whole follows its header of {parts.begin} bytes"
        raise UsageError(f"{path}: {problem}")
    return Wav(order, kind, channels, rate, frame, bits, parts.begin, frames, remark)


def missing(count: int, total: int, rate: int) -> str:
    """Words for the frames that are missing at the end of a sound."""
    part = f"{count} of {total} frames are missing ({100 * count / total:.2g} %)"
    return f"{part}, the last {count / rate:.3g} s"


def _other_file(head: bytes) -> str:
    """What a file is by its first 12 bytes; empty if they are those of a WAV, whole or cut."""
    if not head:
        return "is empty; expected a WAV file"
    for first, name in _OTHERS.items():
        if head.startswith(first):
            is_read = name in ("FLAC", "OGG")
            return f"is {name}, no WAV file; {f'name it .{name.lower()}' if is_read else _CONVERT}"
    if head[4:8] == b"ftyp":
        return f"is MP4, no WAV file; {_CONVERT}"
    if head[:4] not in _MAGIC or head[8:] not in (b"WAVE", b""):
        return f"is no WAV file that can be read; {_CONVERT} if it is a sound"
    return ""


class _Parts(NamedTuple):
    """What the chunks of a header say.

    Attributes:
        shape: the chunk of the format; empty if there is none.
        begin: place of the first sample.
        size: of the samples, bytes, as declared.
    """

    shape: bytes
    begin: int
    size: int


def _parts(path: Path, stream: BinaryIO, order: str, file_size: int) -> _Parts:
    """Read the chunks up to the samples."""
    shape, size_64, at = b"", 0, 12
    while True:
        stream.seek(at)
        chunk = stream.read(8)
        if len(chunk) < 8:
            is_cut = at != file_size or not shape
            problem = "is cut inside its header" if is_cut else "has no samples (no data chunk)"
            raise UsageError(f"{path}: {problem}; nothing can be read")
        size = int.from_bytes(chunk[4:], "little" if order == "<" else "big")
        if chunk[:4] == b"data":
            return _Parts(shape, at + 8, size_64 if size_64 and size == 0xFFFFFFFF else size)
        if chunk[:4] == b"fmt ":
            shape = stream.read(min(size, 40))
        elif chunk[:4] == b"ds64":
            size_64 = int.from_bytes(stream.read(16)[8:], "little")
        at += 8 + size + size % 2


def _format(path: Path, shape: bytes, order: str) -> tuple[int, int, int, int, int]:
    """Kind, channels, rate, bytes of a frame and bits of a sample, by the chunk of the format."""
    if len(shape) < 16:
        raise UsageError(f"{path}: has no format of its samples (no fmt chunk) before them")
    kind, channels, rate, _, frame, bits = struct.unpack(f"{order}HHIIHH", shape[:16])
    if kind == _EXTENSIBLE and len(shape) >= 26:
        (kind,) = struct.unpack(f"{order}H", shape[24:26])
    if kind not in (PCM, FLOAT):
        name = _FORMATS.get(kind, f"of the format {kind:#x}")
        expected = f"expected PCM or floating point; {_CONVERT}"
        raise UsageError(f"{path}: its samples are {name}; {expected}")
    if not (channels and rate and frame):
        found = f"{channels} channels, {rate} Hz and {frame} bytes a frame"
        raise UsageError(f"{path}: its header says {found}; expected more than 0 of each")
    size = frame // channels
    if frame % channels or size not in _SIZES[kind] or not 0 < bits <= 8 * size:
        found = f"{channels} channels of {bits} bits in {frame} bytes a frame"
        expected = f"{_SIZES[kind][0]} to {_SIZES[kind][-1]} bytes a channel"
        raise UsageError(f"{path}: its header says {found}; expected {expected}")
    return kind, channels, rate, frame, bits


def _is_chunk(stream: BinaryIO, at: int, file_size: int) -> bool:
    """Whether another chunk begins at a place, and not samples."""
    stream.seek(at)
    chunk = stream.read(8)
    fits = at + 8 + int.from_bytes(chunk[4:], "little") <= file_size
    return len(chunk) == 8 and chunk[:4].isascii() and chunk[:4].decode().isprintable() and fits
