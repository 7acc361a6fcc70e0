"""Films as files: MP4 by ffmpeg, GIF, or one HTML page with everything in it."""

import base64
import html
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

from impact_observer.errors import UsageError

Picture: TypeAlias = NDArray[np.uint8]
"""Red, green, blue and opacity, shape (height, width, 4)."""
Add: TypeAlias = Callable[[Picture], None]
Writer: TypeAlias = Callable[[Path, tuple[int, int]], AbstractContextManager[Add]]
"""What opens a film for pictures of one width and height, pixels."""

_HUES = ((0xB9, 0xCF, 0xE0), (0xD5, 0x5E, 0x00), (0x00, 0x72, 0xB2))
"""Of bodies, of stops that are hit and of curves, beside greys."""
_LAST = 1.2
"""How long a GIF stands before it begins again, s."""


def writer_for(path: Path, fps: float) -> Writer:
    """What writes a film to ``path``; its ending says which.

    Args:
        path: where the film will be.
        fps: pictures a second.

    Raises:
        UsageError: another ending, no such folder, no ffmpeg, or too many pictures a second.
    """
    ending = path.suffix.lower()
    writers: dict[str, Writer] = {
        ".mp4": partial(_mp4, fps=fps),
        ".gif": partial(_gif, fps=fps),
        ".html": partial(_html, fps=fps),
    }
    if ending not in writers:
        raise UsageError(f"{path}: expected a film's name that ends in {', '.join(writers)}")
    if not path.absolute().parent.is_dir():
        raise UsageError(f"{path}: no folder {path.parent}; make it first")
    if path.is_dir():
        raise UsageError(f"{path}: is a folder; expected the name of a file")
    fastest = 50.0 if ending == ".gif" else 120.0
    if fps > fastest:
        raise UsageError(f"{fps:g} pictures a second: a {ending[1:]} shows at most {fastest:g}")
    if ending == ".mp4":
        _ffmpeg()
    return writers[ending]


def _ffmpeg() -> str:
    """Where ffmpeg is.

    Raises:
        UsageError: it is neither on the PATH nor in the package that the extra brings.
    """
    if (found := shutil.which("ffmpeg")) is not None:
        return found
    try:
        from imageio_ffmpeg import get_ffmpeg_exe

        return str(get_ffmpeg_exe())
    except (ImportError, RuntimeError):
        raise UsageError(
            "mp4: no ffmpeg here; install it, or pip install impact_observer[mp4], or write a"
            " .gif or .html"
        ) from None


@contextmanager
def _replacing(path: Path) -> Iterator[Path]:
    """A file beside ``path`` that takes its place when all went well."""
    try:
        with tempfile.TemporaryDirectory(dir=path.absolute().parent, prefix=".film") as folder:
            made = Path(folder) / path.name
            yield made
            made.replace(path)
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror or error}") from None


@contextmanager
def _mp4(path: Path, size: tuple[int, int], *, fps: float) -> Iterator[Add]:
    """H.264 as every browser and slide shows it."""
    raw = ["-f", "rawvideo", "-pix_fmt", "rgba", "-s", f"{size[0]}x{size[1]}", "-r", f"{fps:.6f}"]
    coded = ["-c:v", "libx264", "-crf", "20", "-pix_fmt", "yuv420p", "-movflags", "+faststart"]
    with _replacing(path) as made, tempfile.TemporaryFile() as said:
        command = [
            _ffmpeg(),
            "-y",
            "-loglevel",
            "error",
            *raw,
            "-i",
            "-",
            "-an",
            *coded,
            str(made),
        ]
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=said
        )
        stream = process.stdin
        assert stream is not None
        try:
            yield lambda picture: _sent(stream, picture)
            stream.close()
            failed = process.wait() != 0
        except BrokenPipeError:
            failed = True
        finally:
            if process.poll() is None:
                process.kill()
            process.wait()
        if failed:
            said.seek(0)
            lines = said.read().decode(errors="replace").strip().splitlines() or [
                "no reason given"
            ]
            raise UsageError(f"{path}: ffmpeg failed: {lines[-1]}")


def _sent(stream: IO[bytes], picture: Picture) -> None:
    stream.write(picture.tobytes())


@contextmanager
def _gif(path: Path, size: tuple[int, int], *, fps: float) -> Iterator[Add]:
    """A GIF that begins again and again, written while it is drawn."""
    with _replacing(path) as made, made.open("wb") as file:
        gif = _Gif(file, size, fps)
        yield gif.add
        gif.end()


class _Gif:
    """Writes a GIF picture by picture, of each what differs from the one before.

    Pillow alone would keep all of them in memory.
    """

    def __init__(self, file: IO[bytes], size: tuple[int, int], fps: float) -> None:
        colours = bytes(_palette().getpalette() or ()).ljust(3 * 256, b"\0")
        self._file, self._fps = file, fps
        self._count = 0
        self._last: NDArray[np.uint8] | None = None
        self._waiting: tuple[Image.Image, tuple[int, int]] | None = None
        screen = struct.pack("<HHBBB", *size, 0b1111_0111, 0, 0)
        file.write(b"GIF89a" + screen + colours[: 3 * 256])
        file.write(b"\x21\xff\x0bNETSCAPE2.0\x03\x01\x00\x00\x00")  # for ever

    def add(self, picture: Picture) -> None:
        """Write the picture before, now that this one is there."""
        image = _few_colours(picture)
        pixels = np.asarray(image)
        box = (0, 0, *image.size) if self._last is None else _changed(self._last, pixels)
        self._write(self._shown())
        self._last, self._waiting = pixels, (image.crop(box), box[:2])
        self._count += 1

    def end(self) -> None:
        """Write the last picture, which stands longer."""
        self._write(max(self._shown(), round(_LAST * 1000)))
        self._file.write(b";")

    def _shown(self) -> int:
        """How long the picture that waits is shown, ms: time goes in hundredths of a second."""
        before, after = (round(k * 100 / self._fps) for k in (self._count - 1, self._count))
        return 10 * (after - before)

    def _write(self, duration: int) -> None:
        """Write the picture that waits."""
        if self._waiting is not None:
            image, place = self._waiting
            for data in GifImagePlugin.getdata(image, place, duration=duration, disposal=1):
                self._file.write(data)


def _changed(before: NDArray[np.uint8], after: NDArray[np.uint8]) -> tuple[int, int, int, int]:
    """Left, upper, right and lower end of what differs; one pixel where nothing does."""
    rows, columns = (np.flatnonzero((before != after).any(axis=axis)) for axis in (1, 0))
    if not rows.size:
        return 0, 0, 1, 1
    return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1


@contextmanager
def _html(path: Path, size: tuple[int, int], *, fps: float) -> Iterator[Add]:
    """A page with all pictures in it, and buttons."""
    page = _PAGE.replace("FPS", f"{fps:g}").replace("WIDTH", str(size[0]))
    head, tail = page.split("PICTURES")
    head = head.replace("NAME", html.escape(path.stem))
    with _replacing(path) as made, made.open("w", encoding="utf-8") as file:
        file.write(head)

        def add(picture: Picture) -> None:
            held = io.BytesIO()
            _few_colours(picture).save(held, "PNG")
            file.write(f'"{base64.b64encode(held.getvalue()).decode()}",\n')

        yield add
        file.write(tail)


def _few_colours(picture: Picture) -> Image.Image:
    """The picture with the palette of all films, so that pictures differ in what moves only."""
    image = Image.fromarray(np.ascontiguousarray(picture[..., :3]))
    return image.quantize(palette=_palette(), dither=Image.Dither.NONE)


@cache
def _palette() -> Image.Image:
    """Greys, and every colour of bodies, stops and curves on its way to white and to black."""
    greys = np.repeat(np.linspace(0, 255, 24)[:, None], 3, axis=1)
    ways = np.linspace(0, 1, 9)[2:-1, None]  # nothing so near to white that white becomes it
    tints = [255 + ways * (np.array(hue) - 255) for hue in _HUES]
    shades = [ways * np.array(hue) for hue in _HUES]
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
