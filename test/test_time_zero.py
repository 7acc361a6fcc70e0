# SPDX-License-Identifier: Apache-2.0
"""Without an epoch the first impact is time zero: samples before it are kept, and axes say so."""

import csv
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from impact_observer.cli.main import main
from impact_observer.draw.motion_picture import motion_picture
from impact_observer.draw.recorded_motion import read_motion
from impact_observer.io import BagReader
from impact_observer.io.bag_part import assumed_epoch
from impact_observer.io.recordings import events_in, model_of
from impact_observer.observer.samples import SensorSample

GRAVITY, BOUNCE, DROP, START = 9.81, 0.8, 1.0, 0.5
MODEL = """name: ball
bodies: [{name: z, mass: 1}]
forces: [{body: z, constant: -9.81}]
stops: [{name: floor, body: z, limit: 0, side: below, restitution: 0.8}]
"""
MEASUREMENTS = """measurements:
- name: camera
  topic: /camera
  joint: height
  quantity: position
  position: {z: 1}
  deviation: 1.0e-6
"""
NOTE = (
    "no epoch, so time zero is the first impact, 0.951523641 s; 46 of 289 samples come before it,"
    " and the initial state holds at the first of them, 0.500000000 s"
)


def impact_times() -> list[float]:
    """Times of six impacts of a ball that is dropped from 1 m at 0.5 s."""
    flights = [np.sqrt(2 * DROP / GRAVITY)]
    flights += [2 * flights[0] * BOUNCE**k for k in range(1, 6)]
    return [START + float(each) for each in np.cumsum(flights)]


def height(t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Its height at ``t``, s."""
    hits = np.array(impact_times())
    k = np.searchsorted(hits, t, side="right")
    speed = np.sqrt(2 * GRAVITY * DROP) * BOUNCE**k
    since = np.where(k > 0, t - hits[np.maximum(k, 1) - 1], t - START)
    rising = speed * since - GRAVITY * since**2 / 2
    return np.where(k > 0, rising, DROP - GRAVITY * since**2 / 2)


@pytest.fixture
def ball(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A bag of its impacts and a camera's samples, without an epoch, in the working folder."""
    monkeypatch.chdir(tmp_path)
    times = np.arange(START, impact_times()[-1], 0.01)
    rows = [f"{t:.2f},{z:.9f}" for t, z in zip(times, height(times), strict=True)]
    Path("camera.csv").write_text("\n".join(["time,height", *rows]), encoding="utf-8")
    hits = [f"{t:.9f},floor" for t in impact_times()]
    Path("impacts.csv").write_text("\n".join(["time,contact", *hits]), encoding="utf-8")
    Path("ball.yaml").write_text(MODEL, encoding="utf-8")
    Path("camera.yaml").write_text(MEASUREMENTS, encoding="utf-8")
    words = "import impacts.csv --model ball.yaml --samples camera.csv --time-zero 0 -o bag"
    assert main(words.split()) == 0
    return tmp_path / "bag"


@pytest.mark.parametrize(
    ("command", "topic"),
    [("observe bag --law minimum-variance", "/observer/state"), ("smooth bag", "/smoother/state")],
)
def test_estimates_begin_with_the_first_sample(
    ball: Path, capsys: pytest.CaptureFixture[str], command: str, topic: str
) -> None:
    """They fall with the ball before the first impact, at negative times."""
    words = f"{command} --measurements camera.yaml --rate 100 -o out"
    assert main(words.split()) == 0
    assert f"note: {NOTE}\n" in capsys.readouterr().out
    assert main(["export", "out", "-o", "rows.csv", "--topics", topic]) == 0
    with (ball.parent / "rows.csv").open(encoding="utf-8") as file:
        rows = [*csv.DictReader(file)]
    stamps = np.array([int(row["stamp_ns"]) for row in rows]) * 1e-9
    assert float(rows[0]["time_s"]) == pytest.approx(START - 0.951523641)
    found = np.array([float(row["q_z"]) for row in rows])
    np.testing.assert_allclose(found, height(stamps), atol=2e-5)


def test_a_fit_begins_with_the_first_sample(
    ball: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The ball is at 1 m then, as it was dropped; rounded samples have no white errors."""
    del ball
    words = "identify bag --free restitution --measurements camera.yaml --clock-error 1e-6"
    assert main([*words.split(), "--plot", "fit.png"]) == 0
    printed = capsys.readouterr().out
    assert f"note: {NOTE}\n" in printed
    (line,) = (line for line in printed.splitlines() if line.startswith("z at the start"))
    assert float(line.split()[4]) == pytest.approx(DROP, abs=1e-6)


def test_pictures_count_from_the_first_impact(ball: Path) -> None:
    """Axes of time say so, and begin with the samples before it."""
    words = "observe bag --law minimum-variance --measurements camera.yaml --rate 100 -o out"
    assert main(words.split()) == 0
    with BagReader(ball.parent / "out") as reader:
        motion = read_motion(reader)
    assert motion.ends[0] == pytest.approx(START - impact_times()[0], abs=1e-9)
    axes = motion_picture(motion, [0]).axes
    assert "time since the first impact [s]" in [each.get_xlabel() for each in axes]


def test_an_epoch_is_assumed_only_where_none_is_known(ball: Path) -> None:
    """Neither where one is given, nor where samples begin with the impacts."""
    with BagReader(ball) as reader:
        events, system = events_in(reader), model_of(reader).system
    first = events[0].stamp
    early, late = SensorSample(0, first - 1, 0.0), SensorSample(0, first, 0.0)
    assert assumed_epoch(system, events, [early, late], 0).stamp == first - 1
    assert assumed_epoch(system, events, [early], 7) == assumed_epoch(system, [], [early], 0)
    assert assumed_epoch(system, events, [late], 0).stamp == 0
