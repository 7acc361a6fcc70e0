"""One row of a film: the bodies, springs and stops of the plant or an estimate.

A stop is vermilion, after Okabe and Ito, during an impact or persistent contact; in grey it is
darker than the others. A star marks an impact.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Rectangle

from impact_observer.draw.pictures import Style
from impact_observer.draw.scene.film import Film, Track
from impact_observer.draw.scene.scene import Frame, Scene
from impact_observer.draw.scene.shapes import (
    Box,
    bar_height,
    couplings,
    grounds,
    lane_height,
    pads,
    pins,
    plates,
    rails,
    rods,
)
from impact_observer.states import Vector

WIDTH = 9.6
"""Width of the pictures, inches."""
SIDE = 0.25
"""Margin beside the scene, inches."""
LARGE, NAMED = 10.0, 7.0
"""Font sizes of titles and of names, points."""
_LIT = "#D55E00"
_HEIGHT, _CLOSEST = 0.75, 0.36
"""Largest and least height of a body, inches."""
_LABEL, _BELOW_FLOOR = 0.36, 0.22
"""Room for the label above a row, and for the names of stops below it, inches."""


@dataclass(frozen=True, slots=True)
class DrawStyle:
    """How a track is drawn.

    Attributes:
        fill: colour of bodies.
        line: colour of their edges, which are solid; dashed is the plant behind an estimate.
        width: of the edges, points.
    """

    fill: str
    line: str
    width: float


class SceneRow:
    """One track: bodies, couplings, stops."""

    def __init__(self, axes: Axes, film: Film, track: Track, style: DrawStyle) -> None:
        """Draw what does not move, and make the artists that do."""
        self.axes, self._film, self._track = axes, film, track
        scene = film.scene
        _prepare(axes, scene)
        self._scene = scene
        _draw_still(axes, scene, track.label)
        width, size = 2 * scene.half, _name_size(axes, scene)
        line: Style = {"edgecolor": style.line, "linewidth": style.width}
        self._bodies = [_box(axes, width, facecolor=style.fill, **line) for _ in scene.order]
        self._names = [
            axes.text(0, 0.5, name, ha="center", va="center", size=size[0], rotation=size[1])
            for name in scene.names
        ]
        dashed: Style = {"fill": False, "edgecolor": "0.25", "linestyle": (0, (2, 2))}
        compared = track is not film.truth and film.truth is not None
        self._ghosts = [_box(axes, width, **dashed) for _ in (scene.order if compared else ())]
        self._strokes, self._rods = (_lines(axes, width) for width in (1.1, 3.0))
        edge: Style = {"edgecolor": "0.15"}
        self._pins = [_box(axes, 0.0, facecolor="white", **edge) for _ in scene.bars]
        self._pads = [_box(axes, 0.0, facecolor="0.15", **edge) for _ in scene.bumpers]
        self._lit = [
            _box(axes, 0.0, facecolor=_LIT, edgecolor="black") for _ in range(scene.system.m)
        ]
        (self._bursts,) = axes.plot(
            [], [], "*", color=_LIT, markeredgecolor="black", markersize=13, clip_on=False
        )
        self._absent = axes.text(
            scene.homes.mean(), 0.5, "no state here", ha="center", va="center", color="0.4"
        )
        self._moving = [
            *self._ghosts,
            self._strokes,
            self._rods,
            *self._pins,
            *self._pads,
            *self._bodies,
            *self._names,
        ]
        self.artists: list[Artist] = [*self._moving, *self._lit, self._bursts, self._absent]

    def show(self, stamp: int, truth: Vector | None, highlight: int) -> None:
        """Move everything to its position at ``stamp``, ns.

        Args:
            stamp: of the picture.
            truth: coordinates of the plant; None without truth at this stamp.
            highlight: how long a stop is highlighted after an impact, ns.
        """
        q, scene = self._track.at(stamp), self._scene
        for artist in self._moving:
            artist.set_visible(q is not None)
        self._absent.set_visible(q is None)
        for ghost in self._ghosts:
            ghost.set_visible(truth is not None)
        if truth is not None:
            for ghost, x in zip(self._ghosts, scene.frame(truth).bodies, strict=False):
                ghost.set_x(x - scene.half)
        frame = scene.frame(np.zeros(scene.system.n) if q is None else q)
        for body, name, x in zip(self._bodies, self._names, frame.bodies, strict=True):
            body.set_x(x - scene.half)
            name.set_x(x)
        self._strokes.set_segments(list(couplings(scene, frame)))
        self._rods.set_segments(list(rods(frame)))
        for patches, shapes in ((self._pins, pins), (self._pads, pads)):
            for patch, (_, box) in zip(patches, shapes(scene, frame), strict=True):
                patch.set_bounds(*box)
        self._highlight(stamp, frame, highlight)

    def _highlight(self, stamp: int, frame: Frame, duration: int) -> None:
        """Highlight stops in persistent contact, or shortly after an impact."""
        contacts, bursts = self._film.contacts, []
        for patch in self._lit:
            patch.set_visible(False)
        for contact, box in plates(self._scene, frame):
            bright = contacts.highlight(contact, stamp, duration)
            closed = contacts.is_closed(contact, stamp)
            patch = self._lit[contact]
            patch.set_visible(closed or bright > 0)
            patch.set_bounds(*box)
            patch.set_alpha(1.0 if closed else bright)
            if bright > 0.5:
                bursts.append((box.left + box.width / 2, box.bottom + box.height))
        self._bursts.set_data(*np.reshape(bursts, (-1, 2)).T)


def row_height(scene: Scene) -> float:
    """Height of a row, inches."""
    return _body_height(scene) * (_top(scene) - _bottom(scene))


def _top(scene: Scene) -> float:
    """Upper end of a row, in heights of a body."""
    drawn = lane_height(scene.lanes) + 0.15 if scene.lanes else 1.0
    return drawn + _LABEL / _body_height(scene)


def _bottom(scene: Scene) -> float:
    """Lower end of a row, in heights of a body."""
    drawn = bar_height(scene.bar_lanes - 1) - 0.15 if scene.bar_lanes else 0.0
    return drawn - _BELOW_FLOOR / _body_height(scene)


def _body_height(scene: Scene) -> float:
    """Height of a body, inches: about its width, within limits."""
    start, end = scene.extent
    width = 2 * scene.half / (end - start) * (WIDTH - 2 * SIDE)
    return min(max(width, _CLOSEST), _HEIGHT)


def _prepare(axes: Axes, scene: Scene) -> None:
    """Set limits that make the scale equal in every row, and hide the axes."""
    start, end = scene.extent
    margin = (end - start) * SIDE / (WIDTH - 2 * SIDE)
    axes.set_xlim(start - margin, end + margin)
    axes.set_ylim(_bottom(scene), _top(scene))
    axes.set_axis_off()


def draw_scale(axes: Axes, scene: Scene) -> None:
    """Draw a scale bar in the upper right corner."""
    start, end = scene.extent
    length = _round_length((end - start) / 8)
    height = _top(scene) - 0.12 / _body_height(scene)
    axes.plot([end - length, end], [height, height], color="black", linewidth=1.4)
    tick = 0.05 / _body_height(scene)
    for x in (end - length, end):
        axes.plot([x, x], [height - tick, height + tick], color="black", linewidth=1.4)
    axes.text(end - length, height, f"{length:g} m  ", ha="right", va="center", size=LARGE - 1)


def write_note(axes: Axes, scene: Scene, text: str) -> None:
    """Write a small line in the upper right corner."""
    x, y = scene.extent[1], _top(scene) - 0.05
    axes.text(x, y, text, ha="right", va="top", size=NAMED + 1, color="0.25")


def _box(axes: Axes, width: float, **style: Any) -> Rectangle:  # noqa: ANN401 (matplotlib's)
    """A box as high as a body, to be placed later."""
    box = Rectangle((0, 0), width, 1, **style)
    axes.add_patch(box)
    return box


def _lines(axes: Axes, width: float) -> LineCollection:
    """Lines whose points are set later."""
    lines = LineCollection([], colors="0.15", linewidths=width)
    axes.add_collection(lines)
    return lines


def _name_size(axes: Axes, scene: Scene) -> tuple[float, float]:
    """Font size and rotation of the names, so that they stay within the bodies."""
    start, end = axes.get_xlim()
    points = 2 * scene.half / (end - start) * WIDTH * 72
    longest = max(map(len, scene.names))
    if points > 0.65 * LARGE * longest:
        return LARGE, 0.0
    if points > 0.65 * NAMED * longest:
        return NAMED, 0.0
    return max(min(NAMED, 72 * _body_height(scene) / (0.65 * longest), 0.9 * points), 3.0), 90.0


def _draw_still(axes: Axes, scene: Scene, label: str) -> None:
    """Draw the floor, the walls and the plates, with their names."""
    start, end = scene.extent
    axes.plot([start, end], [0, 0], color="0.6", linewidth=0.9, zorder=1)
    for home in scene.homes:
        axes.plot([home, home], [-0.07, 0], color="0.6", linewidth=0.9)
    axes.add_collection(LineCollection(list(rails(scene)), colors="0.3", linewidths=1.0))
    for box in grounds(scene):
        _hatch(axes, box)
    names, rods_at = scene.system.contact_names, {each.contact for each in scene.bumpers}
    for contact, box in plates(scene, scene.frame(np.zeros(scene.system.n))):
        if contact not in rods_at:
            _hatch(axes, box)
            middle = box.left + box.width / 2
            style: Style = {"ha": "center", "va": "top", "size": NAMED}
            axes.text(middle, box.bottom - 0.06, names[contact], **style)
    axes.text(start, _top(scene) - 0.05, label, va="top", weight="bold", size=LARGE)


def _hatch(axes: Axes, box: Box) -> None:
    """Draw a hatched box that does not move."""
    style: Style = {"facecolor": "white", "edgecolor": "0.35", "hatch": "/////", "linewidth": 0.9}
    axes.add_patch(Rectangle((box.left, box.bottom), box.width, box.height, zorder=2, **style))


def _round_length(length: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above ``length``."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(next(f * power for f in (5.0, 2.0, 1.0) if f * power <= length * (1 + 1e-9)))
