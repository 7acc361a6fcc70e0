"""Film files, by writers of matplotlib: MP4 by ffmpeg, GIF, or one HTML page."""

import logging
import re
import subprocess
from collections.abc import Callable, Sequence
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, HTMLWriter
from matplotlib.figure import Figure
from PIL import Image

from impact_observer.draw.pictures import check_output
from impact_observer.draw.scene.animation import DPI, FilmPictures
from impact_observer.errors import UsageError

_SYMBOLS = {
    "minus": "-",
    "fast-backward": "|&laquo;",
    "step-backward": "|&lsaquo;",
    "play": "&#9654;",
    "pause": "&#10074;&#10074;",
    "step-forward": "&rsaquo;|",
    "fast-forward": "&raquo;|",
    "plus": "+",
}
"""What stands on the buttons of the page, instead of a font from the network."""


class _GifWriter(AbstractMovieWriter):
    """Repeats for ever at exactly the wanted rate, and keeps compressed pictures.

    ``PillowWriter`` of matplotlib keeps 4 MB of each picture, and rounds their duration.
    """

    def setup(self, fig: Figure, outfile: str | Path, dpi: float | None = None) -> None:
        super().setup(fig, outfile, dpi)
        self._pictures: list[BytesIO] = []

    def grab_frame(self, **savefig_kwargs: Any) -> None:  # noqa: ANN401 (as in the base class)
        self._pictures.append(BytesIO())
        self.fig.savefig(self._pictures[-1], format="png", dpi=self.dpi, **savefig_kwargs)

    def finish(self) -> None:
        # The format counts hundredths of a second.
        ends = np.rint(np.arange(len(self._pictures) + 1) * 100 / self.fps)
        durations = (10 * np.diff(ends)).astype(int).tolist()
        pictures = (Image.open(each).convert("RGB") for each in self._pictures)
        first = next(pictures)
        first.save(self.outfile, save_all=True, append_images=pictures, duration=durations, loop=0)


def writer_for(path: Path, fps: float) -> AbstractMovieWriter:
    """The writer of a film, chosen by the suffix of ``path``.

    Args:
        path: the file to be written.
        fps: pictures a second.

    Raises:
        UsageError: another suffix, no such folder, no ffmpeg, or too many pictures a second.
    """
    suffix = path.suffix.lower()
    check_output(path, (".mp4", ".gif", ".html"))
    most = 50.0 if suffix == ".gif" else 120.0
    if fps > most:
        raise UsageError(f"{fps:g} pictures a second: a {suffix[1:]} shows at most {most:g}")
    rate: dict[str, Any] = {"fps": fps}  # matplotlib's types allow whole numbers only
    if suffix == ".gif":
        return _GifWriter(**rate)
    if suffix == ".html":
        return HTMLWriter(**rate, embed_frames=True, embed_limit=float("inf"))
    _find_ffmpeg()
    return FFMpegWriter(**rate, codec="h264", extra_args=["-crf", "20", "-movflags", "+faststart"])


def _find_ffmpeg() -> None:
    """Make matplotlib use the ffmpeg on the PATH, or that in the package of the extra ``mp4``.

    Raises:
        UsageError: there is neither.
    """
    if FFMpegWriter.isAvailable():
        return
    try:
        from imageio_ffmpeg import get_ffmpeg_exe

        mpl.rcParams["animation.ffmpeg_path"] = get_ffmpeg_exe()
    except (ImportError, RuntimeError):
        raise UsageError(
            "mp4: no ffmpeg here; install it, or pip install impact_observer[mp4], or write a"
            " .gif or .html"
        ) from None


def write_film(
    path: Path,
    writer: AbstractMovieWriter,
    pictures: FilmPictures,
    stamps: Sequence[int],
    progress: Callable[[int, int], None],
) -> None:
    """Write a film; the file is replaced only when all of it is there.

    Args:
        path: the file.
        writer: as by ``writer_for``.
        pictures: draws a picture.
        stamps: of the pictures, ns.
        progress: called with the number of pictures drawn and that of all.

    Raises:
        UsageError: the file cannot be written, or ffmpeg fails.
    """
    logging.getLogger("matplotlib.animation").setLevel(logging.CRITICAL)  # errors are one line
    try:
        with TemporaryDirectory(dir=path.absolute().parent, prefix=".film") as folder:
            made = Path(folder) / f"film{path.suffix.lower()}"
            with mpl.rc_context({"savefig.bbox": None}):
                writer.setup(pictures.figure, made, DPI)
                with suppress(BrokenPipeError):  # ``finish`` says why ffmpeg has ended
                    for done, stamp in enumerate(stamps, start=1):
                        pictures.show(stamp)
                        writer.grab_frame()
                        progress(done, len(stamps))
                writer.finish()
            if made.suffix == ".html":
                _embed_symbols(made)
            made.replace(path)
    except subprocess.CalledProcessError as error:
        lines = error.stderr.strip().splitlines() or ["no reason given"]
        raise UsageError(f"{path}: ffmpeg failed: {lines[-1]}") from None
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror or error}") from None


def _embed_symbols(page: Path) -> None:
    """Write the symbols of the buttons into the page, which then needs no network."""
    text = re.sub(r"<link[^>]*>", '<meta charset="utf-8">', page.read_text("utf-8"), count=1)
    for name, symbol in _SYMBOLS.items():
        text = re.sub(rf'(<i class="fa fa-{name}[^>]*)>', rf"\1>{symbol}", text)
    turned = "<style>.fa-flip-horizontal {display: inline-block; transform: scaleX(-1)}</style>"
    page.write_text(turned + text, encoding="utf-8")
