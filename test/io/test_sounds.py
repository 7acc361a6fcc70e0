# SPDX-License-Identifier: Apache-2.0
"""Sounds as killed recorders, pipes and broken disks leave them."""

import struct
from pathlib import Path

import numpy as np
import pytest
import soundfile

from impact_observer.cli.main import main
from impact_observer.errors import UsageError
from impact_observer.io import BagReader
from impact_observer.io.recordings import events_in
from impact_observer.io.signals import read_signal
from impact_observer.states import Vector

RATE = 8000
TIMES = np.arange(RATE) / RATE
HITS = {0.2525: 0.8, 0.7025: 0.6}
SIGNAL: Vector = np.sum(
    [
        np.where(np.abs(TIMES - at) <= 0.0025, height * np.cos(np.pi * (TIMES - at) / 0.005), 0.0)
        for at, height in HITS.items()
    ],
    axis=0,
)
"""Half-sines of 5 ms, in parts of full scale."""
PCM, FLOAT, EXTENSIBLE, IMA_ADPCM = 1, 3, 0xFFFE, 0x11
NO_SIZE = 0xFFFFFFFF
GUID = b"\x01\x00\x00\x00\x00\x00\x10\x00\x80\x00\x00\xaa\x00\x38\x9b\x71"


def pcm(bits: int, order: str = "<") -> bytes:
    """The signal as integers."""
    if bits == 8:
        return np.round(128 + 127 * SIGNAL).astype(np.uint8).tobytes()
    if bits == 24:
        whole = np.round(8388607 * SIGNAL).astype("<i4").tobytes()
        return b"".join(whole[k : k + 3] for k in range(0, len(whole), 4))
    return np.round(32767 * SIGNAL).astype(f"{order}i2").tobytes()


def chunk(name: bytes, data: bytes, size: int | None = None, order: str = "<") -> bytes:
    """A chunk; ``size`` is that of its header, where this is wrong."""
    return name + struct.pack(f"{order}I", len(data) if size is None else size) + data


def shape(
    kind: int,
    bits: int,
    extra: bytes = b"",
    *,
    channels: int = 1,
    rate: int = RATE,
    order: str = "<",
) -> bytes:
    """The chunk that says the format of the samples."""
    frame = channels * bits // 8
    numbers = kind, channels, rate, rate * frame, frame, bits
    return chunk(b"fmt ", struct.pack(f"{order}HHIIHH", *numbers) + extra, order=order)


def riff(*chunks: bytes, size: int | None = None, magic: bytes = b"RIFF") -> bytes:
    """A WAV file of these chunks."""
    return chunk(magic, b"WAVE" + b"".join(chunks), size, ">" if magic == b"RIFX" else "<")


def samples(data: bytes, size: int | None = None) -> bytes:
    """The chunk of the samples."""
    return chunk(b"data", data, size)


D16, F16 = pcm(16), shape(PCM, 16)
PLAIN = riff(F16, samples(D16))
STEREO = riff(
    shape(PCM, 16, channels=2), samples(np.repeat(np.frombuffer(D16, "<i2"), 2).tobytes())
)
DS64 = chunk(b"ds64", struct.pack("<QQQI", len(D16) + 100, len(D16), RATE, 0))
WITH_NAN = np.where(np.arange(RATE) % 7 == 0, np.nan, SIGNAL).astype("<f4")
READ: dict[str, tuple[bytes, int, str]] = {
    "plain": (PLAIN, 8000, ""),
    "pcm8": (riff(shape(PCM, 8), samples(pcm(8))), 8000, ""),
    "pcm24": (riff(shape(PCM, 24), samples(pcm(24))), 8000, ""),
    "extensible": (
        riff(shape(EXTENSIBLE, 24, struct.pack("<HHI", 22, 24, 4) + GUID), samples(pcm(24))),
        8000,
        "",
    ),
    "float": (riff(shape(FLOAT, 32), samples(SIGNAL.astype("<f4").tobytes())), 8000, ""),
    "double": (riff(shape(FLOAT, 64), samples(SIGNAL.astype("<f8").tobytes())), 8000, ""),
    "not_a_number": (
        riff(shape(FLOAT, 32), samples(WITH_NAN.tobytes())),
        8000,
        "1143 of 8000 frames of channel1 left out (14 %)",
    ),
    "pipe": (riff(F16, samples(D16, NO_SIZE), size=NO_SIZE), 8000, "the 8000 frames"),
    "arecord": (riff(F16, samples(D16, 0x7FFFFFFF - 36), size=0x7FFFFFFF), 8000, "8000 frames"),
    "cut": (PLAIN[:-3001], 6499, "the 6499 frames"),
    "cut24": (riff(shape(PCM, 24), samples(pcm(24)))[:-3001], 6999, "the 6999 frames"),
    "cut_stereo": (STEREO[:-3002], 7249, "the 7249 frames"),
    "broadcast": (
        riff(
            chunk(b"bext", bytes(602)),
            F16,
            chunk(b"LIST", b"INFOx") + b"\0",
            samples(D16),
            chunk(b"junk", b"abc"),
        ),
        8000,
        "",
    ),
    "rf64": (riff(DS64, F16, samples(D16, NO_SIZE), size=NO_SIZE, magic=b"RF64"), 8000, ""),
    "cut_rf64": (
        riff(DS64, F16, samples(D16, NO_SIZE), size=NO_SIZE, magic=b"RF64")[:-3000],
        6500,
        "the 6500 frames",
    ),
    "big_endian": (
        riff(shape(PCM, 16, order=">"), chunk(b"data", pcm(16, ">"), order=">"), magic=b"RIFX"),
        8000,
        "",
    ),
}
"""Files, the number of their frames, and what is said to be missing."""
MENDS, CONVERTS = "NEW.wav` mends it", "NEW.wav` converts"
REFUSED = {
    "empty": (b"", CONVERTS),
    "cut_riff": (b"RIFF\0", CONVERTS),
    "cut_in_format": (PLAIN[:30], CONVERTS),
    "cut_in_size": (PLAIN[:42], MENDS),
    "no_samples": (riff(F16), CONVERTS),
    "header_only": (riff(F16, samples(b"")), MENDS),
    "killed": (riff(F16, samples(D16, 0), size=0), MENDS),
    "killed_after_junk": (
        riff(chunk(b"JUNK", bytes(4044)), F16, samples(D16, 0), size=4088),
        MENDS,
    ),
    "rate_0": (riff(shape(PCM, 16, rate=0), samples(D16)), CONVERTS),
    "channels_0": (riff(shape(PCM, 16, channels=0), samples(D16)), CONVERTS),
    "adpcm": (riff(shape(IMA_ADPCM, 4), samples(D16)), CONVERTS),
    "mp4": (b"\0\0\0 ftypM4A " + bytes(100), CONVERTS),
    "avi": (riff(F16, samples(D16)).replace(b"WAVE", b"AVI "), CONVERTS),
}
"""Files of which nothing can be read, and the remedy that is named."""


@pytest.mark.parametrize("name", READ)
def test_all_frames_that_are_there_are_read(tmp_path: Path, name: str) -> None:
    """The samples are those of the signal to the resolution of their format."""
    data, frames, said = READ[name]
    path = tmp_path / "hits.wav"
    path.write_bytes(data)
    sound = read_signal(path)
    assert [*sound.columns] == ["channel1", "channel2"][: 1 + (name == "cut_stereo")]
    for values in sound.columns.values():
        assert np.count_nonzero(np.isnan(values)) == (1143 if name == "not_a_number" else 0)
        expected = np.where(np.isnan(values), np.nan, SIGNAL[:frames])
        resolution = 2.0**-6 if name == "pcm8" else 2.0**-14
        np.testing.assert_allclose(values, expected, atol=resolution)
    np.testing.assert_array_equal(sound.stamps, 10**9 + 125_000 * np.arange(frames))
    remarks = (*sound.remarks, *sound.omissions.values())
    assert len(remarks) == bool(said)
    assert said in "".join(remarks)


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_read_is_one_line_with_the_tool_that_mends_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    """The line names the file; no bag is made."""
    data, remedy = REFUSED[name]
    path, output = tmp_path / "hits.wav", tmp_path / "bag"
    path.write_bytes(data)
    given = ["--contact", "stop", "--threshold", "0.1", "-o", str(output)]
    assert main(["detect", str(path), *given]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"impact-observer: {path}: ")
    assert f"`ffmpeg -i {path} {remedy}" in line
    assert not output.exists()


@pytest.mark.parametrize("name", ["plain", "cut", "rf64", "not_a_number"])
def test_hits_of_a_sound_are_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    """What is missing, or is no number, is a warning with its count."""
    data, _, said = READ[name]
    path, output = tmp_path / "hits.wav", tmp_path / "bag"
    path.write_bytes(data)
    given = ["--contact", "stop", "--threshold", "0.1", "-o", str(output)]
    assert main(["detect", str(path), *given]) == 0
    with BagReader(output) as reader:
        stamps = [each.stamp * 1e-9 - 1 for each in events_in(reader)]
    np.testing.assert_allclose(stamps, [*HITS], atol=1.5 / RATE)
    printed = capsys.readouterr().out
    assert ("warning: " in printed) is bool(said)
    assert said in printed


@pytest.mark.parametrize(
    ("name", "resolution"), [("hits.flac", 2.0**-15), ("hits.ogg", 0.1)], ids=["flac", "ogg"]
)
def test_coded_sounds_are_read(tmp_path: Path, name: str, resolution: float) -> None:
    """FLAC is exact to its 16 bits; OGG is lossy, here to a tenth of full scale."""
    soundfile.write(tmp_path / name, np.column_stack([SIGNAL, -SIGNAL]), RATE)
    sound = read_signal(tmp_path / name)
    read = [*sound.columns.values()]
    np.testing.assert_allclose(read, [SIGNAL, -SIGNAL], atol=resolution)
    assert sound.stamps[-1] == 10**9 + 125_000 * (RATE - 1)


def test_a_coded_sound_that_is_cut_is_read_up_to_its_end(tmp_path: Path) -> None:
    """What is missing is said; a file that is no sound is one line."""
    path, noise = tmp_path / "noise.flac", np.random.default_rng(1).uniform(-0.5, 0.5, 9 * RATE)
    soundfile.write(path, noise, RATE)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    sound = read_signal(path)
    read = sound.columns["channel1"]
    assert 0.4 * noise.size < read.size < 0.6 * noise.size
    np.testing.assert_allclose(read, noise[: read.size], atol=2.0**-15)
    (said,) = sound.remarks
    assert f"{noise.size - read.size} of {noise.size} frames are missing" in said
    path.write_bytes(b"no sound")
    with pytest.raises(UsageError, match="no sound"):
        read_signal(path)
