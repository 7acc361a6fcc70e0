# SPDX-License-Identifier: Apache-2.0
"""One row of a film: the bodies, springs and stops of the plant or an estimate.

A body of what turns has a hand at the body's angle, upright at zero. A stop is vermilion, after
Okabe and Ito, during an impact or persistent contact. In grey vermilion is darker than the other
stops. A star marks an impact.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Rectangle
from matplotlib.transforms import Transform

from impact_observer.draw.pictures import Style
from impact_observer.draw.scene.film import Film, Track
from impact_observer.draw.scene.placement import SIDE, Placement
from impact_observer.draw.scene.scene import Frame
from impact_observer.draw.scene.shapes import (
    Box,
    couplings,
    grounds,
    hands,
    pads,
    pins,
    plates,
    rails,
    rods,
)
from impact_observer.model.system import unit_of
from impact_observer.states import Vector

LARGE, NAMED = 10.0, 7.0
"""Font sizes of titles and of names, points."""
_LIT = "#D55E00"


@dataclass(frozen=True, slots=True)
class DrawStyle:
    """Colours and lines of a track's bodies.

    Attributes:
        fill: colour of bodies.
        line: colour of the bodies' edges.
        width: of the edges, points.
    """

    fill: str
    line: str
    width: float


class SceneRow:
    """One track: bodies, couplings, stops."""

    def __init__(
        self, axes: Axes, placement: Placement, film: Film, track: Track, style: DrawStyle
    ) -> None:
        """Draw floor, walls and plates, and make the artists of bodies, couplings and stops."""
        self.axes, self._film, self._track = axes, film, track
        scene = film.scene
        self._scene = scene
        placed = placement.prepare(axes)
        _draw_still(axes, placement, placed, track.label)
        grounds_of = scene.system.frame
        moving = [] if grounds_of is None else np.any(grounds_of.grounds.factors, axis=1).tolist()
        at_rest = scene.frame(np.zeros(scene.system.n))
        self._walls = {
            contact: _hatch(axes, placed, box)
            for contact, box in plates(scene, at_rest)
            if any(moving) and moving[contact] and contact in {w.contact for w in scene.walls}
        }
        width, size = 2 * scene.half, _name_size(placement)
        line: Style = {"edgecolor": style.line, "linewidth": style.width}
        self._bodies = [
            _box(axes, placed, width, facecolor=style.fill, **line) for _ in scene.order
        ]
        self._names = [
            axes.text(
                0,
                0.5,
                name,
                ha="center",
                va="center",
                size=size[0],
                rotation=size[1],
                transform=placed,
            )
            for name in scene.names
        ]
        dashed: Style = {"fill": False, "edgecolor": "0.25", "linestyle": (0, (2, 2))}
        compared = track is not film.truth and film.truth is not None
        self._ghosts = [
            _box(axes, placed, width, **dashed) for _ in (scene.order if compared else ())
        ]
        self._strokes, self._rods = (_lines(axes, placed, width) for width in (1.1, 3.0))
        self._hands = _lines(axes, placed, 2.0)
        origin, right, up = placed.transform([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)])
        self._stretch = float(np.hypot(*(up - origin)) / np.hypot(*(right - origin)))
        edge: Style = {"edgecolor": "0.15"}
        self._pins = [_box(axes, placed, 0.0, facecolor="white", **edge) for _ in scene.bars]
        self._pads = [_box(axes, placed, 0.0, facecolor="0.15", **edge) for _ in scene.bumpers]
        self._lit = [
            _box(axes, placed, 0.0, facecolor=_LIT, edgecolor="black")
            for _ in range(scene.system.m)
        ]
        (self._bursts,) = axes.plot(
            [],
            [],
            "*",
            color=_LIT,
            markeredgecolor="black",
            markersize=13,
            clip_on=False,
            transform=placed,
        )
        middle: Style = {"ha": "center", "va": "center", "transform": placed}
        self._absent = axes.text(scene.homes.mean(), 0.5, "no state here", color="0.4", **middle)
        self._moving: list[Artist] = [
            *self._ghosts,
            self._strokes,
            self._rods,
            *self._pins,
            *self._pads,
            *self._bodies,
            self._hands,
            *self._names,
            *self._walls.values(),
        ]
        above = [*self._moving, *self._lit, self._bursts, self._absent]
        for place, artist in enumerate(above):  # later ones hide earlier ones, and the floor
            artist.set_zorder(3 + place / len(above))

    def show(self, stamp: int, truth: Vector | None, highlight: int) -> None:
        """Move bodies, couplings and stops to their places at ``stamp``, ns.

        Args:
            stamp: of the picture.
            truth: coordinates of the plant; None without truth at this stamp.
            highlight: how long a stop is highlighted after an impact, ns.
        """
        q, scene = self._track.position(stamp), self._scene
        for artist in self._moving:
            artist.set_visible(q is not None)
        self._absent.set_visible(q is None)
        for ghost in self._ghosts:
            ghost.set_visible(truth is not None)
        if truth is not None:
            for ghost, x in zip(self._ghosts, scene.frame(truth).bodies, strict=False):
                ghost.set_x(x - scene.half)
        frame = scene.frame(
            np.zeros(scene.system.n) if q is None else q, self._film.ground_motion(stamp)
        )
        for contact, box in plates(scene, frame):
            if (wall := self._walls.get(contact)) is not None:
                wall.set_x(box.left)
        for body, name, x in zip(self._bodies, self._names, frame.bodies, strict=True):
            body.set_x(x - scene.half)
            name.set_x(x)
        self._strokes.set_segments(list(couplings(scene, frame)))
        self._hands.set_segments(list(hands(scene, frame, self._stretch)))
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


def draw_scale(axes: Axes, placement: Placement) -> None:
    """Draw a scale bar in the upper right corner."""
    start, end = placement.scene.extent
    length, tick = _round_length((end - start) / 8), 0.05 / placement.body
    if placement.up:
        top = max(placement.up * start, placement.up * end)
        x = axes.get_xlim()[1] - SIDE / placement.body
        ends, across = [(x, top - length), (x, top)], (tick, 0.0)
        place = (x, top - length / 2)
    else:
        height = placement.top - 0.12 / placement.body
        ends, across = [(end - length, height), (end, height)], (0.0, tick)
        place = ends[0]
    axes.plot(*zip(*ends, strict=True), color="black", linewidth=1.4)
    for x, y in ends:
        (dx, dy) = across
        axes.plot([x - dx, x + dx], [y - dy, y + dy], color="black", linewidth=1.4)
    unit = unit_of("m", placement.scene.system.unit)
    shown = f"{length:g} {unit}" + (f" = {np.degrees(length):.3g}°" if unit == "rad" else "")
    axes.text(*place, f"{shown}  ", ha="right", va="center", size=LARGE - 1)


def write_note(axes: Axes, placement: Placement, text: str) -> None:
    """Write a small line in the upper right corner."""
    x = 1 - SIDE / placement.box(0)[2]
    style: Style = {"ha": "right", "va": "top", "size": NAMED + 1, "color": "0.25"}
    axes.text(x, 1 - 0.05 / placement.box(0)[3], text, transform=axes.transAxes, **style)


def _box(
    axes: Axes,
    placed: Transform,
    width: float,
    **style: Any,  # noqa: ANN401 (matplotlib's)
) -> Rectangle:
    """A box that is as large as a body across the line and gets its place later."""
    box = Rectangle((0, 0), width, 1, transform=placed, **style)
    axes.add_patch(box)
    return box


def _lines(axes: Axes, placed: Transform, width: float) -> LineCollection:
    """A collection of lines that get their points later."""
    lines = LineCollection([], colors="0.15", linewidths=width, transform=placed)
    axes.add_collection(lines)
    return lines


def _name_size(placement: Placement) -> tuple[float, float]:
    """Font size and rotation of names that fit into the bodies."""
    scene = placement.scene
    start, end = scene.extent
    along = 72 * 2 * scene.half / (end - start) * placement.length
    across = 72 * placement.body
    points, other = (across, along) if placement.up else (along, across)
    longest = max(map(len, scene.names))
    if points > 0.65 * LARGE * longest:
        return LARGE, 0.0
    if points > 0.65 * NAMED * longest:
        return NAMED, 0.0
    return max(min(NAMED, other / (0.65 * longest), 0.9 * points), 3.0), 90.0


def _draw_still(axes: Axes, placement: Placement, placed: Transform, label: str) -> None:
    """Draw the floor, the walls and the plates, with their names."""
    scene = placement.scene
    start, end = scene.extent
    line: Style = {"color": "0.6", "linewidth": 0.9, "transform": placed}
    axes.plot([start, end], [0, 0], zorder=1, **line)
    for home in scene.homes:
        axes.plot([home, home], [-0.07, 0], **line)
    rail = LineCollection(list(rails(scene)), colors="0.3", linewidths=1.0, transform=placed)
    axes.add_collection(rail)
    for box in grounds(scene):
        _hatch(axes, placed, box)
    names, rods_at = scene.system.contact_names, {each.contact for each in scene.bumpers}
    beside = ("right", "center") if placement.up else ("center", "top")
    for contact, box in plates(scene, scene.frame(np.zeros(scene.system.n))):
        if contact not in rods_at:
            _hatch(axes, placed, box)
            middle = box.left + box.width / 2
            style: Style = dict(zip(("ha", "va"), beside, strict=True), size=NAMED)
            axes.text(middle, box.bottom - 0.06, names[contact], transform=placed, **style)
    x, y = SIDE / placement.box(0)[2], 1 - 0.05 / placement.box(0)[3]
    axes.text(x, y, label, transform=axes.transAxes, va="top", weight="bold", size=LARGE)


def _hatch(axes: Axes, placed: Transform, box: Box) -> Rectangle:
    """Draw a hatched box."""
    style: Style = {"facecolor": "white", "edgecolor": "0.35", "hatch": "/////", "linewidth": 0.9}
    corner = (box.left, box.bottom)
    patch = Rectangle(corner, box.width, box.height, zorder=2, transform=placed, **style)
    axes.add_patch(patch)
    return patch


def _round_length(length: float) -> float:
    """The largest of 1, 2, 5 times a power of ten up to ``length``."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(next(f * power for f in (5.0, 2.0, 1.0) if f * power <= length * (1 + 1e-9)))
