# SPDX-License-Identifier: Apache-2.0
"""A sound in a file: WAV, also where its header is wrong or its end is missing; FLAC and OGG."""

import struct
from collections.abc import Iterator
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.io import wavfile

from impact_observer.errors import UsageError
from impact_observer.input_files import check_input, open_input
from impact_observer.io.wav_header import Wav, missing, read_header
from impact_observer.states import Matrix

_AT_ONCE = 2**16
"""Frames that are decoded together."""
_CODED_AT_ONCE = 2**10
"""The same of FLAC and OGG: at a place that cannot be decoded they are lost together."""
_UNKNOWN = 2**62
"""Numbers of frames from here on stand for an unknown one."""


class SoundFile:
    """A sound, to be read from beginning to end.

    Attributes:
        channels: how many there are.
        rate: frames a second, Hz. A frame has one sample of each channel.
        remarks: how many frames are missing, a line; complete after the last frame.
    """

    def __init__(self, path: Path) -> None:
        """Open ``path``, a WAV if its suffix says so, else what ``soundfile`` reads.

        Raises:
            UsageError: the file cannot be read, or has no frame; or ``soundfile`` is missing.
        """
        self._path = path
        self.remarks: list[str] = []
        self._wav: Wav | None = None
        if path.suffix.lower() != ".wav":
            self._open_coded()
            return
        try:
            with open_input(path) as stream:
                self._wav = wav = read_header(path, stream)
        except OSError as error:
            raise UsageError(f"{path}: cannot be read: {error.strerror}") from None
        self.channels, self.rate = wav.channels, wav.rate
        if wav.remark:
            self.remarks.append(f"{path}: {wav.remark}")
        next(self.blocks())

    def blocks(self) -> Iterator[Matrix]:
        """Samples as parts of full scale, shape (channels, frames), some frames at a time.

        Raises:
            UsageError: the samples cannot be decoded.
        """
        return self._coded_blocks() if self._wav is None else self._wav_blocks(self._wav)

    def _wav_blocks(self, wav: Wav) -> Iterator[Matrix]:
        """Blocks of a WAV; a header that is right is put before each."""
        rate = wav.frame, wav.frame * wav.frame  # of frames and bytes; scipy compares them
        shape = struct.pack(
            f"{wav.order}IHHIIHH", 16, wav.kind, wav.channels, *rate, wav.frame, wav.bits
        )
        with open_input(self._path) as stream:
            stream.seek(wav.begin)
            for first in range(0, wav.frames, _AT_ONCE):
                data = stream.read(wav.frame * min(_AT_ONCE, wav.frames - first))
                size, whole = (struct.pack(f"{wav.order}I", len(data) + k) for k in (0, 36))
                magic = b"RIFF" if wav.order == "<" else b"RIFX"
                text = magic + whole + b"WAVEfmt " + shape + b"data" + size + data
                try:
                    _, samples = wavfile.read(BytesIO(text))
                except Exception as error:  # noqa: BLE001 (scipy raises anything)
                    raise UsageError(f"{self._path}: cannot be decoded: {error}") from None
                yield _of_full_scale(np.atleast_2d(samples.T))

    def _open_coded(self) -> None:
        try:
            soundfile = _soundfile()
        except (ImportError, OSError) as error:  # also where its library is missing
            raise UsageError(
                f"{self._path}: FLAC and OGG need soundfile ({error}); pip install soundfile, or"
                " impact_observer[sound]"
            ) from None
        check_input(self._path)
        try:
            with soundfile.SoundFile(self._path) as sound:
                self.channels, self.rate = sound.channels, sound.samplerate
        except (OSError, RuntimeError) as error:
            raise UsageError(f"{self._path}: is no sound that can be read: {error}") from None

    def _coded_blocks(self) -> Iterator[Matrix]:
        """Blocks of a FLAC or OGG, up to a place that cannot be decoded."""
        done, broken = 0, ""
        with _soundfile().SoundFile(self._path) as sound:
            total = int(sound.frames)
            try:
                while (block := sound.read(_CODED_AT_ONCE, always_2d=True)).size:
                    done += len(block)
                    yield block.T
            except RuntimeError as error:
                broken = str(error)
        if not done:
            raise UsageError(f"{self._path}: holds no frame that can be decoded; {broken}")
        if done < total < _UNKNOWN:
            broken = missing(total - done, total, self.rate)
        if broken:
            self.remarks.append(f"{self._path}: is cut or damaged: {broken}")


def _soundfile() -> Any:  # noqa: ANN401 (a module that need not be installed)
    """The module of FLAC and OGG."""
    return import_module("soundfile")


def _of_full_scale(samples: NDArray[Any]) -> Matrix:
    """Samples of a sound as parts of the largest that its format has."""
    if samples.dtype.kind == "f":
        return samples.astype(float)
    half = 2.0 ** (8 * samples.itemsize - 1)
    return (samples - (half if samples.dtype.kind == "u" else 0.0)) / half
