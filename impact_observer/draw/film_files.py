# SPDX-License-Identifier: Apache-2.0
"""Film files: MP4 by ffmpeg, GIF, or one HTML page that contains all pictures.

The writers of matplotlib.animation are not used: they render the whole figure for each picture,
and those for GIF and HTML keep all pictures in memory.
"""

import base64
import io
import shutil
import struct
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import cache, partial
from pathlib import Path
from typing import IO, TypeAlias

import numpy as np
from numpy.typing import NDArray
from PIL import GifImagePlugin, Image

from impact_observer.draw.output import check_output
from impact_observer.errors import UsageError
from impact_observer.plain_text import markup

Picture: TypeAlias = NDArray[np.uint8]
"""Red, green, blue and opacity, shape (height, width, 4)."""
Writer: TypeAlias = Callable[
    [Path, tuple[int, int]], AbstractContextManager[Callable[[Picture], None]]
]
"""Opens a film of a width and height, pixels, and gives the function that adds a picture."""

_HUES = ((0xB9, 0xCF, 0xE0), (0xD5, 0x5E, 0x00), (0x00, 0x72, 0xB2))
"""Colours of bodies, of highlighted stops and of curves, beside greys."""
_LAST = 1200
"""How long a GIF shows its last picture before it starts again, ms."""
_FFMPEG = (
    "-y -loglevel error -f rawvideo -pix_fmt rgba -s {0}x{1} -r {fps:.6f} -i - -an"
    " -c:v libx264 -crf 20 -pix_fmt yuv420p -movflags +faststart"
)
"""Options of ffmpeg: raw pictures on its standard input become H.264 that every browser shows."""


def writer_for(path: Path, fps: float) -> Writer:
    """The writer of a film, chosen by the suffix of ``path``.

    Args:
        path: the file to be written.
        fps: pictures a second.

    Raises:
        UsageError: another suffix, no such folder, no ffmpeg, or too many pictures a second.
    """
    suffix = path.suffix.lower()
    writers = {".mp4": _mp4, ".gif": _gif, ".html": _html}
    check_output(path, tuple(writers))
    most = 50.0 if suffix == ".gif" else 120.0
    if fps > most:
        raise UsageError(f"{fps:g} pictures a second: a {suffix[1:]} shows at most {most:g}")
    if suffix == ".mp4":
        _ffmpeg()
    return partial(writers[suffix], fps=fps)


def _ffmpeg() -> str:
    """The path of ffmpeg.

    Raises:
        UsageError: it is neither on the PATH nor in the package of the extra ``mp4``.
    """
    if (found := shutil.which("ffmpeg")) is not None:
        return found
    try:
        from imageio_ffmpeg import get_ffmpeg_exe

        return str(get_ffmpeg_exe())
    except (ImportError, RuntimeError):
        raise UsageError(
            "mp4: no ffmpeg here; install it, or pip install imageio-ffmpeg, or write a"
            " .gif or .html"
        ) from None


@contextmanager
def _replacing(path: Path) -> Iterator[Path]:
    """A temporary file that replaces ``path`` at the end, if nothing was raised."""
    try:
        with tempfile.TemporaryDirectory(dir=path.absolute().parent, prefix=".film") as folder:
            made = Path(folder) / path.name
            yield made
            made.replace(path)
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror or error}") from None


@contextmanager
def _mp4(path: Path, size: tuple[int, int], *, fps: float) -> Iterator[Callable[[Picture], None]]:
    """An MP4, encoded while it is drawn."""
    with _replacing(path) as made, tempfile.TemporaryFile() as log:
        command = [_ffmpeg(), *_FFMPEG.format(*size, fps=fps).split(), str(made)]
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=log
        )
        pipe = process.stdin
        assert pipe is not None
        try:
            yield lambda picture: _send(pipe, picture)
            pipe.close()
            failed = process.wait() != 0
        except BrokenPipeError:
            failed = True
        finally:
            process.kill()
            process.wait()
        if failed:
            log.seek(0)
            lines = log.read().decode(errors="replace").strip().splitlines()
            raise UsageError(f"{path}: ffmpeg failed: {lines[-1] if lines else 'no reason given'}")


def _send(pipe: IO[bytes], picture: Picture) -> None:
    pipe.write(picture.tobytes())


@contextmanager
def _gif(path: Path, size: tuple[int, int], *, fps: float) -> Iterator[Callable[[Picture], None]]:
    """A GIF that repeats for ever, written while it is drawn."""
    with _replacing(path) as made, made.open("wb") as file:
        gif = _Gif(file, size, fps)
        yield gif.add
        gif.finish()


class _Gif:
    """Writes a GIF picture by picture; of each only the rectangle that changed."""

    def __init__(self, file: IO[bytes], size: tuple[int, int], fps: float) -> None:
        colours = bytes(_palette().getpalette() or ()).ljust(3 * 256, b"\0")
        self._file, self._fps = file, fps
        self._count = 0
        self._last: NDArray[np.uint8] | None = None
        self._waiting: tuple[Image.Image, tuple[int, int]] | None = None
        screen = struct.pack("<HHBBB", *size, 0b1111_0111, 0, 0)
        file.write(b"GIF89a" + screen + colours[: 3 * 256])
        file.write(b"\x21\xff\x0bNETSCAPE2.0\x03\x01\x00\x00\x00")  # repeats for ever

    def add(self, picture: Picture) -> None:
        """Write the previous picture, whose duration is only now certain, and keep this one."""
        image = _few_colours(picture)
        pixels = np.asarray(image)
        box = (0, 0, *image.size) if self._last is None else _changed(self._last, pixels)
        self._write(self._duration())
        self._last, self._waiting = pixels, (image.crop(box), box[:2])
        self._count += 1

    def finish(self) -> None:
        """Write the last picture, which stays longer."""
        self._write(max(self._duration(), _LAST))
        self._file.write(b";")

    def _duration(self) -> int:
        """How long the waiting picture is shown, ms; the format counts hundredths of a second."""
        before, after = (round(k * 100 / self._fps) for k in (self._count - 1, self._count))
        return 10 * (after - before)

    def _write(self, duration: int) -> None:
        """Write the waiting picture, if there is one."""
        if self._waiting is not None:
            image, corner = self._waiting
            for data in GifImagePlugin.getdata(image, corner, duration=duration, disposal=1):
                self._file.write(data)


def _changed(before: NDArray[np.uint8], after: NDArray[np.uint8]) -> tuple[int, int, int, int]:
    """Left, upper, right and lower end of what differs; one pixel where nothing does."""
    rows, columns = (np.flatnonzero((before != after).any(axis=axis)) for axis in (1, 0))
    if not rows.size:
        return 0, 0, 1, 1
    return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1


@contextmanager
def _html(path: Path, size: tuple[int, int], *, fps: float) -> Iterator[Callable[[Picture], None]]:
    """A page with all pictures in it, and controls."""
    page = _PAGE.replace("FPS", f"{fps:g}").replace("WIDTH", str(size[0]))
    head, tail = page.split("PICTURES")
    head = head.replace("NAME", markup(path.stem))
    with _replacing(path) as made, made.open("w", encoding="utf-8") as file:
        file.write(head)

        def add(picture: Picture) -> None:
            png = io.BytesIO()
            _few_colours(picture).save(png, "PNG")
            file.write(f'"{base64.b64encode(png.getvalue()).decode()}",\n')

        yield add
        file.write(tail)


def _few_colours(picture: Picture) -> Image.Image:
    """The picture in the palette of all films: pictures then differ only where something moves."""
    image = Image.fromarray(np.ascontiguousarray(picture[..., :3]))
    return image.quantize(palette=_palette(), dither=Image.Dither.NONE)


@cache
def _palette() -> Image.Image:
    """Greys, and shades of every hue of bodies, stops and curves towards white and black."""
    greys = np.repeat(np.linspace(0, 255, 24)[:, None], 3, axis=1)
    shares = np.linspace(0, 1, 9)[2:-1, None]  # none so near white that it would replace white
    tints = [255 + shares * (np.array(hue) - 255) for hue in _HUES]
    shades = [shares * np.array(hue) for hue in _HUES]
    colours = np.vstack([greys, *tints, *shades, _HUES])
    image = Image.new("P", (1, 1))
    image.putpalette(np.rint(colours).astype(np.uint8).tobytes())
    return image


_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>NAME</title><style>
body { font: 15px sans-serif; margin: 1em auto; max-width: WIDTHpx }
img { width: 100%; display: block }
div { display: flex; gap: .6em; align-items: center }
input { flex: 1 }
</style></head><body>
<img id="film" alt="plant and estimates, moving">
<div><button id="play">pause</button><input id="at" type="range" min="0" value="0" step="1">
<select id="speed"><option value="0.1">0.1 x</option><option value="0.25">0.25 x</option>
<option value="0.5">0.5 x</option><option value="1" selected>1 x</option>
<option value="2">2 x</option><option value="4">4 x</option></select></div>
<p>Space plays and pauses, the arrows go from picture to picture.</p>
<script>
const pictures = [
PICTURES];
const fps = FPS, [film, play, at, speed] = ["film", "play", "at", "speed"].map(
  (id) => document.getElementById(id));
const shown = pictures.map((data) => {
  const image = new Image();
  image.src = "data:image/png;base64," + data;
  return image.src;
});
let place = 0, playing = true, last = null;
at.max = pictures.length - 1;
function show() { film.src = shown[Math.floor(place)]; at.value = Math.floor(place); }
function go(on) { playing = on; play.textContent = on ? "pause" : "play"; last = null; }
function step(by) {
  go(false);
  place = Math.min(Math.max(Math.floor(place) + by, 0), pictures.length - 1);
  show();
}
function tick(now) {
  if (playing && last !== null) {
    place = (place + (now - last) / 1000 * fps * Number(speed.value)) % pictures.length;
    show();
  }
  last = now;
  requestAnimationFrame(tick);
}
play.onclick = () => go(!playing);
at.oninput = () => { go(false); place = Number(at.value); show(); };
document.onkeydown = (event) => {
  if (event.key === " ") { event.preventDefault(); go(!playing); }
  if (event.key === "ArrowRight") { event.preventDefault(); step(1); }
  if (event.key === "ArrowLeft") { event.preventDefault(); step(-1); }
};
show();
requestAnimationFrame(tick);
</script></body></html>
"""
