# SPDX-License-Identifier: Apache-2.0
"""animate: films of a bag, as three kinds of files."""

import base64
import io
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import pytest
from PIL import Image

from impact_observer.cli import animate
from impact_observer.cli.main import main

QUICK = ("--fps", "20", "--duration", "0.4")
"""Nine pictures."""


def refusal(arguments: Sequence[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """The exit code and the one line of a command that fails."""
    code = main(["animate", *arguments])
    printed = capsys.readouterr()
    (line,) = printed.err.strip().splitlines()
    assert printed.out == ""
    return code, line


@pytest.mark.slow
@pytest.mark.parametrize(
    "case", [("20", 9, 50), pytest.param(("30", 14, 30), marks=pytest.mark.long)]
)
def test_gif_repeats_at_the_right_speed(
    sample_bag: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    case: tuple[str, int, int],
) -> None:
    """A rate that a GIF cannot have becomes the nearest; no other file is left."""
    asked, count, duration = case
    output = tmp_path / "film.gif"
    options = ("--duration", "0.4", "--fps", asked)
    assert main(["animate", str(sample_bag), "-o", str(output), *options]) == 0
    said = "" if asked == "20" else " at 33.33 a second"
    assert capsys.readouterr().out == f"film: {output}, {count} pictures{said} of 0.40 s\n"
    shown = []
    with Image.open(output) as film:
        assert film.info["loop"] == 0
        for i in range(getattr(film, "n_frames", 1)):
            film.seek(i)
            shown.append(film.info["duration"])
    assert sum(shown) == count * duration
    assert [path.name for path in tmp_path.iterdir() if path != sample_bag] == ["film.gif"]


@pytest.mark.slow
def test_page_has_all_pictures_and_needs_nothing_else(
    sample_bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A page of any size loads no font, script or style from a network."""
    monkeypatch.setitem(mpl.rcParams, "animation.embed_limit", 0.01)
    output = tmp_path / "film.html"
    assert main(["animate", str(sample_bag), "-o", str(output), *QUICK, "--speed", "0.5"]) == 0
    page = output.read_text("utf-8")
    pictures = re.findall(r'= "data:image/png;base64,([^"]+)"', page)
    assert len(pictures) == 17
    for data in pictures[:2]:
        decoded = base64.b64decode(data.replace("\\\n", ""))
        with Image.open(io.BytesIO(decoded)) as image:
            assert image.format == "PNG"
            assert image.size[0] == 960
    rest = page
    for data in pictures:
        rest = rest.replace(data, "")
    assert not re.search(r"https?:|src=|href=|@import|\bimport\b|fetch\(", rest)
    for button in ("play", "pause", "step-forward", "minus"):
        assert f".fa-{button}::before" in page


@pytest.mark.slow
def test_mp4_is_a_film(sample_bag: Path, tmp_path: Path) -> None:
    """The film reads back with ffmpeg as H.264 of as many pictures."""
    ffmpeg = shutil.which("ffmpeg")
    if ffmpeg is None:
        ffmpeg = pytest.importorskip("imageio_ffmpeg").get_ffmpeg_exe()
    output = tmp_path / "film.mp4"
    output.write_bytes(b"an older one")
    assert main(["animate", str(sample_bag), "-o", str(output), "--force", *QUICK]) == 0
    done = subprocess.run(
        [str(ffmpeg), "-i", str(output), "-f", "rawvideo", "-pix_fmt", "gray", "-"],
        capture_output=True,
        check=True,
        timeout=60,
    )
    log = done.stderr.decode()
    assert "h264" in log
    found = re.search(r"(\d{3,4})x(\d{3,4})", log)
    assert found
    pixels = int(found[1]) * int(found[2])
    assert len(done.stdout) == 9 * pixels


def test_mp4_without_ffmpeg_names_the_extra(
    sample_bag: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The error comes before anything is drawn."""
    monkeypatch.setattr(shutil, "which", lambda _: None)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    output = tmp_path / "film.mp4"
    code, line = refusal([str(sample_bag), "-o", str(output)], capsys)
    assert code == 2
    assert "pip install imageio-ffmpeg" in line
    assert not output.exists()


@pytest.mark.slow
def test_encoder_that_fails_is_one_line(
    sample_bag: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The line has the last message of ffmpeg, and the older film stays."""
    folder = tmp_path / "bin"
    folder.mkdir()
    broken = folder / "ffmpeg"
    broken.write_text("#!/bin/sh\necho first >&2\necho no such encoder >&2\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setenv("PATH", str(folder), prepend=":")
    output = tmp_path / "film.mp4"
    output.write_bytes(b"an older one")
    code, line = refusal([str(sample_bag), "-o", str(output), "--force", *QUICK], capsys)
    assert code == 1
    assert line.endswith("ffmpeg failed: no such encoder")
    assert output.read_bytes() == b"an older one"
    assert {path.name for path in tmp_path.iterdir()} == {sample_bag.name, "bin", "film.mp4"}


def test_interrupted_film_leaves_no_file(
    sample_bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No file is left under the name of the film or beside it."""
    shown = 0

    def interrupt(_progress: object, _what: str, done: float, _total: float) -> None:
        nonlocal shown
        shown += 1
        if done == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr("impact_observer.cli.progress.Progress.step", interrupt)
    with pytest.raises(KeyboardInterrupt):
        animate.animate(sample_bag, tmp_path / "film.gif", duration=0.4)
    assert shown == 2
    assert [path for path in tmp_path.iterdir() if path != sample_bag] == []


def test_gif_that_does_not_fit_into_memory_is_one_line(
    sample_bag: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The line names the formats that need less memory."""
    output = tmp_path / "film.gif"
    slow = ["--speed", "0.001", "--duration", "0.45", "--fps", "20"]
    code, line = refusal([str(sample_bag), "-o", str(output), *slow], capsys)
    assert code == 2
    assert "9001 pictures of 960 x" in line
    assert "too many for a GIF; expected at most" in line
    assert not output.exists()


@pytest.mark.slow
def test_longer_bags_are_cut_with_a_hint(
    sample_bag: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """By default a film is not longer than a minute."""
    monkeypatch.setattr(animate, "LONGEST", 0.2)
    output = tmp_path / "film.gif"
    assert main(["animate", str(sample_bag), "-o", str(output)]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith(f"film: {output}, 6 pictures of 0.20 s; 0.3 s of the bag are left")


@pytest.mark.parametrize(
    "case",
    [
        (["-o", "film.avi"], "expected a name that ends in .mp4, .gif, .html"),
        (["-o", "no/such/film.gif"], "make it first"),
        (["--fps", "100", "-o", "film.gif"], "a gif shows at most 50"),
        (["--observers", "observer_b", "-o", "film.gif"], "observer /observer_b: not in"),
        (["--start", "90", "-o", "film.gif"], "no states between"),
        (["--speed", "1e-4", "-o", "film.html"], "pictures: too many for a film"),
        (["--speed", "1e-6", "-o", "film.html"], "pictures: too many for a film"),
        (["--speed", "1e300", "-o", "film.html"], "--speed 1e+300: expected a number from 1e-06"),
        (["--start", "1e300", "-o", "film.gif"], "--start 1e+300: expected a number from 0 to"),
        (["--fps", "1e-300", "-o", "film.gif"], "--fps 1e-300: expected a number from 0.001"),
    ],
)
def test_what_cannot_be_filmed_is_one_line(
    sample_bag: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    case: tuple[list[str], str],
) -> None:
    """The failed command leaves no file."""
    (*rest, name), problem = case
    arguments = [*rest, str(tmp_path / name)]
    code, line = refusal([str(sample_bag), "--duration", "0.45", *arguments], capsys)
    assert code == 2
    assert problem in line
    assert [path for path in tmp_path.iterdir() if path != sample_bag] == []
