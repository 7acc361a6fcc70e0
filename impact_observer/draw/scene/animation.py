# SPDX-License-Identifier: Apache-2.0
"""The pictures of a film: plant and estimates at one scale, V over time below.

The background is drawn once; only moving artists are drawn for each picture, which takes a quarter
of the time of a whole figure.
"""

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from impact_observer.draw.pictures import MOST_ROWS, mark_rows, styles
from impact_observer.draw.scene.film import Film
from impact_observer.draw.scene.placement import SIDE, WIDTH, Placement
from impact_observer.draw.scene.row import (
    LARGE,
    NAMED,
    DrawStyle,
    SceneRow,
    draw_scale,
    write_note,
)
from impact_observer.stamps import NS_PER_S

DPI = 100
"""Pixels an inch."""
_HIGHLIGHT = 0.3
"""How long a stop is highlighted after an impact, s of the film."""
_PLANT = "#B9CFE0"
_LEFT, _TITLE = 0.95, 0.42
"""Margins on the left of the axes of V, and for the title, inches."""
_LEGEND, _DISTANCE, _AXIS, _NOTHING = 0.35, 1.75, 0.62, 0.25
"""Heights of V's legend, axes and ticks, and of the margin without them, inches."""


class FilmPictures:
    """Draws a film picture by picture.

    Attributes:
        size: width and height of a picture, pixels, both even as video encoders require.
    """

    def __init__(self, film: Film, *, title: str, speed: float = 1.0) -> None:
        """Draw the background.

        Args:
            film: what to show.
            title: of the film.
            speed: recorded seconds a second of the film.
        """
        self._film = film
        self._highlight = round(_HIGHLIGHT * speed * NS_PER_S)
        placement = Placement(film.scene, len(film.tracks))
        lower = _LEGEND + _DISTANCE + _AXIS if film.distances else _NOTHING
        inches = (WIDTH, _TITLE + placement.height + lower)
        self.size = (_even(inches[0]), _even(inches[1]))
        with mpl.rc_context({"font.size": LARGE, "hatch.linewidth": 0.7}):
            figure = Figure(figsize=(self.size[0] / DPI, self.size[1] / DPI), dpi=DPI)
            self._canvas = _canvas(figure)
            self._rows = _rows(figure, film, placement)
            self._distances = _DistancePlot(figure, film) if film.distances else None
            self._clock = _write(figure, film, title)
            self._artists: list[Artist] = [self._clock]
            for row in self._rows:
                self._artists += row.artists
            if self._distances is not None:
                self._artists += self._distances.artists
            for artist in self._artists:
                artist.set_animated(True)
            self._canvas.draw()
        self._background = self._canvas.copy_from_bbox(figure.bbox)

    def picture(self, stamp: int) -> NDArray[np.uint8]:
        """The picture at ``stamp``, ns, shape (height, width, 4): red, green, blue, opacity."""
        film = self._film
        self._canvas.restore_region(self._background)
        truth = None if film.truth is None else film.truth.at(stamp)
        for row in self._rows:
            row.show(stamp, truth, self._highlight)
        if self._distances is not None:
            self._distances.show(stamp)
        self._clock.set_text(f"t = {(stamp - film.epoch) / NS_PER_S:7.3f} s")
        renderer = self._canvas.get_renderer()
        for artist in self._artists:
            if artist.get_visible():
                artist.draw(renderer)
        return np.array(self._canvas.buffer_rgba())


def _canvas(figure: Figure) -> Any:  # noqa: ANN401 (matplotlib's is hardly typed)
    """The canvas of a figure."""
    return FigureCanvasAgg(figure)


def _even(inches: float) -> int:
    """The nearest even number of pixels to a length."""
    return round(inches * DPI / 2) * 2


def _rows(figure: Figure, film: Film, placement: Placement) -> list[SceneRow]:
    """Axes with the scene for each track."""
    whole = float(figure.get_figheight())
    rows = []
    for k, (track, style) in enumerate(zip(film.tracks, _track_styles(film), strict=True)):
        left, top, width, height = placement.box(k)
        bottom = whole - _TITLE - top - height
        place = (left / WIDTH, bottom / whole, width / WIDTH, height / whole)
        rows.append(SceneRow(figure.add_axes(place), placement, film, track, style))
    draw_scale(rows[0].axes, placement)
    if film.truth is not None and film.estimates:
        write_note(rows[1].axes, placement, "dashed: the plant")
    return rows


def _write(figure: Figure, film: Film, title: str) -> Any:  # noqa: ANN401 (a text that moves)
    """Write the title and what is left out; return the text that will be the time."""
    top = 1 - 0.14 / float(figure.get_figheight())
    figure.text(0.026, top, title, weight="bold", va="top")
    if film.scene.omitted:
        left_out = "; ".join(film.scene.omitted)
        figure.text(0.026, 0.012, left_out, va="bottom", size=NAMED, color="0.35")
    return figure.text(0.974, top, "", ha="right", va="top", family="monospace")


class _DistancePlot:
    """V over time, with the future under a veil."""

    def __init__(self, figure: Figure, film: Film) -> None:
        self._film = film
        width, height = (float(each) for each in figure.get_size_inches())
        box = (_LEFT / width, _AXIS / height, 1 - (_LEFT + SIDE) / width, _DISTANCE / height)
        axes = figure.add_axes(box)
        start, end = film.seconds(np.array([film.start, film.end]))
        found = styles([each.law for each in film.estimates])
        self._curves = []
        for track, each, style in zip(film.estimates, film.distances, found, strict=True):
            t = film.seconds(each.stamps)
            # Zero has no logarithm: it becomes a gap.
            V = np.where(each.V > 0, each.V, np.nan)
            plain = {k: v for k, v in style.items() if not k.startswith("marker")}
            axes.semilogy(t, V, label=track.label, **plain)
            self._curves.append((each.stamps, V))
        axes.set_xlim(start, end if end > start else start + 1)
        axes.set_xlabel("time since the epoch [s]")
        axes.set_ylabel("V [J]")
        axes.grid(visible=True, which="major", color="0.9")
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
        _mark_hits(axes, film)
        axes.legend(
            loc="lower left",
            bbox_to_anchor=(0.0, 1.0),
            ncol=4,
            fontsize="small",
            frameon=False,
            borderaxespad=0.1,
        )
        self._veil = Rectangle((start, 0), end - start, 1, transform=axes.get_xaxis_transform())
        self._veil.set(facecolor="white", alpha=0.72, zorder=5, linewidth=0)
        axes.add_patch(self._veil)
        self._cursor = axes.axvline(start, color="black", linewidth=1.0, zorder=6)
        (self._dots,) = axes.plot([], [], "o", color="black", markersize=5, zorder=7)
        self._end = end
        self.artists: list[Artist] = [self._veil, self._cursor, self._dots]

    def show(self, stamp: int) -> None:
        """Move the cursor to ``stamp``, ns."""
        t = float(self._film.seconds(np.array([stamp]))[0])
        self._cursor.set_xdata([t, t])
        self._veil.set_x(t)
        self._veil.set_width(max(self._end - t, 0.0))
        dots = []
        for stamps, V in self._curves:
            i = int(np.searchsorted(stamps, stamp, side="right")) - 1
            if i >= 0 and np.isfinite(V[i]):
                dots.append((t, V[i]))
        self._dots.set_data(*np.reshape(dots, (-1, 2)).T)


def _mark_hits(axes: Axes, film: Film) -> None:
    """A row of marks for each contact, or one for all of many contacts."""
    names = film.scene.system.contact_names
    rows = {f"impacts at {names[i]}": film.seconds(each) for i, each in film.contacts.hits.items()}
    if len(rows) > min(MOST_ROWS, 3):
        rows = {f"impacts at {len(rows)} contacts": np.concatenate(list(rows.values()))}
    mark_rows(axes, rows)


def _track_styles(film: Film) -> list[DrawStyle]:
    """Blue for the plant; for estimates white with edges in the colour of their curves."""
    found = styles([each.law for each in film.estimates])
    estimates = [DrawStyle("white", each["color"], max(each["linewidth"], 1.3)) for each in found]
    return estimates if film.truth is None else [DrawStyle(_PLANT, "black", 1.3), *estimates]
