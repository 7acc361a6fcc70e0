# SPDX-License-Identifier: Apache-2.0
"""Dead times: what they suppress is counted and said, and ringing is told from impacts."""

from pathlib import Path

import numpy as np
import pytest

from impact_observer.cli.main import main
from impact_observer.io import BagReader
from impact_observer.io.recordings import events_in
from impact_observer.states import Vector

RATE, RING, DECAY = 10_000, 2300.0, 0.003
SECOND = 1_000_000_000
HITS = np.concatenate(
    [
        [k / 10, k / 10 + gap]
        for k, gap in enumerate((0.0136, 0.0151, 0.0174, 0.0142, 0.0363, 0.0411), start=1)
    ]
) + 0.00003 * np.arange(12)
"""Pairs of hits, s; four of six second ones follow within 20 ms."""
SPEEDS = np.where(np.arange(12) % 2, 110.0, 230.0)


def anvil(path: Path) -> Path:
    """A table of an anvil that rings at 2.3 kHz, m/s^2, as in a recording of a drill."""
    t = np.arange(0, 0.8, 1 / RATE)
    since = t[:, None] - HITS
    rings = SPEEDS * np.exp(-np.abs(since) / DECAY) * np.sin(2 * np.pi * RING * since)
    a = 9.81 + np.where(since > 0, rings, 0.0).sum(axis=1)
    a += np.random.default_rng(1).normal(0, 2, len(t))
    path.write_text("time,az\n" + "\n".join(f"{x:.4f},{y:.3f}" for x, y in zip(t, a, strict=True)))
    return path


def detect(folder: Path, *options: str) -> Vector:
    """Stamps of the impacts that are found in the ringing anvil, s."""
    bag = folder / "bag"
    given = ["--contact", "anvil", "--threshold", "60", "--baseline", "1", "-o", str(bag)]
    assert main(["detect", str(anvil(folder / "drill.csv")), *given, *options]) == 0
    with BagReader(bag) as reader:
        return np.array([event.stamp - SECOND for event in events_in(reader)]) / SECOND


def errors(stamps: Vector) -> Vector:
    """Differences to the nearest hit, s."""
    nearest = np.argmin(np.abs(stamps[:, None] - HITS), axis=1)
    return np.asarray(stamps - HITS[nearest])


def test_peaks_in_the_dead_time_are_counted_and_found_with_a_shorter_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Ringing is not counted; the dead time in use is printed."""
    (tmp_path / "long").mkdir()
    assert len(detect(tmp_path / "long")) == 8
    row = ["anvil", "/az,", "peak", "0.02", "8", "0", "4"]  # dead time, impacts, suppressed
    assert row in [line.split()[:7] for line in capsys.readouterr().out.splitlines()]
    stamps = detect(tmp_path, "--dead-time", "0.008")
    assert len(stamps) == len(HITS)
    assert np.abs(errors(stamps)).max() < 0.001
    assert "anvil /az, peak 0.008 12 " in " ".join(capsys.readouterr().out.split())


def test_the_onset_of_a_ringing_signal_does_not_scatter(
    tmp_path: Path,
) -> None:
    """Tops of the magnitude jump between half-waves; the first top does not."""
    scatter = {}
    for name, *options in (("top",), ("onset", "--instant", "onset")):
        folder = tmp_path / name
        folder.mkdir()
        scatter[name] = float(np.std(errors(detect(folder, "--dead-time", "0.008", *options))))
    assert scatter["onset"] < 10e-6
    assert scatter["top"] > 50e-6


def test_the_picture_of_a_detection_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The picture is named and has file time; another suffix is refused at once."""
    picture = tmp_path / "signal.svg"
    detect(tmp_path, "--plot", str(picture))
    drawn = picture.read_text(encoding="utf-8")
    assert "suppressed" in drawn
    assert "time since the file's time 0 [s]" in drawn
    assert f"{picture}: the signals" in capsys.readouterr().out
    assert main(["detect", "none.csv", "--plot", "signal.txt", "-o", str(tmp_path / "new")]) == 2
    assert "expected a name that ends in .png" in capsys.readouterr().err
