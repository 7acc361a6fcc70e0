# SPDX-License-Identifier: Apache-2.0
"""The figure of a film: plant and estimates at one scale, V over time below."""

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.text import Text

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


class FilmFigure:
    """A figure that shows a film at any stamp.

    Attributes:
        figure: of matplotlib.
    """

    def __init__(self, film: Film, *, title: str, speed: float = 1.0) -> None:
        """Draw the rows of the scene and the axes of V.

        Args:
            film: the content.
            title: of the film.
            speed: recorded seconds a second of the film.
        """
        self._film = film
        self._highlight = round(_HIGHLIGHT * speed * NS_PER_S)
        placement = Placement(film.scene, len(film.tracks))
        lower = _LEGEND + _DISTANCE + _AXIS if film.distances else _NOTHING
        height = _TITLE + placement.height + lower
        with mpl.rc_context({"font.size": LARGE, "hatch.linewidth": 0.7}):
            # An even number of pixels, as encoders of films require.
            self.figure = Figure(figsize=(WIDTH, round(height * DPI / 2) * 2 / DPI), dpi=DPI)
            self._rows = _rows(self.figure, film, placement)
            self._distances = _DistancePlot(self.figure, film) if film.distances else None
            self._clock = _write_title(self.figure, film, title)

    def show(self, stamp: int) -> None:
        """Move bodies, stops and cursor to their places at ``stamp``, ns."""
        film = self._film
        truth = None if film.truth is None else film.truth.position(stamp)
        for row in self._rows:
            row.show(stamp, truth, self._highlight)
        if self._distances is not None:
            self._distances.show(stamp)
        self._clock.set_text(f"t = {(stamp - film.zero.stamp) / NS_PER_S:7.3f} s")


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


def _write_title(figure: Figure, film: Film, title: str) -> Text:
    """Write the title and a line of omitted parts; return the text that shows the time."""
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
        drawn = styles([each.law for each in film.estimates])
        self._curves = []
        for track, each, style in zip(film.estimates, film.distances, drawn, strict=True):
            t = film.seconds(each.stamps)
            # Zero has no logarithm: zero becomes a gap.
            V = np.where(each.V > 0, each.V, np.nan)
            plain = {k: v for k, v in style.items() if not k.startswith("marker")}
            axes.semilogy(t, V, label=track.label, **plain)
            self._curves.append((each.stamps, V))
        axes.set_xlim(start, end if end > start else start + 1)
        axes.set_xlabel(film.zero.axis)
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
    """Draw a row of marks for each contact, or one row for all of many contacts."""
    names = film.scene.system.contact_names
    rows = {f"impacts at {names[i]}": film.seconds(each) for i, each in film.contacts.hits.items()}
    if len(rows) > min(MOST_ROWS, 3):
        rows = {f"impacts at {len(rows)} contacts": np.concatenate(list(rows.values()))}
    mark_rows(axes, rows)


def _track_styles(film: Film) -> list[DrawStyle]:
    """Blue for the plant; for estimates white with edges in the colour of their curves."""
    drawn = styles([each.law for each in film.estimates])
    estimates = [DrawStyle("white", each["color"], max(each["linewidth"], 1.3)) for each in drawn]
    return estimates if film.truth is None else [DrawStyle(_PLANT, "black", 1.3), *estimates]
