# SPDX-License-Identifier: Apache-2.0
"""Film files by the writers of matplotlib: MP4 by ffmpeg, GIF by Pillow, or one HTML page."""

import logging
import math
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib import animation

from impact_observer.draw.scene.film import Film
from impact_observer.draw.scene.film_figure import DPI, FilmFigure
from impact_observer.errors import OutputError, UsageError
from impact_observer.output_files import check_output, replacing

_FASTEST = {".mp4": 120.0, ".gif": 50.0, ".html": 120.0}
"""Most pictures a second, by the suffix of the file."""
_TICK = {".gif": 10, ".html": 1}
"""Unit of a picture's duration, ms, in files that count their pictures' duration."""
_GIF_MEMORY = 4e9
"""Memory that the pictures of a GIF may take, bytes: Pillow writes them all at the end."""
_BYTES = 4
"""Memory of a pixel of a GIF while it is made: red, green, blue, and the index of a colour."""
_ICONS = {
    "minus": "\u2212",
    "plus": "+",
    "fast-backward": "|\u25c0",
    "fast-forward": "\u25b6|",
    "step-backward": "\u25c1",
    "step-forward": "\u25b7",
    "pause": "\u2759\u2759",
    "play": "\u25b6",
}
"""Signs of the buttons of matplotlib's page, by the end of their CSS class."""


def picture_rate(path: Path, fps: float) -> float:
    """The nearest number of pictures a second that a film file can have.

    A GIF shows each picture for whole hundredths of a second, a page for whole milliseconds.

    Args:
        path: the film; its suffix is the format.
        fps: pictures a second that are asked for.

    Raises:
        UsageError: another suffix, no such folder, no ffmpeg, or too many pictures a second.
    """
    check_output(path, tuple(_FASTEST))
    suffix = path.suffix.lower()
    if fps > _FASTEST[suffix]:
        raise UsageError(
            f"{fps:g} pictures a second: a {suffix[1:]} shows at most {_FASTEST[suffix]:g}"
        )
    if suffix == ".mp4":
        _ffmpeg()
        return fps
    duration = max(round(1000 / fps / _TICK[suffix]), 1) * _TICK[suffix]
    # The writers divide 1000 by the rate and round down, so the rate must not be a bit too large.
    return math.nextafter(1000 / duration, 0.0)


def write_film(
    film: Film,
    path: Path,
    *,
    title: str,
    speed: float,
    fps: float,
    progress: Callable[[int, int], None],
) -> None:
    """Draw a film and write it; an existing file is replaced when all is written.

    Args:
        film: the content.
        path: the film; its suffix is the format.
        title: written above the scene.
        speed: recorded seconds a second of the film.
        fps: pictures a second, as of ``picture_rate``.
        progress: called with the number of pictures that are drawn, and of all.

    Raises:
        UsageError: too many pictures for a GIF, or the file may not be written.
        OutputError: ffmpeg fails, or the disk is full or gone.
    """
    drawn = FilmFigure(film, title=title, speed=speed)
    stamps = film.stamps(fps, speed).tolist()
    suffix = path.suffix.lower()
    if suffix == ".gif":
        _check_memory(path, len(stamps), drawn)
    settings: Any = {"savefig.bbox": None}
    if suffix == ".mp4":
        settings["animation.ffmpeg_path"] = _ffmpeg()
    with replacing(path) as temporary, mpl.rc_context(settings):
        writer = _writer(suffix, fps)
        writer.setup(drawn.figure, str(temporary), DPI)
        try:
            for done, stamp in enumerate(stamps, start=1):
                drawn.show(stamp)
                _grab(writer)
                progress(done, len(stamps))
            writer.finish()
        except subprocess.CalledProcessError as error:
            lines = str(error.stderr or "").strip().splitlines()
            reason = lines[-1] if lines else "no reason given"
            raise OutputError(f"{path}: ffmpeg failed: {reason}") from None
        if suffix == ".html":
            _make_offline(temporary)


def _grab(writer: Any) -> None:  # noqa: ANN401 (matplotlib's is not typed)
    """Give the writer the figure as its next picture.

    Raises:
        CalledProcessError: ffmpeg has ended before.
    """
    try:
        writer.grab_frame()
    except BrokenPipeError:
        writer.finish()  # raises the error with what ffmpeg wrote
        raise


def _writer(suffix: str, fps: float) -> Any:  # noqa: ANN401 (matplotlib's is not typed)
    """The writer of matplotlib for a format."""
    writers: Any = animation  # their rates are typed as whole numbers
    if suffix == ".gif":
        return writers.PillowWriter(fps)
    if suffix == ".html":
        # Without a limit no picture is dropped.
        return writers.HTMLWriter(fps, embed_frames=True, embed_limit=math.inf)
    logging.getLogger("matplotlib.animation").setLevel(logging.ERROR)  # the error says it all
    return writers.FFMpegWriter(fps, codec="h264", extra_args=["-movflags", "+faststart"])


def _ffmpeg() -> str:
    """The path of ffmpeg.

    Raises:
        UsageError: ffmpeg is neither on the PATH nor in the package of the extra ``mp4``.
    """
    if (installed := shutil.which("ffmpeg")) is not None:
        return installed
    try:
        from imageio_ffmpeg import get_ffmpeg_exe

        return str(get_ffmpeg_exe())
    except (ImportError, RuntimeError):
        raise UsageError(
            "mp4: no ffmpeg here; install it, or pip install imageio-ffmpeg, or write a"
            " .gif or .html"
        ) from None


def _check_memory(path: Path, count: int, drawn: FilmFigure) -> None:
    """Raise unless the pictures of a GIF fit into ``_GIF_MEMORY``.

    Raises:
        UsageError: the pictures take more.
    """
    width, height = drawn.figure.get_size_inches() * DPI
    most = int(_GIF_MEMORY / (width * height * _BYTES))
    if count > most:
        raise UsageError(
            f"{path}: {count} pictures of {width:.0f} x {height:.0f} pixels: too many for a GIF;"
            f" expected at most {most}, with a shorter --duration, a lower --fps or a higher"
            " --speed; or write an .mp4 or .html"
        )


def _make_offline(page: Path) -> None:
    """Give the buttons of matplotlib's page signs that need no font from the network."""
    rules = (f".fa-{name}::before {{ content: '{sign}' }}" for name, sign in _ICONS.items())
    style = "<meta charset='utf-8'><style>\n{}\n.fa {{ font-style: normal }}\n{}\n</style>".format(
        "\n".join(rules),
        ".fa-flip-horizontal { display: inline-block; transform: scaleX(-1) }",
    )
    text = page.read_text(encoding="utf-8")
    start = text.index("<link")
    end = text.index(">", start) + 1
    page.write_text(text[:start] + style + text[end:], encoding="utf-8")
